"""Climb rate of a vehicle on sticks by the commands that it was sent, and the error of that model. No ROS."""

import math

from risc_control.vehicles import climb_loops
from risc_lab.command_history import ROWS, Channel, last_by
from risc_lab.limits import within

_MAX_GAP_S = 0.2  # a longer gap between states restarts the observer
_OBSERVER_RAD_S, _TRIM_M_S2, _STEP_S = 2.0, 3.0, 0.02
_BLIND_S = 1.0  # the model is advanced by no more than this at once


class ClimbObserver:
    """Climb rate by the model of the climb loop, and its constant error, estimated by a slow observer.

    trim_m_s2: to be added to each command, as an upward acceleration. Commands in `sent` are without it.
    """

    def __init__(self, vehicle_type, sent):
        """sent: HISTORY of what the vehicle was sent."""
        self.climb_m_s = self.trim_m_s2 = 0.0
        self._loop = climb_loops([vehicle_type])[0]
        self._delay_s = vehicle_type.command_delay_s + 0.5 / vehicle_type.command_rate_hz  # waits for the next slot
        self._sent, self._time_s = sent, -math.inf
        last_by(sent, 0.0, sent.newest)  # loads the compiled code

    def measure(self, climb_m_s, time_s, learns):
        """The vehicle was measured to climb at this rate at time_s. learns: only the commands move it."""
        step_s = time_s - self._time_s
        if not learns or not 0.0 <= step_s <= _MAX_GAP_S:
            self.climb_m_s, self._time_s = climb_m_s, time_s
            return
        self.advance(time_s)
        self.correct(climb_m_s - self.climb_m_s, step_s)

    def correct(self, error_m_s, step_s):
        """It climbs faster than the model by error_m_s. step_s: since the last correction."""
        self.climb_m_s += min(1.0, 2.0 * _OBSERVER_RAD_S * step_s) * error_m_s
        self.trim_m_s2 = within(self.trim_m_s2 - _OBSERVER_RAD_S**2 * step_s * error_m_s, _TRIM_M_S2)

    def advance(self, until_s):
        """Advance the model to a time by the commands alone."""
        if until_s - self._time_s > _BLIND_S:
            self._time_s = until_s - _BLIND_S
        while self._time_s < until_s:
            step_s = min(_STEP_S, until_s - self._time_s)
            k = last_by(self._sent, self._time_s + 0.5 * step_s - self._delay_s, self._sent.newest)
            command = self._sent.commands[k % ROWS, Channel.CLIMB]
            up_m_s2 = self._loop.gain * command - self._loop.damping_1_s * self.climb_m_s
            self.climb_m_s += step_s * up_m_s2
            self._time_s += step_s
