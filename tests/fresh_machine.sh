#!/usr/bin/env bash
# Does README's promise hold on a machine that has nothing but git? Makes a minimal Debian 12 in a folder (debootstrap),
# clones this commit into it, and runs the two commands there. Takes about half an hour and 5 GB; needs root.
#
#   tests/fresh_machine.sh FOLDER [COMMAND...]       default commands: './maap fly' './maap test'
#
# The Debian mirror is taken from this machine's apt sources (or MIRROR), and so are its certificates.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
folder=${1:?usage: fresh_machine.sh FOLDER [COMMAND...]}
shift
[ $# -gt 0 ] || set -- './maap fly' './maap test'
# shellcheck disable=SC2016  # $(SITE) is apt's, not the shell's
mirror=${MIRROR:-$(apt-get indextargets --format '$(SITE)' 'Created-By: Packages' | grep -m 1 -i debian)}

if [ ! -d "$folder/etc" ]; then
  debootstrap --variant=minbase --include=ca-certificates,git bookworm "$folder" "$mirror"
fi
printf '127.0.0.1 localhost %s\n' "$(hostname)" >"$folder/etc/hosts"
cp /etc/resolv.conf "$folder/etc/resolv.conf"
cp /etc/ssl/certs/ca-certificates.crt "$folder/etc/ssl/certs/ca-certificates.crt"
printf '#!/bin/sh\nexit 101\n' >"$folder/usr/sbin/policy-rc.d" # no services are started in there
chmod +x "$folder/usr/sbin/policy-rc.d"
rm -rf "$folder/risc_maap"
git clone --quiet "$root" "$folder/risc_maap"

mounts='mount -t proc proc /proc && mount -t tmpfs tmpfs /dev/shm'
# catkin build wants pseudo terminals
mounts+=' && mkdir -p /dev/pts && mount -t devpts -o newinstance,ptmxmode=0666 devpts /dev/pts && ln -sf pts/ptmx /dev/ptmx'
for command in "$@"; do
  printf '== %s\n' "$command"
  # its own process namespace: all that the command leaves behind ends with it
  env -i HOME=/root TERM="${TERM:-dumb}" PATH=/usr/sbin:/usr/bin:/sbin:/bin PIP_CERT=/etc/ssl/certs/ca-certificates.crt \
    unshare --pid --fork --kill-child --mount chroot "$folder" bash -c \
    "$mounts && cd /risc_maap && $command"
done
