"""The body is seen displaced by this distance [m], horizontally, always in the same direction."""

from risc_simulator.faults._frames import changed, level_direction


def make(severity, rng, bodies):
    beside_m = severity * level_direction(rng)
    return lambda seen, now_s: [(0.0, changed(seen, bodies.meant, lambda markers_m: markers_m + beside_m))]
