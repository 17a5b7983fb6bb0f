"""An IRIS+ without sockets, for offline flights: serial line, board and radio as a clock of frames.

The board is as firmware/dueppm is shipped (configuration.h); its limits of plausibility and slew are not here.
"""

import math
from collections import deque

import numpy as np

from risc_simulator.models.flight import FlightPhase
from risc_simulator.vehicles.iris.firmware import CENTRE_US, HALF_RANGE_US, RcFrame
from risc_simulator.vehicles.iris.sensors import IrisSensors
from risc_simulator.vehicles.iris.transmitter import LINE_S, radio_delay_s, telemetry_delay_s

FRAME_S = 0.020
FAILSAFE_S = 0.5  # without sticks
FAILSAFE_US = (1500, 1500, 950, 1500)


class OfflineLink:
    """See models/offline_link.py."""

    REPORT_PERIOD_S = 0.1

    def __init__(self, vehicle, phase, noise=1.0):
        self.vehicle = vehicle
        self._delay_s = radio_delay_s(vehicle.plant)
        self._frame_s = phase * FRAME_S  # when the next frame begins
        self._coming = deque()  # (time, channels) on the line to the board
        self._heard_s, self._channels_us = math.inf, None  # until the first sticks the board sends nothing
        self._rng = np.random.default_rng(int(phase * 2**32))  # the phase is the seed's
        self._sensors = IrisSensors(vehicle, self._rng, noise)

    def send(self, sticks, now_s, level_only=False):
        """As serial_node sends them: phi, theta, T, psi, with the signs of the angles."""
        fractions = -sticks.left, -sticks.forward, sticks.up, -sticks.turn_left
        channels = tuple(CENTRE_US + round(HALF_RANGE_US * min(1.0, max(-1.0, f))) for f in fractions)
        self._coming.append((now_s + LINE_S, channels))

    def order(self, action, now_s):
        """By telemetry: TAKE_OFF arms in STABILIZE, and the rest is the throttle's."""
        self.vehicle.schedule(now_s + self.vehicle.plant.command_delay_s, action)

    def deliver(self, now_s):
        """Send all frames that have begun."""
        while self._frame_s <= now_s:
            while self._coming and self._coming[0][0] <= self._frame_s:
                self._heard_s, self._channels_us = self._coming.popleft()
            if self._channels_us is not None:
                silent = self._frame_s - self._heard_s > FAILSAFE_S
                frame = RcFrame(FAILSAFE_US if silent else self._channels_us)
                self.vehicle.schedule(self._frame_s + self._delay_s, frame)
            self._frame_s += FRAME_S

    def lose(self, now_s):
        """The board's failsafe follows by itself."""

    @property
    def phase(self):
        """Armed it flies, for who hears no more than that, until it lands."""
        phase, logic = self.vehicle.phase, self.vehicle.firmware
        return FlightPhase.FLYING if phase is FlightPhase.LANDED and logic.armed else phase

    @property
    def report_delay_s(self):
        return telemetry_delay_s(self.vehicle.firmware, self._rng)

    def report(self, now_s):
        read = self._sensors.read(now_s)
        said = {
            "tilt_rad": (read.roll_rad, read.pitch_rad),
            "height_m": read.altitude_m,
            "climb_m_s": read.climb_m_s,
        }
        return self.phase, round(read.battery_pct), said
