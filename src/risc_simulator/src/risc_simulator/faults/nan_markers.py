"""This share of the body's markers, drawn anew in each frame, has NaN as y."""

import math

from risc_simulator.faults._frames import overwrite


def make(severity, rng, bodies):
    return overwrite(severity, rng, bodies, 1, math.nan)
