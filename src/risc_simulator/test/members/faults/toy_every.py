"""A fault for tests: every `severity`-th datagram is cut in half."""

import itertools


def make(severity, rng):
    count = itertools.count(1)
    return lambda datagram, now_s: [(0.0, datagram[: len(datagram) // 2] if next(count) % severity == 0 else datagram)]
