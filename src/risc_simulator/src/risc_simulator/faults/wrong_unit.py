"""All coordinates are multiplied by this: metres where millimetres are meant, or the reverse."""


def make(severity, rng, bodies):
    def act(seen, now_s):
        markers_m, loose_m = severity * seen.markers_m, severity * seen.unidentified_m
        return [(0.0, seen._replace(markers_m=markers_m, unidentified_m=loose_m))]

    return act
