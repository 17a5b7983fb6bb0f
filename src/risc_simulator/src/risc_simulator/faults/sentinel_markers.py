"""This share of the body's markers, drawn anew in each frame, has the x of Cortex' missing markers; y, z stay."""

from risc_simulator.faults._frames import MISSING_M, overwrite


def make(severity, rng, bodies):
    return overwrite(severity, rng, bodies, 0, MISSING_M)
