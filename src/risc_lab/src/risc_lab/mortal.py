"""Commands that do not outlive the program that starts them."""

import os

# The kernel signals the death of a program's parent only once it has been asked to; if the parent was gone before that,
# $PPID is another process.
_UNLESS_ORPHAN = '[ "$PPID" = "$0" ] && exec "$@"'


def mortal(signal, command):
    """Wrap a command (list of str) so that its process gets a signal ("INT") when the thread that started it ends.

    Start it from this process itself, in the main thread: other threads end sooner.
    """
    return ["setpriv", "--pdeathsig", signal, "sh", "-c", _UNLESS_ORPHAN, str(os.getpid()), *map(str, command)]
