#!/bin/sh
# The ssh server of this machine, run by its user. The host key is made at the first start: none is in the image.
set -eu
here=$(dirname "$(readlink -f "$0")")
key=$HOME/.sshd/ssh_host_ed25519_key
authorized=$HOME/.authorized/authorized_keys

[ -e "$key" ] || ssh-keygen -q -t ed25519 -N '' -C "$(hostname)" -f "$key"
[ -r "$authorized" ] || echo "sshd.sh: login is not possible yet: put public keys into $authorized" >&2
exec /usr/sbin/sshd -D -e -f "$here/../sshd_config"
