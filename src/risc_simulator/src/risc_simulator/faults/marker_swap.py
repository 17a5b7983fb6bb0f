"""Two markers of the body exchange their labels, in each frame with this probability. The pair is the same for all
bodies with the same number of markers; it changes after a frame without an exchange."""

from risc_simulator.faults._frames import changed


def make(severity, rng, bodies):
    pairs = {}

    def swap(markers_m):
        count = len(markers_m)
        if severity < 1.0 and rng.random() >= severity:
            pairs.pop(count, None)  # another pair the next time
            return markers_m
        if count not in pairs:
            pairs[count] = rng.choice(count, 2, replace=False)
        markers_m[pairs[count]] = markers_m[pairs[count][::-1]]
        return markers_m

    return lambda seen, now_s: [(0.0, changed(seen, bodies.meant, swap))]
