#!/bin/sh
# Make the user of the images: no password that could be guessed, no sudo. Folders that volumes are mounted on exist, so
# that a new volume belongs to the user.
#   user.sh [USER_ID]
set -eu

name=risc
home=/home/$name
useradd --create-home --uid "${1:-1000}" --shell /bin/bash --password '*' "$name"
# joysticks, cameras and serial adapters; a slim system may lack some of these groups
for group in input video dialout; do
  getent group "$group" >/dev/null || groupadd --system "$group"
  usermod --append --groups "$group" "$name"
done
install -d -o "$name" -g "$name" "$home/risc_maap" "$home/risc_maap/flights" "$home/.ros"
install -d -o "$name" -g "$name" -m 700 "$home/.ssh" "$home/.sshd" "$home/.authorized"
