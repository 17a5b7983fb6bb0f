"""A datagram arrives twice with this probability."""


def make(severity, rng):
    return lambda datagram, now_s: [(0.0, datagram)] * (1 + (rng.random() < severity))
