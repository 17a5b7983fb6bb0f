"""The history of sent commands that a controller gets is what went on the wire."""

import numpy as np

from risc_experiments import offline
from risc_lab.command_history import ROWS, Channel
from risc_simulator.models import offline_link


def test_the_history_holds_what_went_on_the_wire(monkeypatch):
    loops, wires = [], {}

    class Loop(offline.ControlLoop):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            loops.append(self)

    class Link(offline_link.RadioLink):
        def submit(self, time_s, item, must_arrive=False):
            wires.setdefault(id(self), []).append((time_s, item))
            super().submit(time_s, item, must_arrive)

    monkeypatch.setattr(offline, "ControlLoop", Loop)
    monkeypatch.setattr(offline_link, "RadioLink", Link)
    flight = offline.Flight(vehicles=2, duration_s=1.0, perturbed=False)
    offline.fly(flight)
    (loop,) = loops
    _, _, types = offline.lab_of(flight)
    for history, kind, wire in zip(loop.sent.vehicles, types, wires.values(), strict=True):  # in the order of the fleet
        count = history.newest
        assert count == len(wire) > 300
        rows = [k % ROWS for k in range(count, count - 300, -1)]
        assert history.times_s[rows].tolist() == [time_s for time_s, _ in wire[: -300 - 1 : -1]]
        told = history.commands[rows]
        asked = np.array([(s.roll_rad, s.pitch_rad, s.climb_m_s, s.yaw_rate_rad_s) for _, s in wire[: -300 - 1 : -1]])
        gains = np.array((kind.roll.gain, kind.pitch.gain, 1.0, 1.0))
        assert np.abs(told - gains * asked).max() < 1e-12
        assert np.ptp(told[:, Channel.PHI]) > 0.01, "it was flown"
