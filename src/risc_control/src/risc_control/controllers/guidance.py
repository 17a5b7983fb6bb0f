"""Pursuit of a moving virtual target by nonlinear guidance, inside `differential_flatness` (`Hows_controller.py`).

The law is that of Park, Deyst and How ("A new nonlinear guidance logic for trajectory tracking", AIAA 2004-4900): a
vehicle with speed V that sees its target at an angle eta off its course accelerates sideways by 2 V^2 / R* sin(eta).
With the target R* away, this is the circle through vehicle and target that is tangent to the course; behind a target
that moves on a circle the vehicle converges to the same circle. Along its course it keeps the range R*.

Horizontal vectors are complex numbers, north + i east.
"""

import math
from dataclasses import dataclass

import numpy as np

from risc_control.controllers import differential_flatness
from risc_control.reference_buffer import Axis
from risc_lab.settings import Positive
from risc_lab.states import S

_LONGEST_STEP_S = 0.1  # vehicle not seen: after a longer gap the pursuit restarts from where the vehicle is
_AT_TARGET_M = 1e-6  # nearer than this the direction to the target is undefined


@dataclass(frozen=True)
class Params(differential_flatness.Params):
    """Parameters of the pursuit and of `differential_flatness`. Range and speed gain are the original release's."""

    range_m: Positive = 0.48  # R*: how far behind the target the vehicle flies
    speed_gain_1_s: Positive = 0.9  # acceleration along the course per error of speed
    range_gain_1_s: Positive = 0.25  # speed per error of range; a quarter of the speed gain would be critically damped
    speed_max_m_s: Positive = 0.6  # while it catches up
    slow_m_s: Positive = 0.05  # slower than this the course is undefined: the direction to the target is used


def pursuit_acceleration(position_m, velocity_m_s, target_m, target_speed_m_s, params):
    """Acceleration [m/s^2] of a vehicle behind a target that has this speed.

    A vehicle that is at its target is only slowed down.
    """
    line_m, speed_m_s = target_m - position_m, abs(velocity_m_s)
    range_m = abs(line_m)
    direction = line_m / max(range_m, _AT_TARGET_M)
    course = direction if speed_m_s < params.slow_m_s else velocity_m_s / speed_m_s
    off = direction * course.conjugate()  # cos(eta) + i sin(eta)
    sin_eta = off.imag
    if off.real < 0.0:  # turn to a target behind as hard as to one abeam
        sin_eta = (-1.0 if sin_eta < 0.0 else 1.0) * abs(off)
    sideways = 2.0 * speed_m_s**2 / params.range_m * sin_eta
    wanted_m_s = target_speed_m_s + params.range_gain_1_s * (range_m - params.range_m)
    wanted_m_s = min(max(wanted_m_s, 0.0), params.speed_max_m_s)
    along = params.speed_gain_1_s * (wanted_m_s - (velocity_m_s * course.conjugate()).real)
    return (along + 1j * sideways) * course


@dataclass
class _Point:
    """The point that the guidance law steers in place of a vehicle."""

    position_m: complex = 0j
    velocity_m_s: complex = 0j
    acceleration_m_s2: complex = 0j
    seen_s: float = -math.inf  # when its vehicle was seen last

    def after(self, time_s):
        """(position, velocity, acceleration) after time_s."""
        a = self.acceleration_m_s2
        velocity_m_s = self.velocity_m_s + time_s * a
        return self.position_m + 0.5 * time_s * (self.velocity_m_s + velocity_m_s), velocity_m_s, a


class Controller(differential_flatness.Controller):
    """Flies to its reference while that stands still, and pursues it once it moves. Height and yaw always follow it.

    The law steers a point that starts at the vehicle, and the vehicle tracks that point like any reference. Applied to
    the vehicle itself, its low gains would let a trim error of 0.1 m/s^2 change the range by half a metre.
    """

    PARAMS = Params
    target_speed_m_s = 0.0  # of the target that is pursued; 0: fly to the reference itself
    range_m = np.array([np.nan])  # (n,) horizontal distance to the reference at the last update; NaN = not known
    _points = ()  # one per vehicle, while the target moves
    _points_s = -math.inf  # time of their positions

    def step(self, t, states, reference, params):
        """As `controllers.Controller`; the reference is that of the target."""
        x, visible = states.vehicles.x, states.vehicles.visible
        line_m = reference.present[0, :, : Axis.Z] - x[:, : S.Z]
        self.range_m = np.where(reference.usable & visible, np.hypot(line_m[:, 0], line_m[:, 1]), np.nan)
        if self.target_speed_m_s > 0.0:
            present, ahead = reference.present.copy(), reference.ahead.copy()
            self._steer(t.stamp_s, states, reference, params)
            self._fill(present, np.zeros(len(visible)))
            self._fill(ahead, max(0.0, t.now_s - t.stamp_s) + self.delay_s)
            reference = reference._replace(present=present, ahead=ahead)
        else:
            self._points = ()
        return super().step(t, states, reference, params)

    def _steer(self, stamp_s, states, reference, params):
        """Move the points on to stamp_s.

        The point of a vehicle that is seen, but that we do not fly or that has no target, is put at the vehicle. While
        a vehicle is not seen, its point moves on without it.
        """
        (seen, x), target, usable = states.vehicles, reference.present[0], reference.usable
        step_s, self._points_s = stamp_s - self._points_s, stamp_s
        if not self._points or not 0.0 < step_s <= _LONGEST_STEP_S:
            self._points = [_Point() for _ in seen]
        for i, point in enumerate(self._points):
            visible, row = seen[i], x[i].tolist()
            recently = stamp_s - point.seen_s <= _LONGEST_STEP_S
            if recently and (not visible or (usable[i] and states.autonomous[i])):
                point.position_m, point.velocity_m_s, _ = point.after(step_s)
            else:
                point.position_m, point.velocity_m_s = complex(row[S.X], -row[S.Y]), complex(row[S.U], -row[S.V])
            if visible:
                point.seen_s = stamp_s
            point.acceleration_m_s2 = 0j
            if usable[i]:
                target_m = complex(target[i, Axis.X], -target[i, Axis.Y])
                point.acceleration_m_s2 = pursuit_acceleration(
                    point.position_m, point.velocity_m_s, target_m, self.target_speed_m_s, params
                )

    def _fill(self, reference, times_s):
        """Write the points, times_s (n,) after the last stamp, to the horizontal axes of a reference (5, n, 4)."""
        reference[:, :, : Axis.Z] = 0.0
        for i, point in enumerate(self._points):
            for order, vector in enumerate(point.after(times_s[i])):
                reference[order, i, Axis.X], reference[order, i, Axis.Y] = vector.real, -vector.imag
