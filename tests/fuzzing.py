"""Damaged packets, the parsers' inputs in test_fuzz.py; always the same ones for a seed."""

import numpy as np

BATCH = 4096
_EXTREMES = (b"\0\0\0\0", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"\0\0\xc0\x7f", b"\0\0\x80\x7f")


def damaged(packets, count, repair=None, seed=1):
    """Yields `count` byte strings: packets with some bytes changed, cut, joined or made up.

    repair: function that corrects the checksums of a bytearray where it can. It gets every other packet, so that the
    code behind the checksums is tested as well.
    """
    rng = np.random.default_rng(seed)
    packets = list(packets)
    for begin in range(0, count, BATCH):
        size = min(BATCH, count - begin)
        kinds, repairs = rng.integers(0, 8, size).tolist(), rng.integers(0, 2, size).tolist()
        chosen, others = rng.integers(0, len(packets), (2, size)).tolist()
        places, values = rng.random((size, 4)).tolist(), rng.integers(0, 256, (size, 4)).tolist()
        noise = rng.bytes(size * 8)
        for k in range(size):
            data = bytearray(packets[chosen[k]])
            _damage(data, kinds[k], places[k], values[k], packets[others[k]], noise[8 * k : 8 * k + 8])
            if repair is not None and repairs[k]:
                repair(data)
            yield bytes(data)


def _damage(data, kind, places, values, other, noise):
    length = len(data)
    at = int(places[0] * length)
    if kind < 3:  # one to four bytes, some of them digits where the packet is a text
        for place, value in zip(places[: 1 + values[0] % 4], values):
            data[int(place * length)] = value if kind else 33 + value % 90
    elif kind == 3:
        data[at : at + 4] = _EXTREMES[values[0] % len(_EXTREMES)][: 1 + values[1] % 4]
    elif kind == 4:  # cut, or bytes lost within
        del data[at : length if values[0] % 2 else at + 1 + values[1] % 16]
    elif kind == 5:
        data[at:at] = noise[: 1 + values[0] % 8]
    elif kind == 6:  # the rest of another packet
        data[at:] = other[int(places[1] * len(other)) :]
    else:  # noise only, in some cases after a valid beginning
        data[min(length, values[0] % 16) :] = noise * (1 + values[1] % 4)
