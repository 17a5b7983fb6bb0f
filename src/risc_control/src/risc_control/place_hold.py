"""Position hold of a vehicle on sticks, by motion capture: the thesis' "simple PID controller" (5.2.2). No ROS.

It holds a place that moves with limited acceleration: where an operator's sticks send it, out of another vehicle's way,
up after a take-off and down to the floor. The place starts with the position and velocity of the vehicle.
"""

import math

from risc_control.flatness import Acceleration, flat_inputs, limit_tilt, thrust_at_tilt
from risc_control.vehicles import Command
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.limits import within

PLACE_M_S2, PLACE_UP_M_S2 = 1.0, 0.8  # acceleration of the place that is held; the fence counts on the former
STOP_M_S2 = 2.5  # its deceleration: others, or the floor, may be in its way;
STOPS_UP_M_S2 = 1.4  # the part of it that the fence counts on, up and down
LEASH_M = 0.3  # on the way up or down the place is no farther above or below the vehicle: the floor may stop it

# Acceleration by error, its rate and its integral.
_POSITION_1_S2, _VELOCITY_1_S, _INTEGRAL_1_S3, _INTEGRAL_M_S2 = 3.0, 2.8, 0.7, 0.8
_HEIGHT_1_S2, _CLIMB_1_S = 5.0, 3.5
_YAW_1_S, _YAW_RATE_RAD_S = 1.0, 0.5
_TILT_RAD, _UP_M_S2 = math.radians(20.0), 3.0
_FAR_M = 0.5  # larger errors are limited to this


class PlaceHold:
    """One vehicle. Cortex frame; `own` is its `vehicle_pilot.OwnState`."""

    def __init__(self, mass_kg):
        self._mass_kg = mass_kg
        self._place_m, self._place_m_s, self._psi_rad = [0.0] * 3, [0.0] * 3, 0.0  # that is held, and its motion
        self._integral_m_s2 = [0.0, 0.0]
        flat_inputs(limit_tilt(Acceleration(0.0, 0.0, GRAVITY_M_S2), _TILT_RAD)[0], 0.0, 0.0, 1.0)  # loads the
        thrust_at_tilt(GRAVITY_M_S2, 0.0, 0.0, 1.0)  # compiled code

    @property
    def height_m(self):
        """Height of the place that is held."""
        return self._place_m[2]

    def begin(self, own):
        """Start from the position and velocity of the vehicle."""
        self._place_m, self._place_m_s, self._psi_rad = list(own.position_m), list(own.velocity_m_s), own.psi_rad
        self._integral_m_s2 = [0.0, 0.0]

    def command(self, own, step_s, velocity_m_s, yaw_rate_rad_s, leash_m=math.inf):
        """`Command` that holds the place, whose velocity changes towards velocity_m_s.

        step_s: since the last call.  yaw_rate_rad_s: of the heading that is held, + clockwise.  leash_m: the place is
        no farther above or below the vehicle.
        """
        wanted_m_s2 = [0.0] * 3
        for axis, most_m_s2 in enumerate((PLACE_M_S2, PLACE_M_S2, PLACE_UP_M_S2)):
            if abs(velocity_m_s[axis]) < abs(self._place_m_s[axis]):
                most_m_s2 = STOP_M_S2
            change_m_s = within(velocity_m_s[axis] - self._place_m_s[axis], most_m_s2 * step_s)
            self._place_m_s[axis] += change_m_s
            self._place_m[axis] += step_s * self._place_m_s[axis]
            wanted_m_s2[axis] = change_m_s / step_s if step_s > 0.0 else 0.0
        if leash_m < math.inf:
            self._place_m[2] = own.position_m[2] + within(self._place_m[2] - own.position_m[2], leash_m)
        errors_m = [place - is_m for place, is_m in zip(self._place_m, own.position_m)]
        errors_m_s = [place - is_m_s for place, is_m_s in zip(self._place_m_s, own.velocity_m_s)]
        for axis in (0, 1):
            grown = self._integral_m_s2[axis] + step_s * _INTEGRAL_1_S3 * errors_m[axis]
            self._integral_m_s2[axis] = within(grown, _INTEGRAL_M_S2)
            wanted_m_s2[axis] += _POSITION_1_S2 * within(errors_m[axis], _FAR_M) + _VELOCITY_1_S * errors_m_s[axis]
            wanted_m_s2[axis] += self._integral_m_s2[axis]
        wanted_m_s2[2] += _HEIGHT_1_S2 * within(errors_m[2], _FAR_M) + _CLIMB_1_S * errors_m_s[2]
        up_m_s2 = within(wanted_m_s2[2], _UP_M_S2)
        self._psi_rad += step_s * yaw_rate_rad_s
        error_rad = math.remainder(self._psi_rad - own.psi_rad, math.tau)
        turn_rad_s = yaw_rate_rad_s + within(_YAW_1_S * error_rad, _YAW_RATE_RAD_S)
        # cortex x, y, z are north, west, up
        f = limit_tilt(Acceleration(wanted_m_s2[0], -wanted_m_s2[1], GRAVITY_M_S2 + up_m_s2), _TILT_RAD)[0]
        roll_rad, pitch_rad, turn_rad_s, _ = flat_inputs(f, own.psi_rad, turn_rad_s, self._mass_kg)
        return Command(roll_rad, pitch_rad, turn_rad_s, thrust_at_tilt(f.up, own.phi_rad, own.theta_rad, self._mass_kg))


def stops_m_s(way_m):
    """Speed from which the place that is held stops within way_m, up or down."""
    return math.sqrt(PLACE_UP_M_S2 * max(0.0, way_m))  # at half of its acceleration
