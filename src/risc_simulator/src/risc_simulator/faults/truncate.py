"""With this probability a datagram lacks its end, from anywhere in it on. What has no bytes stays as it is."""


def make(severity, rng):
    def act(datagram, now_s):
        if isinstance(datagram, bytes) and datagram and rng.random() < severity:
            datagram = datagram[: rng.integers(len(datagram))]
        return [(0.0, datagram)]

    return act
