"""Numbers that are kept within limits."""


def within(value, most):
    """The value, or the nearest of -most to most. NaN stays NaN."""
    return min(max(value, -most), most)
