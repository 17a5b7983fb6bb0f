"""Whether the vehicles of a fleet can fly a course, and how fast at most. No ROS.

By flatness a path determines what a vehicle must do at every moment. A course may use `course_share` of the full scales
of a type's commands (the rest is the controller's, for errors, wind and errors of the model), and `speed_max_m_s`.
Along the whole of every path, with the acceleration a of the reference, drag compensation included, these are checked
(in this order: the first that is exceeded is named):

    place      inside the fence, and above the floor
    speed
    tilt       atan(|a level| / (g + a up))
    climb      the command of the climb loop
    yaw rate   with what the yaw loop needs to follow it
    jerk       the tilt that is commanded to make the attitude loop, which lags, follow: a + 2 zeta / wn a' + a'' / wn^2
    fence      whether a vehicle there, at that speed, could still stop inside it: else its node would hold it

Each grows when the course is flown faster, so there is one greatest speed (`greatest_factor`).
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from risc_control.fence import Fence
from risc_control.reference_buffer import Axis, Order
from risc_control.safety import SafetyLimits, fence_of
from risc_control.trajectories import course_for_fleet, speed_factor, speed_text
from risc_control.vehicles import climb_command, climb_loops, greatest_command
from risc_control.waypoints import Waypoints
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab.fleet import widest_pair_m

_STEP_S = 0.02  # of the times that are checked; their least and greatest number
_FEWEST, _MOST = 400, 5000
_FENCE_EVERY = 4  # stride in these times for the check of the fence
_LEAST_HEIGHT_M = 0.3  # lower than this a controller assumes that a vehicle stands (integral_min_height_m)
_SLOWEST_WAYS = 0.5  # factor of ways to and from a slow course: the operator waits for them
_RANGE = 1e-2, 1e2  # of factors that are searched
_DIGITS = 1e-3  # relative precision of the search

_LEVEL = slice(Axis.X, Axis.Z)


class Excess(NamedTuple):
    """Demand of a course that a vehicle cannot meet."""

    type_name: str
    text: str  # which, how much is needed, and how much is allowed
    time_s: float  # on the course
    position_m: tuple  # at that time


def fleet_course(course, vehicles, arena, speed="", yaw=None, **numbers):
    """(Course that FleetVehicles can fly, factor by which it is faster than by its own numbers).

    course, numbers: see `make_course`.  speed: see `speed_factor`.  yaw: a YawProgram instead of its own, or None.
    Raises ValueError as `course_for_fleet`, `speed_factor` and `check_course`.
    """
    made = course_for_fleet(course, len(vehicles), arena, widest_pair_m(vehicles), **numbers).with_yaw(yaw)
    factor = speed_factor(made, speed)
    if speed == "" and isinstance(course, Waypoints) and not course.is_timed:  # its times are ours to choose
        factor = min(1.0, greatest_factor(made, vehicles, arena) or 1.0)
    if factor != 1.0:
        made = made.faster(factor)
    check_course(made, vehicles, arena, factor)
    return made, factor


def fleet_ways(limits, vehicles, factor=1.0):
    """WayLimits for the ways of FleetVehicles to and from a course that is flown `factor` times as fast.

    The ways are faster or slower by the same factor, but no slower than half. They use at most half of what the
    vehicles can do, unless `limits` allow more, or the course itself needs more.
    """
    types, faster = _types(vehicles), max(_SLOWEST_WAYS, factor)
    tilt_rad = min(kind.course_share * min(greatest_command(kind)[:2]) for kind in types)
    most = {
        "speed_m_s": min(kind.speed_max_m_s for kind in types),
        "acceleration_m_s2": GRAVITY_M_S2 * math.tan(tilt_rad),
        "yaw_rate_rad_s": min(kind.course_share * kind.yaw_rate_max_rad_s for kind in types),
    }
    powers = {"speed_m_s": 1, "acceleration_m_s2": 2, "yaw_rate_rad_s": 1}
    asked = {key: getattr(limits, key) for key in powers}
    scaled = {key: min(asked[key] * faster**power, max(asked[key], 0.5 * most[key])) for key, power in powers.items()}
    return replace(
        limits,
        **scaled,
        speed_most_m_s=min(limits.speed_most_m_s, most["speed_m_s"]),
        acceleration_most_m_s2=min(limits.acceleration_most_m_s2, most["acceleration_m_s2"]),
    )


def check_course(course, vehicles, arena, faster=1.0):
    """Raise ValueError, of one line, if FleetVehicles cannot fly a Course; any of them may fly any of its paths.

    It names what is exceeded, where, and the greatest speed at which the course can be flown.  faster: factor by which
    the course is faster than by its own numbers.
    """
    sampled, fences = _Sampled(course), _fences(vehicles, arena)
    excess = sampled.excess(fences)
    if excess is None:
        return
    factor = faster * _greatest_factor(sampled, fences)
    cure = "nor can it at any other speed"
    if factor:
        cure = "it can be flown at --speed %s or less" % speed_text(course.faster(1.0 / faster), factor)
    raise ValueError(
        "'%s' cannot be flown by type '%s': %s, %.1f s after its begin at (%.2f, %.2f, %.2f) m; %s"
        % (course.name, excess.type_name, excess.text, excess.time_s, *excess.position_m, cure)
    )


def greatest_factor(course, vehicles, arena):
    """Greatest factor by which FleetVehicles can fly a Course faster than it is, up to 100; 0: not at any speed."""
    return _greatest_factor(_Sampled(course), _fences(vehicles, arena))


def _greatest_factor(sampled, fences):
    low, high = _RANGE
    if sampled.excess(fences, low):
        return 0.0
    if not sampled.excess(fences, high):
        return high
    while high > (1.0 + _DIGITS) * low:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if sampled.excess(fences, middle) else (middle, high)
    return low


def _fences(vehicles, arena):
    """{VehicleType: Fence} of FleetVehicles."""
    limits = SafetyLimits(**fence_of(arena))
    return {vehicle_type: Fence(limits, vehicle_type) for vehicle_type in _types(vehicles)}


def _types(vehicles):
    return tuple(dict.fromkeys(vehicle.vehicle_type for vehicle in vehicles))


class _Sampled:
    """A course sampled over its period. Flown faster, each derivative grows by a power of the factor."""

    def __init__(self, course):
        count = min(max(_FEWEST, math.ceil(course.period_s / _STEP_S)), _MOST)
        self._times = course.period_s * np.arange(count) / count
        self._paths = [path.at(self._times, Order.SNAP) for path in course.paths]

    def excess(self, fences, factor=1.0):
        """Excess of the first type that cannot fly one of the paths `factor` times as fast; None: all types can.

        fences: {VehicleType: Fence}.
        """
        powers = (factor ** np.arange(1.0 + Order.SNAP))[:, None, None]
        for path in self._paths:
            for vehicle_type, fence in fences.items():
                found = _excess(powers * path, vehicle_type, fence)
                if found:
                    text, k = found
                    position_m = tuple(path[Order.POSITION, k, : Axis.PSI])
                    return Excess(vehicle_type.name, text, self._times[k] / factor, position_m)
        return None


def _excess(derivatives, vehicle_type, fence):
    """(text, index of the time) of the first limit that a path (5, t, 4) exceeds; None: none."""
    share, most = vehicle_type.course_share, greatest_command(vehicle_type)
    position, velocity = derivatives[Order.POSITION], derivatives[Order.VELOCITY]
    lift_m_s2 = GRAVITY_M_S2 + derivatives[Order.ACCELERATION, :, Axis.Z]
    drag_1_s = vehicle_type.drag_n_s_m / vehicle_type.mass_kg
    # the horizontal acceleration by tilt, with two derivatives
    level = derivatives[Order.ACCELERATION :, :, _LEVEL] + drag_1_s * derivatives[Order.VELOCITY : -1, :, _LEVEL]
    commands = [_through(level, loop) for loop in (vehicle_type.roll, vehicle_type.pitch)]

    found = _misplaced(position, fence)
    if found:
        return found
    most_deg = math.degrees(share * min(most.roll_rad, most.pitch_rad))
    climb = climb_loops([vehicle_type])[0]
    climbs = np.abs(climb_command(derivatives[Order.ACCELERATION, :, Axis.Z], velocity[:, Axis.Z], climb)) / climb.most
    yaw = velocity[:, Axis.PSI] + vehicle_type.yaw_rate_time_constant_s * derivatives[Order.ACCELERATION, :, Axis.PSI]
    tilts_deg = [np.degrees(np.arctan2(np.hypot(*a_m_s2.T), lift_m_s2)) for a_m_s2 in (level[0], *commands)]
    for what, values, limit, unit in (
        ("speed", np.linalg.norm(velocity[:, : Axis.PSI], axis=1), vehicle_type.speed_max_m_s, "m/s"),
        ("tilt", tilts_deg[0], most_deg, "deg"),
        ("climb", 100.0 * climbs, 100.0 * share, "% of full scale"),
        ("yaw rate", np.degrees(np.abs(yaw)), math.degrees(share * most.yaw_rate_rad_s), "deg/s"),
        ("jerk: a tilt command", np.maximum(*tilts_deg[1:]), most_deg, "deg"),
    ):
        k = int(values.argmax())
        if not values[k] <= limit * (1.0 + 1e-6):
            return "it asks for a %s of %.3g %s, a course may for %.3g" % (what, values[k], unit, limit), k
    for k in range(0, len(position), _FENCE_EVERY):
        pushes = [(*push[k], derivatives[Order.ACCELERATION, k, Axis.Z]) for push in (level[0], *commands)]
        if fence.leaves(position[k, : Axis.PSI], velocity[k, : Axis.PSI], pushes):
            return "at %.2f m/s it could not stop inside the fence" % np.linalg.norm(velocity[k, : Axis.PSI]), k
    return None


def _through(level, loop):
    """Acceleration to command so that an attitude loop makes this one (3, t, 2), given with two derivatives."""
    wn = loop.natural_frequency_rad_s
    return level[0] + 2.0 * loop.damping_ratio / wn * level[1] + level[2] / wn**2


def _misplaced(position, fence):
    """(text, index of the time) at which a path (t, 4) leaves the room; None: it does not."""
    low = int(position[:, Axis.Z].argmin())
    if position[low, Axis.Z] < _LEAST_HEIGHT_M:
        return "it leads lower than %.1f m" % _LEAST_HEIGHT_M, low
    outside = [k for k, at_m in enumerate(position[:, : Axis.PSI]) if fence.is_outside(at_m)]
    if outside:
        return "it leads out of the fence", max(outside, key=lambda k: np.abs(position[k, : Axis.PSI]).max())
    return None
