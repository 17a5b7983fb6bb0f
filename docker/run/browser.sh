#!/bin/sh
# Forward the browser view of a base station (port 8080, loopback only) to one of this machine's networks.
#   browser.sh BASE_STATION OWN_ADDRESS
set -eu
usage='usage: browser.sh BASE_STATION OWN_ADDRESS'
exec ssh -N -L "${2:?$usage}:8080:127.0.0.1:8080" -o BatchMode=yes -o StrictHostKeyChecking=accept-new \
  -o ExitOnForwardFailure=yes -o ServerAliveInterval=5 "${1:?$usage}"
