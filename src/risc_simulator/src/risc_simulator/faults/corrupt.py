"""With this probability one byte of a datagram, anywhere in it, is changed. Data that is not bytes is lost instead, as
a receiver that checks a sum (UDP, the radio of an IRIS+) refuses it.
"""


def make(severity, rng):
    def act(datagram, now_s):
        if rng.random() < severity:
            if not isinstance(datagram, bytes) or not datagram:
                return []
            datagram = bytearray(datagram)
            datagram[rng.integers(len(datagram))] ^= int(rng.integers(1, 256))
            datagram = bytes(datagram)
        return [(0.0, datagram)]

    return act
