#!/bin/bash
# The base station of compose.yaml: sets up and checks the laptops, and starts the experiment of Appendix C.
#   base_station.sh [ARGUMENT:=VALUE...]        more arguments of launch/Multi_Machine_Experiment.launch
#   ADDRESSES       where the machines are: "risc1_address:=... risc2_address:=..." up to risc4
set -eu
cd "$(dirname "$(readlink -f "$0")")/../.."
export RISC_MAAP_ROOT=$PWD
read -ra addresses <<<"${ADDRESSES:?say where the machines are, as compose.yaml does}"
experiment=(launch/Multi_Machine_Experiment.launch "${addresses[@]}" "fleet:=$PWD/docker/fleet.yaml" operator:=true
  "bag_prefix:=$PWD/flights/coop" "$@")

# until_good TRIES COMMAND...: retry until it succeeds, because the other containers may still be starting
until_good() {
  local tries=$1
  shift
  until "$@"; do
    [ "$((tries -= 1))" -gt 0 ] || return 1
    sleep 2
  done
}

docker/run/sshd.sh & # the service `browser` comes in by it
until_good 15 devel/coop.sh python -m risc_doctor.machines setup --yes "${experiment[@]}"
until_good 5 devel/coop.sh python -m risc_doctor.machines check "${experiment[@]}" ||
  { echo "base_station.sh: not every machine is ready: nothing was started" >&2; exit 1; }
exec devel/coop.sh roslaunch "${experiment[@]}"
