#!/bin/sh
# Hand the browser view of a base station (port 8080, for itself only) to this machine's network.
#   browser.sh ADDRESS
set -eu
exec ssh -N -L 0.0.0.0:8080:127.0.0.1:8080 -o BatchMode=yes -o StrictHostKeyChecking=accept-new \
  -o ExitOnForwardFailure=yes -o ServerAliveInterval=5 "${1:?usage: browser.sh ADDRESS}"
