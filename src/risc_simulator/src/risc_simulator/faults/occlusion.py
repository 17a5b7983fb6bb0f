"""This share of the body's markers is hidden, the same ones for as long as the fault lasts."""

import numpy as np

from risc_simulator.faults._frames import changed


def make(severity, rng, bodies):
    order = rng.random(100)  # more than any body has

    def hide(markers_m):
        count = len(markers_m)
        hidden = np.argsort(np.resize(order, count))[: round(severity * count)]
        markers_m[hidden] = np.nan
        return markers_m

    return lambda seen, now_s: [(0.0, changed(seen, bodies.meant, hide))]
