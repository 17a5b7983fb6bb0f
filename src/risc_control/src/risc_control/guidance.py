"""Pursuit of a moving virtual target by nonlinear guidance, inside the flatness controller (`Hows_controller.py`).

The law is that of Park, Deyst and How ("A new nonlinear guidance logic for trajectory tracking", AIAA 2004-4900): a
vehicle with speed V that sees its target at an angle eta off its course accelerates sideways by 2 V^2 / R* sin(eta).
That is the circle through its place and the target which its course touches, when the target is R* away; behind a
target that runs on a circle the vehicle ends up on the same circle. Along its course it keeps the range R*.

Horizontal vectors are complex numbers north + i east, as in `tracking`.
"""

from dataclasses import dataclass, fields

import numpy as np

from risc_control.tracking import FlatnessController

_LONGEST_STEP_S = 0.1  # out of sight: after a longer gap the pursuit begins anew, from where the vehicle is


@dataclass(frozen=True)
class GuidanceParams:
    """Settings of the pursuit. Range and speed gain are those of the original release."""

    range_m: float = 0.48  # R*: how far behind the target the vehicle flies
    speed_gain_1_s: float = 0.9  # acceleration along the course per error of speed
    range_gain_1_s: float = 0.25  # speed per error of range; a quarter of the speed gain would be critically damped
    speed_max_m_s: float = 0.6  # while it catches up
    slow_m_s: float = 0.05  # slower than this a vehicle has no course of its own: it heads for the target

    def __post_init__(self):
        for field in fields(self):
            value = getattr(self, field.name)
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError("%s must be a number > 0, got %r" % (field.name, value))


def pursuit_acceleration(position_m, velocity_m_s, target_m, target_speed_m_s, params):
    """Acceleration [m/s^2] (n,) complex of vehicles at positions and with velocities (n,) complex, behind targets.

    target: (n,) complex.  target_speed: of all targets.  A vehicle that is at its target is only slowed down.
    """
    line_m = target_m - position_m
    range_m, speed_m_s = np.abs(line_m), np.abs(velocity_m_s)
    slow = speed_m_s < params.slow_m_s
    towards = line_m / np.maximum(range_m, 1e-6)
    course = np.where(slow, towards, velocity_m_s / np.maximum(speed_m_s, params.slow_m_s))
    sight = towards * course.conjugate()  # cos(eta) + i sin(eta)
    # a target behind is turned to as hard as one abeam
    sine = np.where(sight.real >= 0.0, sight.imag, np.where(sight.imag < 0.0, -1.0, 1.0) * np.abs(sight))
    sideways = 2.0 * speed_m_s**2 / params.range_m * sine
    wanted_m_s = target_speed_m_s + params.range_gain_1_s * (range_m - params.range_m)
    wanted_m_s = np.clip(wanted_m_s, 0.0, params.speed_max_m_s)
    along = params.speed_gain_1_s * (wanted_m_s - (velocity_m_s * course.conjugate()).real)
    return (along + 1j * sideways) * course


class GuidanceController(FlatnessController):
    """Flies to its reference while that stands, and chases it once it runs. Height and yaw follow it all the time.

    The law steers a point that begins as the vehicle, and the vehicle flies to that point as to any reference. Fed back
    on the vehicle itself its low gains would let a trim of 0.1 m/s^2 change the range by half a metre.
    """

    guidance = GuidanceParams()
    target_speed_m_s = 0.0  # of the target that is chased; 0: fly to the reference itself
    range_m = np.array([np.nan])  # (n,) horizontal distance to the reference at the last update; NaN = not known
    _points = None  # (position, velocity) (n,) complex of the points that the law steers
    _points_s = -np.inf  # when they are there

    def update(self, stamp_s, now_s, states, present, ahead, usable, autonomous):
        """As `FlatnessController.update`; the reference is that of the target."""
        line_m = present[0, :, :2] - states.position_m[:, :2]
        self.range_m = np.where(usable & states.visible, np.hypot(line_m[:, 0], line_m[:, 1]), np.nan)
        if self.target_speed_m_s > 0.0:
            present, ahead = present.copy(), ahead.copy()
            self._steer(stamp_s, states, present[0], usable, autonomous)
            self._fill(present, 0.0)
            self._fill(ahead, self.horizon_s(stamp_s, now_s))
        else:
            self._points = None
        return super().update(stamp_s, now_s, states, present, ahead, usable, autonomous)

    def _steer(self, stamp_s, states, target, usable, autonomous):
        """Move the points on to stamp_s.

        The point of a vehicle that is seen, but not flown by us or without a target, is with it. While a vehicle is out
        of sight its state means nothing: its point runs on without it.
        """
        here = _complex(states.position_m), _complex(states.velocity_m_s)
        step_s, self._points_s = stamp_s - self._points_s, stamp_s
        if self._points is None or not 0.0 < step_s <= _LONGEST_STEP_S:
            self._points, self._acceleration, step_s = here, np.zeros_like(here[0]), 0.0
            self._seen_s = np.full(len(here[0]), -np.inf)
        runs_on = (stamp_s - self._seen_s <= _LONGEST_STEP_S) & (usable & autonomous | ~states.visible)
        self._seen_s = np.where(states.visible, stamp_s, self._seen_s)
        self._points = tuple(np.where(runs_on, *pair) for pair in zip(self._after(step_s), here))
        pursuit = pursuit_acceleration(*self._points, _complex(target), self.target_speed_m_s, self.guidance)
        self._acceleration = np.where(usable, pursuit, 0.0)

    def _after(self, time_s):
        position, velocity = self._points
        return position + time_s * (
            velocity + 0.5 * time_s * self._acceleration
        ), velocity + time_s * self._acceleration

    def _fill(self, reference, time_s):
        """The points that long after the last stamp into the horizontal axes of a reference (5, n, 4)."""
        reference[:, :, :2] = 0.0
        for order, value in enumerate((*self._after(time_s), self._acceleration)):
            reference[order, :, 0], reference[order, :, 1] = value.real, -value.imag


def _complex(xy):
    """North + i east of cortex vectors (n, 2 or more)."""
    return xy[:, 0] - 1j * xy[:, 1]
