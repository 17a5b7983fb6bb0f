"""With this probability a datagram is cut off at a random place. Data that is not bytes is unchanged."""


def make(severity, rng):
    def act(datagram, now_s):
        if isinstance(datagram, bytes) and datagram and rng.random() < severity:
            datagram = datagram[: rng.integers(len(datagram))]
        return [(0.0, datagram)]

    return act
