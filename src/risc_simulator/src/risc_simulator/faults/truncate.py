"""With this probability a datagram is cut off at a random place. Data that is not bytes is lost instead, as receivers
refuse a packet without its end.
"""


def make(severity, rng):
    def act(datagram, now_s):
        if rng.random() < severity:
            if not isinstance(datagram, bytes) or not datagram:
                return []
            datagram = datagram[: rng.integers(len(datagram))]
        return [(0.0, datagram)]

    return act
