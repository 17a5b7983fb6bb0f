"""Commands that do not outlive the program that starts them."""

import os

# The kernel tells a program of its parent's death from when it has been asked to; a parent that was gone before is not
# $PPID any more.
_UNLESS_ORPHAN = '[ "$PPID" = "$0" ] && exec "$@"'


def mortal(signal, command):
    """The command (list of str) with which a program is sent a signal ("INT") when the thread that has started it ends.

    To be started by this process itself. Let that thread be the main one: others end sooner.
    """
    return ["setpriv", "--pdeathsig", signal, "sh", "-c", _UNLESS_ORPHAN, str(os.getpid()), *map(str, command)]
