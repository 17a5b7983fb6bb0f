"""The markers of the body are at random places in the room, new ones in each frame."""

from risc_simulator.faults._frames import changed

LOW_M, HIGH_M = (-3.0, -3.0, 0.0), (3.0, 3.0, 3.0)


def make(severity, rng, bodies):
    def scatter(markers_m):
        return rng.uniform(LOW_M, HIGH_M, markers_m.shape)

    return lambda seen, now_s: [(0.0, changed(seen, bodies.meant, scatter))]
