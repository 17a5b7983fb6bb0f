"""Each datagram arrives later by a time of its own, uniform from 0 to this [s]; so some overtake others."""


def make(severity, rng):
    return lambda datagram, now_s: [(severity * rng.random(), datagram)]
