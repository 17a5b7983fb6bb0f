#!/bin/sh
# Install the Debian packages of lists (one per line, '#' starts a comment), except those of another list.
#   packages.sh LIST... [--without LIST]
set -eu

entries() { sed -e 's/#.*//' -e 's/[[:space:]]*$//' -e '/^$/d' "$@"; }

wanted=$(mktemp)
unwanted=$(mktemp)
while [ $# -gt 0 ]; do
  if [ "$1" = --without ]; then
    entries "${2:?packages.sh: --without needs a list}" >"$unwanted"
    shift
  else
    entries "$1" >>"$wanted"
  fi
  shift
done
[ -s "$wanted" ] || { echo "packages.sh: no packages: usage: packages.sh LIST... [--without LIST]" >&2; exit 2; }

strays=$(grep -vxF -f "$wanted" "$unwanted" || true)
[ -z "$strays" ] || { echo "packages.sh: left out, but in no list: $strays" >&2; exit 1; }

export DEBIAN_FRONTEND=noninteractive
apt-get update
grep -vxF -f "$unwanted" "$wanted" | xargs apt-get install --yes --no-install-recommends
rm -f /etc/ssh/ssh_host_* # made by openssh-server: they belong to a machine, not to an image
apt-get clean
rm -rf /var/lib/apt/lists/* "$wanted" "$unwanted"
