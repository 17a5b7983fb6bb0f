"""A reflection at this distance [m] from a marker of the body takes its label; the marker is seen without one."""

import numpy as np

from risc_simulator.faults._frames import rows_of


def make(severity, rng, bodies):
    direction = rng.standard_normal(3)
    beside_m = severity * direction / np.linalg.norm(direction)
    place = rng.random()

    def act(seen, now_s):
        markers_m, loose_m = seen.markers_m.copy(), [seen.unidentified_m]
        for rows in rows_of(seen, bodies.meant):
            k = rows.start + int(place * (rows.stop - rows.start))
            if np.isfinite(markers_m[k]).all():
                loose_m.append(markers_m[k : k + 1].copy())
            markers_m[k] += beside_m
        return [(0.0, seen._replace(markers_m=markers_m, unidentified_m=np.concatenate(loose_m)))]

    return act
