"""A datagram is lost with this probability, independently of those before."""


def make(severity, rng):
    return lambda datagram, now_s: [] if rng.random() < severity else [(0.0, datagram)]
