"""The markers of a body stand still while frames go on; if no vehicle is named, all markers."""

from risc_simulator.faults._frames import rows_of


def make(severity, rng, bodies):
    first = None

    def act(seen, now_s):
        nonlocal first
        if first is None or first.layout != seen.layout:
            first = seen
        if not bodies.others:
            return [(0.0, first._replace(time_s=seen.time_s))]
        markers_m = seen.markers_m.copy()
        for rows in rows_of(seen, bodies.meant):
            markers_m[rows] = first.markers_m[rows]
        return [(0.0, seen._replace(markers_m=markers_m))]

    return act
