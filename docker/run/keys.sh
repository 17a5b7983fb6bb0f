#!/bin/sh
# Make a key pair, once, and the authorized_keys of the machines that it opens. Both are kept in volumes.
#   keys.sh NAME [OPTIONS]      OPTIONS: what the key is restricted to, as sshd(8) says for authorized_keys
set -eu
name=${1:?usage: keys.sh NAME [OPTIONS]}
key=$HOME/.ssh/id_ed25519
[ -e "$key" ] || ssh-keygen -q -t ed25519 -N '' -C "$name" -f "$key"
echo "${2:+$2 }$(cat "$key.pub")" >"$HOME/.authorized/authorized_keys"
echo "key of $name: $(ssh-keygen -l -f "$key.pub")"
