"""Two markers of the body have each other's label, in each frame with this probability. Which ones: the same for all
bodies with so many markers; always, or where it is no certainty until a frame without."""

from risc_simulator.faults._frames import changed


def make(severity, rng, bodies):
    pairs = {}

    def swap(markers_m):
        count = len(markers_m)
        if severity < 1.0 and rng.random() >= severity:
            pairs.pop(count, None)  # the next time others
            return markers_m
        if count not in pairs:
            pairs[count] = rng.choice(count, 2, replace=False)
        markers_m[pairs[count]] = markers_m[pairs[count][::-1]]
        return markers_m

    return lambda seen, now_s: [(0.0, changed(seen, bodies.meant, swap))]
