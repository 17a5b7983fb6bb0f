"""A random share of the body's markers, new ones in each frame, has NaN as y. Severity: that share."""

import math

from risc_simulator.faults._frames import overwrite


def make(severity, rng, bodies):
    return overwrite(severity, rng, bodies, 1, math.nan)
