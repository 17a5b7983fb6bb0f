#!/bin/sh
# Make a key pair, once, and the authorized_keys of the machines that accept it. Both are kept in volumes.
#   keys.sh NAME [OPTIONS]      OPTIONS: restrictions of the key, in the syntax of authorized_keys in sshd(8)
set -eu
name=${1:?usage: keys.sh NAME [OPTIONS]}
key=$HOME/.ssh/id_ed25519
[ -e "$key" ] || ssh-keygen -q -t ed25519 -N '' -C "$name" -f "$key"
echo "${2:+$2 }$(cat "$key.pub")" >"$HOME/.authorized/authorized_keys"
echo "key of $name: $(ssh-keygen -l -f "$key.pub")"
