"""A vehicle repeats what it said of itself last, with fresh sequence numbers and check sums."""

from risc_simulator.models.flight import FlightPhase
from risc_simulator.vehicles.ardrone import navdata
from risc_simulator.vehicles.iris import mavlink


def make(severity, rng):
    told = {}  # what was said last, by kind of report

    def act(data, now_s):
        if isinstance(data, bytes):
            for repeat in (navdata.repeated, mavlink.repeated):
                data = repeat(told, data)
        elif isinstance(data, tuple) and isinstance(data[0], FlightPhase):  # of a flight without sockets
            data = told.setdefault("report", data)
        return [(0.0, data)]

    return act
