"""Frames say that they are older by this [s] than they are; negative: younger."""


def make(severity, rng, bodies):
    return lambda seen, now_s: [(0.0, seen._replace(time_s=seen.time_s - severity))]
