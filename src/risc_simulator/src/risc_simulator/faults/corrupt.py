"""With this probability one byte of a datagram, anywhere in it, is changed. Data that is not bytes is unchanged."""


def make(severity, rng):
    def act(datagram, now_s):
        if isinstance(datagram, bytes) and datagram and rng.random() < severity:
            datagram = bytearray(datagram)
            datagram[rng.integers(len(datagram))] ^= int(rng.integers(1, 256))
            datagram = bytes(datagram)
        return [(0.0, datagram)]

    return act
