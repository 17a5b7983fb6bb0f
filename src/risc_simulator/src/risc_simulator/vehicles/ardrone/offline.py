"""An AR.Drone without sockets, for offline flights: see vehicles/__init__.py."""

import math

import numpy as np

from ardrone_autonomy.link import LOST_S
from risc_simulator.models import offline_link
from risc_simulator.models.flight import FlightAction, Setpoint
from risc_simulator.vehicles.ardrone.firmware import LOST_HOVER_S
from risc_simulator.vehicles.ardrone.sensors import ArdroneSensors


class OfflineLink(offline_link.OfflineLink):
    """See models/offline_link.py. Without new commands the aircraft keeps to the last one, then hovers, then lands."""

    _alarm_s = math.inf  # when it acts on the silence of its driver

    def __init__(self, vehicle, phase, noise=1.0):
        super().__init__(vehicle, phase)
        rng = np.random.default_rng(int(phase * 2**32))  # the seed determines the phase
        self._sensors = ArdroneSensors(rng, noise, flow=lambda: vehicle.firmware.flow)

    def send(self, sticks, now_s, level_only=False):
        self._alarm_s = now_s + LOST_S
        super().send(sticks, now_s, level_only)

    def order(self, action, now_s):
        self._alarm_s = now_s + LOST_S
        super().order(action, now_s)

    def deliver(self, now_s):
        super().deliver(now_s)
        if now_s > self._alarm_s:
            self._alarm_s = math.inf
            self.lose(now_s - LOST_S)

    def report(self, now_s):
        state, logic = self.vehicle.state, self.vehicle.firmware
        forward_m_s, right_m_s, _ = self._sensors.velocity_m_s(state) if logic.motors_on else (0.0, 0.0, 0.0)
        return *super().report(now_s)[:2], {"velocity_m_s": (forward_m_s, right_m_s)}

    def lose(self, now_s):
        """Let the aircraft notice the loss, hover, and land."""
        self.vehicle.schedule(now_s + LOST_S, Setpoint(hover=True))
        self.vehicle.schedule(now_s + LOST_S + LOST_HOVER_S, FlightAction.LAND)
