"""An IRIS+ without sockets, for offline flights: serial line, board and radio as a clock of frames.

The board behaves as firmware/dueppm as shipped (configuration.h), except for its throttle lock after a failsafe (the
autopilot is landing by then), and for what it sends before its first message.
"""

import math
from collections import deque

import numpy as np

from risc_lab.limits import within
from risc_simulator.models.flight import FlightPhase
from risc_simulator.vehicles.iris.firmware import CENTRE_US, HALF_RANGE_US, RcFrame
from risc_simulator.vehicles.iris.sensors import IrisSensors
from risc_simulator.vehicles.iris.transmitter import LINE_S, radio_delay_s, telemetry_delay_s

FRAME_S = 0.020
FAILSAFE_S = 0.5  # without sticks
FAILSAFE_US = (1500, 1500, 950, 1500)
FRACTION_MAX = 1.001  # a message with a larger one is refused
JUMP = 0.25  # of a fraction: a larger one is accepted only if the next message confirms it (controls_check.h)
SLEW_US = 100  # greatest change of a channel from one frame to the next (sticks.h)


class OfflineLink:
    """See models/offline_link.py."""

    REPORT_PERIOD_S = 0.1

    def __init__(self, vehicle, phase, noise=1.0):
        self.vehicle = vehicle
        self._delay_s = radio_delay_s(vehicle.plant)
        self._frame_s = phase * FRAME_S  # when the next frame begins
        self._coming = deque()  # (time, fractions) on the line to the board
        self._accepted = self._doubted = _NONE
        self._sent_us = FAILSAFE_US  # in the newest frame
        self._rng = np.random.default_rng(int(phase * 2**32))  # the seed determines the phase
        self._sensors = IrisSensors(vehicle, self._rng, noise)

    def send(self, sticks, now_s, level_only=False):
        """Send sticks as serial_node does: phi, theta, T, psi, with the signs of the angles."""
        self._coming.append((now_s + LINE_S, (-sticks.left, -sticks.forward, sticks.up, -sticks.turn_left)))

    def order(self, action, now_s):
        """Send a FlightAction by telemetry: TAKE_OFF only arms in STABILIZE, the throttle does the rest."""
        self.vehicle.schedule(now_s + self.vehicle.plant.command_delay_s, action)

    def deliver(self, now_s):
        """Send all frames that have begun."""
        while self._frame_s <= now_s:
            while self._coming and self._coming[0][0] <= self._frame_s:
                self._judge(self._coming.popleft())
            heard_s, fractions = self._accepted
            if fractions is not None:  # until the first sticks the board sends nothing
                silent = self._frame_s - heard_s > FAILSAFE_S
                goal_us = FAILSAFE_US if silent else _channels_us(fractions)
                self._sent_us = tuple(us + within(goal - us, SLEW_US) for us, goal in zip(self._sent_us, goal_us))
                self.vehicle.schedule(self._frame_s + self._delay_s, RcFrame(self._sent_us))
            self._frame_s += FRAME_S

    def _judge(self, message):
        """Accept, doubt or refuse a message (time, fractions), as the board does."""
        if not all(abs(fraction) <= FRACTION_MAX for fraction in message[1]):
            return
        # a flight that begins in the air had sticks before: they need no confirmation
        begins = self._accepted is _NONE and self.vehicle.phase is FlightPhase.FLYING
        believed = begins or _agree(self._doubted, message) or _agree(self._accepted, message)
        self._doubted = _NONE
        if believed:
            self._accepted = message[0], tuple(within(fraction, 1.0) for fraction in message[1])
            if begins:
                self._sent_us = _channels_us(self._accepted[1])
        else:
            self._doubted = message

    def lose(self, now_s):
        """Nothing to do: the board's failsafe follows by itself."""

    @property
    def phase(self):
        """FlightPhase as its driver knows it: FLYING from arming on, also while it still stands on the ground."""
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


_NONE = -math.inf, None


def _agree(known, message):
    (known_s, fractions), (now_s, others) = known, message
    is_recent = now_s - known_s < FAILSAFE_S
    return is_recent and all(abs(other - fraction) <= JUMP for fraction, other in zip(fractions, others))


def _channels_us(fractions):
    return tuple(CENTRE_US + round(HALF_RANGE_US * fraction) for fraction in fractions)
