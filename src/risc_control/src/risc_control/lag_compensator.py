"""Delay compensation of a whole fleet, without a controller: predicted states when a command sent now takes effect.

The prediction is that of the controllers (`delay_prediction`) without what they learn in flight: the nominal model and
the commands actually sent, the last of which is taken to stay in force. Needs no ROS.
"""

import numpy as np

from risc_control.delay_prediction import MAX_HORIZON_S, Motion, fill_in_force, plants, predicted, steps_of
from risc_lab.command_history import CHANNELS, ROWS, CommandHistory
from risc_lab.compiled import compiled
from risc_lab.frames import wrap_one_angle
from risc_lab.states import S, States

_KNOWN_S = 0.5  # a vehicle that was sent nothing for this long follows no commands that are known


class LagCompensator:
    """Predictor for n vehicles. `sent`: CommandHistory, for the caller to fill; `delay_s` (n,) [s]: see `plants`."""

    def __init__(self, vehicle_types):
        """vehicle_types: VehicleType of each. Raises ValueError when the delay of one cannot be predicted."""
        types = list(dict.fromkeys(vehicle_types))
        self._kinds, self._plants = np.array([types.index(kind) for kind in vehicle_types]), plants(types)
        self.sent, self.delay_s = CommandHistory(len(vehicle_types)), self._plants["delay_s"][self._kinds]
        none = np.zeros(len(vehicle_types), dtype=bool)
        self.ahead(0.0, 0.0, States(none, np.zeros((len(none), len(S)))))  # loads the compiled code

    def ahead(self, stamp_s, now_s, states):
        """States of the visible vehicles when a command that is sent at now_s takes effect. states: States of stamp_s.

        A vehicle that was sent nothing lately stays where it was seen. Raises ValueError when that time is too far
        ahead to be predicted.
        """
        age_s = max(0.0, now_s - stamp_s)
        if not age_s + self.delay_s.max() <= MAX_HORIZON_S:
            raise ValueError("states of %.2g s ago cannot be predicted over the delay of their commands" % age_s)
        x = states.x.copy()
        _ahead(float(stamp_s), age_s, self._kinds, self._plants, self.sent.vehicles, states.visible, x)
        return States(states.visible, x)


@compiled
def _ahead(stamp_s, age_s, kinds, plants, sent, visible, x):
    """Predict the visible (n,) rows of x (n, 12), in place."""
    most = 1
    for k in range(len(plants)):
        most = max(most, steps_of(age_s + plants[k].delay_s))
    in_force = np.empty((1 + most, CHANNELS))
    for i in range(len(kinds)):
        plant, own = plants[kinds[i]], sent[i]
        if not visible[i] or not stamp_s - own.times_s[own.newest % ROWS] < _KNOWN_S:
            continue
        ahead_s, state = age_s + plant.delay_s, x[i]
        under_way = in_force[: 1 + steps_of(ahead_s)]
        fill_in_force(own, own, plant, stamp_s, under_way)
        now = Motion(
            state[S.X], -state[S.Y], state[S.Z], state[S.U], -state[S.V], state[S.W], state[S.PHI], state[S.THETA],
            state[S.PSI], state[S.P], state[S.Q], state[S.R], 0.0,
        )  # fmt: skip
        then = predicted(now, plant, ahead_s, under_way)
        state[S.X], state[S.Y], state[S.Z] = then.north_m, -then.east_m, then.up_m
        state[S.U], state[S.V], state[S.W] = then.north_m_s, -then.east_m_s, then.up_m_s
        state[S.PHI], state[S.THETA], state[S.PSI] = then.phi_rad, then.theta_rad, wrap_one_angle(then.psi_rad)
        state[S.P], state[S.Q], state[S.R] = then.phi_rate_rad_s, then.theta_rate_rad_s, then.psi_rate_rad_s
