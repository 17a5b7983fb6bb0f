"""A vehicle repeats what it said of itself last, with fresh sequence numbers and check sums."""

from risc_simulator.models.flight import FlightPhase
from risc_simulator.vehicles import REGISTRY, virtual_type


def make(severity, rng):
    repeats = [repeat for name in REGISTRY.names() if (repeat := virtual_type(name).repeated)]
    told = {}  # what was said last, by kind of report

    def act(data, now_s):
        if isinstance(data, bytes):
            for repeat in repeats:  # each leaves alone what is not of its type
                data = repeat(told, data)
        elif isinstance(data, tuple) and isinstance(data[0], FlightPhase):  # of a flight without sockets
            data = told.setdefault("report", data)
        return [(0.0, data)]

    return act
