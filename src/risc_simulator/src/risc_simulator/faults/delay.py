"""All datagrams arrive later by the same time [s]."""


def make(severity, rng):
    return lambda datagram, now_s: [(severity, datagram)]
