# Start-up file of `./maap shell`: the person's own, then the workspace (whose PATH must come first).
# shellcheck shell=bash disable=SC1090,SC1091
[ -f ~/.bashrc ] && . ~/.bashrc
. "$RISC_MAAP_ROOT/devel/setup.bash"
PS1="(maap) $PS1"
