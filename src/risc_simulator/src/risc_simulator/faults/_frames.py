"""What faults on frames have in common: the markers of a body in an Observation."""

import numpy as np


def rows_of(observation, names):
    """[slice of markers_m] of the bodies with these names, in their order; those that are not in it are left out."""
    found, start = {}, 0
    for name, count in observation.layout:
        found[name] = slice(start, start + count)
        start += count
    return [found[name] for name in names if name in found]


def changed(observation, names, change):
    """The Observation with change(markers (n, 3) of a body) in place of the markers of each body with these names."""
    markers_m = observation.markers_m.copy()
    for rows in rows_of(observation, names):
        markers_m[rows] = change(markers_m[rows])
    return observation._replace(markers_m=markers_m)


def level_direction(rng):
    """(3,) unit vector, level, in any direction."""
    angle_rad = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])
