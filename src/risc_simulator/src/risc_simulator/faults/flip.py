"""The body is seen turned by this angle [deg] about its own vertical axis: its labels fit the other way round."""

import numpy as np

from risc_simulator.faults._frames import pose, rows_of


def make(severity, rng, bodies):
    cosine, sine = np.cos(np.radians(severity)), np.sin(np.radians(severity))
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])  # body axes

    def act(seen, now_s):
        markers_m = seen.markers_m.copy()
        for name in bodies.meant:
            for rows in rows_of(seen, [name]):
                found = pose(markers_m[rows], bodies.markers_m[name])
                if found is not None:
                    axes, origin_m = found
                    markers_m[rows] = (markers_m[rows] - origin_m) @ (axes @ turn @ axes.T).T + origin_m
        return [(0.0, seen._replace(markers_m=markers_m))]

    return act
