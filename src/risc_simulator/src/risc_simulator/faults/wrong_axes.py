"""y points up and z to the right, as in a system that was calibrated with these axes."""

import numpy as np

_AXES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # x stays, y is the height, z minus the old y


def make(severity, rng, bodies):
    def act(seen, now_s):
        markers_m, loose_m = seen.markers_m @ _AXES.T, seen.unidentified_m @ _AXES.T
        return [(0.0, seen._replace(markers_m=markers_m, unidentified_m=loose_m))]

    return act
