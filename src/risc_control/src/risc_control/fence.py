"""The fence: whether a vehicle can still stop in the room inside the net. No ROS.

Its centre must stay `fence_margin_m` from the net; that of a type larger than an AR.Drone, farther by the difference.
Towards each side of that room, at the outward speed v and acceleration a, its stopping distance is

    d = v t + a p (t - p/2) + (v + a p)^2 / (2 b)

t is the time until it brakes fully: the ladder confirms (`fence_delay_s`), the command waits for its slot and passes
the link, and the attitude loop reverses the tilt; p is the same with half the time of that reversal. Where commands
change at a limited rate (`Adapter.swing_s`), both are longer by that. a is the acceleration by its tilt, or by the last
commanded tilt if that is worse. b is a share of the acceleration by the tilt with which it is braked (`braking`); for a
vehicle that does not fly itself it is the acceleration of the place that is held (`hover`).

Upwards a is 0, and its climb loop brakes. A vehicle that does not fly itself has no climb loop: a is the acceleration
by its thrust, and the floor is a side of the room, too. All of this is from the type's data.
"""

import math

from risc_control.braking import TILT_RAD
from risc_control.place_hold import PLACE_M_S2, STOPS_UP_M_S2
from risc_control.vehicles import adapter_class, greatest_command
from risc_lab.frames import GRAVITY_M_S2

_LOOK_S = 1.0 / 60.0
_TURNS = 1.5  # times 2 zeta / wn, the lag of an attitude loop: time until a tilt is reversed
_STILL = ((0.0,), (0.0,), (0.0,))  # no pushes, by axis
_FLOOR_M = 0.2  # lowest height of one that does not fly itself, cortex frame; below it may only land
_COUNTED_ON = 0.7  # share of the deceleration by a tilt that is counted on


class Fence:
    """The fence of one vehicle."""

    def __init__(self, limits, vehicle_type):
        """limits: SafetyLimits.  vehicle_type: VehicleType."""
        self.limits, wider_m = limits, vehicle_type.wider_m
        self.margin_m = limits.fence_margin_m + wider_m  # of its centre
        room_m = tuple((low + wider_m, high - wider_m) for low, high in limits.room_m)
        if any(low >= high for low, high in room_m):
            raise ValueError(
                "the fence leaves no room for a vehicle that reaches %.2f m: fence_min_m %r, fence_max_m %r"
                % (vehicle_type.radius_m, limits.fence_min_m, limits.fence_max_m)
            )
        adapter, most = adapter_class(vehicle_type), greatest_command(vehicle_type)
        self._room_m = self._flown_m = room_m
        loops = vehicle_type.roll, vehicle_type.pitch
        lag_s = max(2.0 * loop.damping_ratio / loop.natural_frequency_rad_s for loop in loops)
        told_s = limits.fence_delay_s + _LOOK_S + 1.0 / vehicle_type.command_rate_hz + vehicle_type.command_delay_s
        if adapter.FLIES_ITSELF:
            level_m_s2 = _COUNTED_ON * GRAVITY_M_S2 * math.tan(min(most.roll_rad, most.pitch_rad, TILT_RAD))
            up_m_s2 = _COUNTED_ON * vehicle_type.climb_max_m_s / vehicle_type.climb_time_constant_s
        else:
            level_m_s2, up_m_s2 = PLACE_M_S2, STOPS_UP_M_S2
            self._flown_m = *room_m[:2], (max(_FLOOR_M, room_m[2][0]), room_m[2][1])
        level = told_s + _TURNS * lag_s, told_s + 0.5 * _TURNS * lag_s, level_m_s2
        self._stops = level, level, (told_s, 0.0 if adapter.FLIES_ITSELF else told_s, up_m_s2)
        self._swing_s3_m = adapter.swing_s(vehicle_type) / GRAVITY_M_S2

    def is_outside(self, position_m):
        """Whether a position [m], cortex frame, is out of the room."""
        return any(not low <= at <= high for at, (low, high) in zip(position_m, self._room_m))

    def stop_m(self, axis, speed_m_s, push_m_s2=0.0):
        """Stopping distance [m] at an outward speed and acceleration."""
        brakes_s, pushed_s, brakes_m_s2 = self._stops[axis]
        swings_s = self._swing_s3_m * max(0.0, push_m_s2)
        pushed_s += 0.5 * swings_s
        gains_m_s = push_m_s2 * pushed_s
        coasts_m = speed_m_s * (brakes_s + swings_s) + gains_m_s * (brakes_s + swings_s - 0.5 * pushed_s)
        return max(0.0, coasts_m) + 0.5 * max(0.0, speed_m_s + gains_m_s) ** 2 / brakes_m_s2

    def leaves(self, position_m, velocity_m_s, pushes=()):
        """Whether it can no longer stop in the room. All (3,), cortex frame; of `pushes` the worst counts."""
        by_axis = zip(position_m, velocity_m_s, tuple(zip(*pushes)) or _STILL, self._flown_m)
        for axis, (at_m, speed_m_s, push_m_s2, (low, high)) in enumerate(by_axis):
            if at_m + self.stop_m(axis, speed_m_s, max(push_m_s2)) > high:
                return True
            if at_m - self.stop_m(axis, -speed_m_s, -min(push_m_s2)) < low:
                return True
        return False


def pushed_m_s2(phi_rad, theta_rad, psi_rad, up=1.0):
    """(3,) acceleration, cortex frame, by a tilt. up: the vertical part of the thrust, in weights."""
    forward, right = -up * _pushes(theta_rad), up * _pushes(phi_rad)
    cosine, sine = math.cos(psi_rad), math.sin(psi_rad)
    return forward * cosine - right * sine, -forward * sine - right * cosine, (up - 1.0) * GRAVITY_M_S2


def _pushes(tilt_rad):
    return GRAVITY_M_S2 * math.tan(max(-math.pi / 3.0, min(math.pi / 3.0, tilt_rad)))
