"""Noise of sensors."""

_BLOCK = 8192


def normal_numbers(rng, scale):
    """Normal numbers one at a time; drawing them in blocks makes one cost some 50 ns. scale: standard deviation."""
    while True:
        yield from (scale * rng.standard_normal(_BLOCK)).tolist()
