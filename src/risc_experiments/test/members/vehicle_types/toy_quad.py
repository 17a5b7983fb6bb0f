"""A type that differs from the AR.Drone in all that an adapter may: radians on /controls, and a stick for thrust.

`up` is the thrust as a fraction of twice the weight, less a half: it holds no height by itself.
"""

import numpy as np

from risc_control import vehicles
from risc_control.joystick import Sticks, limited
from risc_lab.frames import GRAVITY_M_S2

CLIMB_GAIN_1_S = 3.0  # of the climb rate, when nobody commands a thrust


class Adapter(vehicles.Adapter):
    """See the module."""

    @staticmethod
    def climb_loop(vehicle_type):
        """It takes an acceleration, up to its weight more or less."""
        return 1.0, 0.0, GRAVITY_M_S2

    def answer(self, controls, own, own_s, now_s, sent):
        """Radians and newtons -> fractions."""
        return self._sticks(-controls.theta, -controls.phi, controls.thrust_n, -controls.psi)

    def move(self, forward_rad, left_rad, climb_m_s, own):
        """Holds the climb rate by the thrust."""
        up_m_s2 = CLIMB_GAIN_1_S * (climb_m_s - own.velocity_m_s[2]) if own else 0.0
        return self._sticks(forward_rad, left_rad, self.type.mass_kg * (GRAVITY_M_S2 + up_m_s2), 0.0)

    def by_hand(self, sticks, own):
        """The operator's `up` is a climb rate."""
        up = self.move(0.0, 0.0, sticks.up * self.type.climb_max_m_s, own).up
        return sticks._replace(up=up)

    def settles_at(self, sticks):
        """Its climb loop takes an acceleration."""
        roll_rad, pitch_rad = (-tilt * self.type.tilt_max_rad for tilt in (sticks.left, sticks.forward))
        yaw_rate_rad_s = -sticks.turn_left * self.type.yaw_rate_max_rad_s
        return np.array((roll_rad, pitch_rad, sticks.up * GRAVITY_M_S2, yaw_rate_rad_s))

    def _sticks(self, forward_rad, left_rad, thrust_n, left_rad_s):
        tilt_rad, weight_n = self.type.tilt_max_rad, self.type.mass_kg * GRAVITY_M_S2
        sticks = forward_rad / tilt_rad, left_rad / tilt_rad, thrust_n / weight_n - 1.0
        return Sticks(*map(limited, sticks), limited(left_rad_s / self.type.yaw_rate_max_rad_s))
