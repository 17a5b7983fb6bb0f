#!/bin/sh
# Remove from a built workspace what no node needs: the Python packages of a list, build files, tests of the whole.
# src, devel and launch stay complete: `./maap machines check` compares them with those of the base station.
#   RISC_MAAP_TRIM=yes trim.sh LIST             in the folder of the workspace
set -eu
list=${1:?usage: trim.sh LIST}
[ "${RISC_MAAP_TRIM:-}" = yes ] ||
  { echo "trim.sh: it removes .git, tests and docs from $PWD: RISC_MAAP_TRIM=yes if that is what you want" >&2; exit 1; }
[ -d devel ] || { echo "trim.sh: no devel/ here: run it in a built workspace" >&2; exit 1; }
sed -e 's/#.*//' -e '/^[[:space:]]*$/d' "$list" | xargs .venv/bin/pip uninstall --yes
# record the revision, as `./maap machines deploy` does
devel/env.sh python -c '
import json, risc_doctor.machines.workspace_digest as workspace
print(json.dumps({"revision": workspace.describe(".").revision, "from": "Dockerfile"}))' >.deployed
rm -rf build logs tests docs .git .catkin_tools
