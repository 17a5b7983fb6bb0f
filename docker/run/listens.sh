#!/bin/sh
# Exit with 0 if a server listens on this TCP port of this machine. For health checks: does not connect to the server.
#   listens.sh PORT
set -eu
port=$(printf '%04X' "${1:?usage: listens.sh PORT}")
cat /proc/net/tcp /proc/net/tcp6 2>/dev/null | grep -qE "^ *[0-9]+: [0-9A-F]+:$port 0+:0000 0A "
