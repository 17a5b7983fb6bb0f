"""Checks that many dataclasses need; each error is one sentence that names the key."""


def check_ranges(settings, **ranges):
    """ranges: of each field (least, greatest), both allowed. Raises ValueError for the first one that is outside."""
    for key, (least, greatest) in ranges.items():
        value = getattr(settings, key)
        if not least <= value <= greatest:
            raise ValueError("'%s' must be in [%g, %g], found %r" % (key, least, greatest, value))


def check_positive(settings, *keys):
    """Raises ValueError for the first of these fields that is not > 0."""
    for key in keys:
        value = getattr(settings, key)
        if not value > 0.0:
            raise ValueError("'%s' must be positive, found %r" % (key, value))
