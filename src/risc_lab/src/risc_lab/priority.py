"""Priorities of programs on a busy computer: for root, or where RLIMIT_NICE allows it (`./maap setup` says how).

For other users nothing changes.

Linux divides the processor first among sessions, then among their threads (autogroup, on by default), and roslaunch
gives every node a session of its own: a niceness alone has no effect on other nodes. So the leader of a session sets
the session's niceness as well.
"""

import contextlib
import os

VIRTUAL_LAB = -10  # it stands for other computers with their own processors
FLIGHT = -5  # nodes between motion capture frame and command

_AUTOGROUP = "/proc/self/autogroup"  # missing when the kernel has no autogroups


def raise_priority(niceness):
    """Give this thread, and those that it starts from now on, a negative niceness, where that is allowed.

    A program that was started with `nice` keeps its niceness.
    """
    if niceness < os.getpriority(os.PRIO_PROCESS, 0) <= 0:
        set_priority(niceness)


def set_priority(niceness):
    """Give this thread, those that it starts from now on, and the session that it leads a niceness, where allowed."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
    if os.getsid(0) == os.getpid():
        with contextlib.suppress(OSError), open(_AUTOGROUP, "w", encoding="ascii") as group:
            group.write("%d" % niceness)
