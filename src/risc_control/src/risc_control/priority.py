"""Who goes first when the computer is busy. Only root may go before others; elsewhere nothing changes."""

import contextlib
import os

VIRTUAL_LAB = -10  # it stands for other computers with their own processors
FLIGHT = -5  # what lies between the frame and the command


def raise_priority(niceness):
    """Give this thread, and those that it starts from now on, a negative niceness, where that is allowed.

    What somebody has started with `nice` stays as it is: it was meant.
    """
    if niceness < os.getpriority(os.PRIO_PROCESS, 0) <= 0:
        with contextlib.suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, niceness)
