#!/bin/sh
# The key pair by which the base station logs in on the laptops: made once, kept in volumes.
set -eu
key=$HOME/.ssh/id_ed25519
[ -e "$key" ] || ssh-keygen -q -t ed25519 -N '' -C "base station" -f "$key"
cp "$key.pub" "$HOME/.authorized/authorized_keys"
echo "key of the base station: $(ssh-keygen -l -f "$key.pub")"
