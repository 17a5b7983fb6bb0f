"""With this probability a datagram is held back, so that the next one overtakes it.

It waits for one and a half times the gap to the one before it.
"""

import math


def make(severity, rng):
    last_s = math.nan

    def act(datagram, now_s):
        nonlocal last_s
        gap_s, last_s = now_s - last_s, now_s
        return [(1.5 * gap_s if rng.random() < severity and gap_s > 0.0 else 0.0, datagram)]

    return act
