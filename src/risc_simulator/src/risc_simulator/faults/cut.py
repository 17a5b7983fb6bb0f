"""With this probability a connection is cut when something is written to it."""


def make(severity, rng):
    return lambda data, now_s: None if rng.random() < severity else [(0.0, data)]
