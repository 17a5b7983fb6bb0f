"""Noise of sensors."""

_BLOCK = 8192


def normal_numbers(rng, scale):
    """Yield normal numbers; drawn in blocks, so that one takes only about 50 ns. scale: standard deviation."""
    while True:
        yield from (scale * rng.standard_normal(_BLOCK)).tolist()
