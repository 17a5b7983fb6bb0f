#!/bin/sh
# Have dpkg skip headers, static libraries and documents from now on: nothing is compiled on a laptop.
set -eu
cat >/etc/dpkg/dpkg.cfg.d/slim <<'TXT'
path-exclude /usr/include/*
path-exclude /usr/lib/*.a
path-exclude /usr/share/doc/*
path-include /usr/share/doc/*/copyright
path-exclude /usr/share/man/*
path-exclude /usr/share/locale/*
TXT
