"""A vehicle repeats the status reports of when the fault began, with new sequence numbers and valid checksums."""

import contextlib

from risc_simulator.models.flight import FlightPhase
from risc_simulator.vehicles import REGISTRY, virtual_type


def _repeats():
    """`repeated` of all types that have it and can be loaded."""
    found = []
    for name in REGISTRY.names():
        with contextlib.suppress(ValueError):
            found.append(virtual_type(name).repeated)
    return [repeated for repeated in found if repeated]


_repeats()  # loads their modules here, not while a lab runs


def make(severity, rng):
    repeats = _repeats()
    told = {}  # first report of each kind since the fault began

    def act(data, now_s):
        if isinstance(data, bytes):
            for repeat in repeats:  # each returns data of other types unchanged
                data = repeat(told, data)
        elif isinstance(data, tuple) and isinstance(data[0], FlightPhase):  # of a flight without sockets
            data = told.setdefault("report", data)
        return [(0.0, data)]

    return act
