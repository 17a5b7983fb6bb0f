"""A vehicle and another one, chosen by the seed, exchange names. If several are named, they exchange in a ring.

If one has more markers than the other, its surplus markers are not seen.
"""

import numpy as np

from risc_simulator.faults._frames import rows_of


def make(severity, rng, bodies):
    names = list(bodies.meant)
    if len(names) == 1 and bodies.others:
        names.append(bodies.others[rng.integers(len(bodies.others))])
    if len(names) < 2:
        raise ValueError("fault name_exchange: there is one vehicle, it takes two")

    def act(seen, now_s):
        markers_m, rows = seen.markers_m.copy(), rows_of(seen, names)
        for mine, theirs in zip(rows, rows[1:] + rows[:1]):
            markers_m[mine] = np.nan
            count = min(mine.stop - mine.start, theirs.stop - theirs.start)
            markers_m[mine.start : mine.start + count] = seen.markers_m[theirs.start : theirs.start + count]
        return [(0.0, seen._replace(markers_m=markers_m))]

    return act
