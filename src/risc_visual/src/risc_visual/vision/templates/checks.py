"""What every template asks of its settings."""


def within(settings, key, least, greatest):
    """Raise ValueError that names the key unless least <= value <= greatest."""
    value = getattr(settings, key)
    if not least <= value <= greatest:
        raise ValueError("parameter '%s' must be within %g to %g, got %r" % (key, least, greatest, value))
