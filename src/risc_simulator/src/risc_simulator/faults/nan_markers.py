"""This share of the body's markers, others in each frame, has a y that is not a number."""

import math

from risc_simulator.faults._frames import overwrite


def make(severity, rng, bodies):
    return overwrite(severity, rng, bodies, 1, math.nan)
