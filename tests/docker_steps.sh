#!/usr/bin/env bash
# Do the images of docker/Dockerfile build, and does docker/compose.yaml stand up and fly? With a real engine (podman) in
# a folder and networks of its own; debian:bookworm-slim is made by debootstrap, so that no registry of images is asked.
# Takes half an hour and 15 GB; needs root, and: apt-get install debootstrap podman crun netavark catatonit iptables
#
#   tests/docker_steps.sh FOLDER [STEP...]       default steps: base build look fly
#
# The Debian mirror is taken from this machine's apt sources (or MIRROR), and so are its certificates.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
folder=${1:?usage: docker_steps.sh FOLDER [base] [build] [look] [fly]}
shift
[ $# -gt 0 ] || set -- base build look fly
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)

say() { printf '== %s\n' "$*"; }
fail() { printf 'docker_steps.sh: %s\n' "$*" >&2; exit 1; }
for tool in debootstrap podman crun iptables; do
  command -v "$tool" >/dev/null || fail "$tool is missing: apt-get install debootstrap podman crun netavark catatonit iptables"
done

# ---------------------------------------------------------------- the engine

export CONTAINERS_STORAGE_CONF=$folder/storage.conf CONTAINERS_CONF=$folder/containers.conf
printf '[storage]\ndriver = "overlay"\ngraphroot = "%s/storage"\nrunroot = "%s/run"\n' "$folder" "$folder" \
  >"$CONTAINERS_STORAGE_CONF"
# limits that may be given without the right to raise them
printf '[containers]\ncgroups = "disabled"\ndefault_ulimits = ["nofile=4096:4096", "nproc=4096:4096"]\n' >"$CONTAINERS_CONF"
printf '[engine]\ncgroup_manager = "cgroupfs"\nevents_logger = "file"\n' >>"$CONTAINERS_CONF"
printf '[network]\nnetwork_backend = "netavark"\nnetwork_config_dir = "%s/networks"\n' "$folder" >>"$CONTAINERS_CONF"

# apart [--net] COMMAND...: mounts, and with --net networks, that no other process sees, and that end with the command
apart() {
  local spaces=(--mount)
  if [ "$1" = --net ]; then
    spaces+=(--net)
    shift
  fi
  # crun takes no cgroups of both versions: in here there are those of version 2, unused
  unshare "${spaces[@]}" bash -c \
    'umount -R /sys/fs/cgroup && mount -t cgroup2 cgroup2 /sys/fs/cgroup && "$@"' apart "$@"
}

in_image() { # TARGET COMMAND...: in a new container without a network
  local target=$1
  shift
  apart podman run --rm --network none --no-healthcheck "risc_maap:$target" "$@"
}

# ---------------------------------------------------------------- steps

step_base() {
  local base=$folder/base mirror
  # shellcheck disable=SC2016  # $(SITE) is apt's, not the shell's
  mirror=${MIRROR:-$(apt-get indextargets --format '$(SITE)' 'Created-By: Packages' | grep -m 1 -i debian)}
  [ -d "$base/etc" ] || debootstrap --variant=minbase --include=ca-certificates bookworm "$base" "$mirror"
  cp /etc/ssl/certs/ca-certificates.crt "$base/etc/ssl/certs/ca-certificates.crt"
  printf '[global]\ncert = /etc/ssl/certs/ca-certificates.crt\n' >"$base/etc/pip.conf"
  tar -C "$base" -c . | apart podman import - docker.io/library/debian:bookworm-slim
}

step_build() {
  local target
  for target in development laptop; do
    say "building $target"
    apart podman build --pull=never --isolation chroot --format docker --layers --target "$target" \
      --tag "risc_maap:$target" --file "$root/docker/Dockerfile" "$root"
  done
  apart podman images
}

# Nothing in there that should not be, everything that the vehicle's nodes need.
step_look() {
  local target
  for target in development laptop; do
    say "looking into $target"
    # shellcheck disable=SC2016  # expanded in there
    in_image "$target" bash -ec '
      [ "$(id -un)" = risc ]
      [ -z "$(ls /etc/ssh/ssh_host_* ~/.ssh/* ~/.sshd/* 2>/dev/null)" ]
      [ -z "$(find / -xdev -perm -o=w -type f -not -path "/proc/*" 2>/dev/null)" ]
      ROS_MASTER_URI=http://127.0.0.1:11311 ROS_IP=127.0.0.1
      . devel/setup.sh
      missing=$(find devel/lib -type f -perm -u=x -exec ldd {} + 2>/dev/null | grep "not found" || true)
      [ -z "$missing" ] || { echo "$missing"; exit 1; }
      python -c "import cv2, av, cv_bridge, rospy, tf2_ros, risc_msgs.msg, ardrone_autonomy.msg"
      python -m risc_doctor --help >/dev/null
      roslaunch --nodes launch/Multi_Machine_Experiment.launch machine:=local "fleet:=$PWD/docker/fleet.yaml" | sort | xargs'
  done
  # shellcheck disable=SC2016  # expanded in there
  in_image laptop sh -ec '[ -z "$(command -v cc gcc g++ clang make)" ]; [ ! -e /usr/include/stdio.h ]'
  # shellcheck disable=SC2016  # expanded in there
  in_image development sh -c '[ -z "$(ls -d .git/config .git/hooks .git/logs 2>/dev/null)" ]'
  # rviz ends with 1 even after --help: what it says counts
  in_image development ./maap shell -c 'set -e; pytest --version; g++ --version | head -n 1
    QT_QPA_PLATFORM=offscreen rviz --help 2>&1 | grep "rviz version"'
  apart podman images --format '{{.Repository}}:{{.Tag}} {{.Size}}' | grep risc_maap
}

# docker/compose.yaml at 100 Hz and with few pictures, until three vehicles have landed after a course of 10 s and the browser
# view answered.
step_fly() {
  [ -x "$folder/venv/bin/podman-compose" ] || /usr/bin/python3 -m venv "$folder/venv"
  "$folder/venv/bin/pip" install --quiet --disable-pip-version-check podman-compose==1.6.0
  # Two cores do what six computers would: half the frames, few pictures, and everything starts before the take-off.
  sed 's/rate_hz: 200/rate_hz: 100/' "$root/docker/fleet.yaml" >"$folder/fleet.yaml"
  grep -q 'rate_hz: 100' "$folder/fleet.yaml" || fail "docker/fleet.yaml names no rate_hz of 200"
  chmod 644 "$folder/fleet.yaml" # for user risc in there
  cat >"$folder/short.yaml" <<TXT
services:
  lab: &slow
    volumes: ["$folder/fleet.yaml:/home/risc/risc_maap/docker/fleet.yaml:ro"]
  risc1:
    <<: *slow
    command: [docker/run/base_station.sh, "rviz:=false", "browser:=true", "video_fps:=1", "record_hz:=0", "ready:=4", "duration:=10"]
TXT
  apart --net "$root/tests/docker_steps.sh" "$folder" fly_apart
}

compose() {
  "$folder/venv/bin/podman-compose" --project-name lab --file "$root/docker/compose.yaml" --file "$folder/short.yaml" "$@"
}

on_base_station() {
  podman exec lab_risc1_1 devel/coop.sh "$@"
}

leave() {
  rm -rf "$folder/logs"
  mkdir "$folder/logs"
  podman logs lab_lab_1 >"$folder/logs/lab.txt" 2>&1 || true
  podman logs lab_risc1_1 >"$folder/logs/risc1.txt" 2>&1 || true
  podman cp lab_risc1_1:/home/risc/.ros/log "$folder/logs/risc1" || true
  compose down --volumes
}

step_fly_apart() {
  local result=
  [ -z "$(ip route)" ] || fail "there is a way out of here: the addresses of Appendix C belong to others"
  ip link set lo up
  trap leave EXIT
  compose down --volumes >/dev/null 2>&1 || true # what a killed run has left, and its log
  compose up --detach --no-build
  say "waiting for the experiment"
  # Up to 500 s: the operator alone may take 206 s (its time limits).
  # Read from the log: a `rostopic` every few seconds takes more of the two cores than the flight has to spare.
  for _ in {1..100}; do
    sleep 5
    result=$(podman logs lab_risc1_1 2>&1 | sed -n 's/.*operator: result //p') && [ -n "$result" ] && break
  done
  say "the operator says: ${result:-nothing}"
  on_base_station rosnode list | xargs || true
  podman exec lab_risc1_1 ls -l flights || true
  curl --silent --fail --retry 20 --retry-delay 3 --retry-all-errors --output "$folder/page.html" http://127.0.0.1:8080/ || true
  grep -qi '<html' "$folder/page.html" || fail "no browser view at port 8080"
  [ "$result" = ok ] || fail "the flight failed: see $folder/logs"
}

for step in "$@"; do
  say "$step"
  "step_$step"
done
