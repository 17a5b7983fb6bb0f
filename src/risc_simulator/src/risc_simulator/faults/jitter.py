"""Each datagram is delayed by a random time, uniform from 0 to this [s], so that some overtake others."""


def make(severity, rng):
    return lambda datagram, now_s: [(severity * rng.random(), datagram)]
