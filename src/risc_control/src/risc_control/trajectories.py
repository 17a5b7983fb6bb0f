"""Courses: paths of several vehicles with exact derivatives up to snap, yaw programs, and smooth ways between them.

A course is a set of paths, one a vehicle, that keep the vehicles apart. `COURSES` holds them by name: each entry makes
the course for a number of vehicles, `make_course("flat8", 3)`. Add a function to `COURSES` and it is a name for every
node and for `--trajectory`.

Frame: cortex (x forward, y left, z up), metres, seconds. Yaw psi is + clockwise seen from above (NED sense), radians;
at yaw psi the nose points along (cos psi, -sin psi). Arrays of derivatives have the order (0 = position ... 4 = snap)
as their first axis.
"""

import inspect
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BPoly

ORDERS = 5  # position, velocity, acceleration, jerk, snap
YAW_ORDERS = 3  # yaw, its rate, its acceleration

# Courses of chapter 6 and of the original release.
COURSE_HEIGHT_M = 1.0
SAFE_SEPARATION_M = 0.75  # between centres: AR.Drones are 0.55 m wide with their hull
_SLOWEST_ALONG_PATH_M_S = 0.05  # below this speed a path has no direction worth turning the nose to

# Derivatives of cos(w t + p) by order: w^k times one of cos, -sin, -cos, sin, cos.
_COS_SIGN = np.array([1.0, 0.0, -1.0, 0.0, 1.0]).reshape(ORDERS, 1, 1, 1)
_SIN_SIGN = np.array([0.0, -1.0, 0.0, 1.0, 0.0]).reshape(ORDERS, 1, 1, 1)


class HarmonicPaths:
    """Paths of n vehicles: centre + sum of amplitude cos(frequency t + phase) in every axis."""

    def __init__(self, centre_m, amplitude_m, frequency_rad_s, phase_rad, period_s):
        """centre: (n, 3).  amplitude, frequency, phase: broadcast to (n, 3, terms).  period_s: of the whole course."""
        self.centre_m = np.array(centre_m, dtype=float)
        shape = self.centre_m.shape + (np.shape(amplitude_m)[-1],)
        amplitude, frequency, phase = (
            np.broadcast_to(np.asarray(part, dtype=float), shape) for part in (amplitude_m, frequency_rad_s, phase_rad)
        )
        self._frequency, self._phase = frequency.copy(), phase.copy()
        scaled = amplitude * frequency ** np.arange(ORDERS).reshape(ORDERS, 1, 1, 1)
        self._of_cos, self._of_sin = scaled * _COS_SIGN, scaled * _SIN_SIGN
        self.period_s = period_s

    def __len__(self):
        return len(self.centre_m)

    def at(self, times_s):
        """(5, n, 3) position to snap, every vehicle at its own time (n,) or all at one (scalar).

        Paths of a single vehicle take any number of times (k,) and return (5, k, 3).
        """
        phase = self._frequency * np.reshape(times_s, (-1, 1, 1)) + self._phase
        result = (self._of_cos * np.cos(phase) + self._of_sin * np.sin(phase)).sum(axis=3)
        result[0] += self.centre_m
        return result

    def reordered(self, order):
        """The same paths in another order of the vehicles."""
        other = object.__new__(HarmonicPaths)
        order = np.asarray(order)
        other.centre_m, other.period_s = self.centre_m[order], self.period_s
        other._frequency, other._phase = self._frequency[order], self._phase[order]
        other._of_cos, other._of_sin = self._of_cos[:, order], self._of_sin[:, order]
        return other


class WaypointTour:
    """Paths of n vehicles through points in turn: rest at each, then a smooth move to the next, for ever."""

    def __init__(self, points_m, rest_s, move_s):
        """points_m: (n, stops, 3), the stops of every vehicle."""
        self.points_m = np.array(points_m, dtype=float)
        self._rest_s, self._move_s = rest_s, move_s
        self.period_s = (rest_s + move_s) * self.points_m.shape[1]

    def __len__(self):
        return len(self.points_m)

    def at(self, times_s):
        """As `HarmonicPaths.at`."""
        n, stops = self.points_m.shape[:2]
        times, rows = np.broadcast_arrays(np.asarray(times_s, dtype=float), np.arange(n))
        leg, within_s = np.divmod(times, self._rest_s + self._move_s)
        leg = leg.astype(int) % stops
        start, end = self.points_m[rows, leg], self.points_m[rows, (leg + 1) % stops]
        blend = smooth_step((within_s - self._rest_s) / self._move_s)
        blend /= self._move_s ** np.arange(ORDERS)[:, None]
        result = blend[:, :, None] * (end - start)
        result[0] += start
        return result

    def reordered(self, order):
        """The same paths in another order of the vehicles."""
        return WaypointTour(self.points_m[np.asarray(order)], self._rest_s, self._move_s)


# ---------------------------------------------------------------------------------------------------------- yaw


@dataclass(frozen=True)
class YawProgram:
    """Yaw over time: constant, turning at a constant rate, or along the path."""

    offsets_rad: tuple = (0.0,)  # one for all vehicles, or one a vehicle
    rate_rad_s: float = 0.0
    along_path: bool = False  # the nose leads; offsets are added

    def at(self, times_s, derivatives_m):
        """(3, n) yaw, rate, acceleration at times (n,) on paths with derivatives (5, n, 3). Not wrapped."""
        n = derivatives_m.shape[1]
        offsets = np.broadcast_to(np.asarray(self.offsets_rad), n)
        result = np.zeros((YAW_ORDERS, n))
        result[0] = offsets + self.rate_rad_s * times_s
        result[1] = self.rate_rad_s
        if self.along_path:
            (vx, vy), (ax, ay), (jx, jy) = (derivatives_m[k, :, :2].T for k in (1, 2, 3))
            square = np.maximum(vx * vx + vy * vy, _SLOWEST_ALONG_PATH_M_S**2)
            cross, dot = vx * ay - vy * ax, vx * ax + vy * ay
            result[0] -= np.arctan2(vy, vx)
            result[1] -= cross / square
            result[2] -= (vx * jy - vy * jx) / square - 2.0 * cross * dot / square**2
        return result

    def reordered(self, order):
        """The same program for another order of the vehicles."""
        if len(self.offsets_rad) == 1:
            return self
        return YawProgram(tuple(self.offsets_rad[i] for i in order), self.rate_rad_s, self.along_path)


# ------------------------------------------------------------------------------------------------------ courses


class Course(NamedTuple):
    """What n vehicles fly: their paths, when each is where (phase shifts), and where their noses point."""

    name: str
    paths: object  # HarmonicPaths or WaypointTour
    shifts_s: np.ndarray  # (n,) the vehicle is so far ahead on its path
    yaw: YawProgram

    def at(self, time_s):
        """((5, n, 3) position to snap, (3, n) yaw to its acceleration) at a time on the course."""
        times = time_s + self.shifts_s
        derivatives = self.paths.at(times)
        return derivatives, self.yaw.at(times, derivatives)

    def reordered(self, order):
        """The same course with vehicle i flying what was the path of vehicle order[i]."""
        order = [int(i) for i in order]
        return Course(self.name, self.paths.reordered(order), self.shifts_s[order], self.yaw.reordered(order))

    def with_yaw(self, yaw):
        """The same course with another YawProgram."""
        return self._replace(yaw=yaw)

    @property
    def period_s(self):
        """Time after which every path repeats."""
        return self.paths.period_s

    @property
    def repeat_s(self):
        """Time after which paths and noses have both been round at least once."""
        return max(self.period_s, 2.0 * math.pi / abs(self.yaw.rate_rad_s) if self.yaw.rate_rad_s else 0.0)


def circle(vehicles, radius_m=0.8, period_s=8.0, height_m=COURSE_HEIGHT_M):
    """One circle for all, evenly spread (chapter 6, figure 6.2)."""
    paths = _harmonic(vehicles, period_s, height_m, [(radius_m, 1, 0.0)], [(radius_m, 1, -0.25)])
    return _spread("circle", paths, vehicles)


def flat8(vehicles, length_m=1.5, width_m=0.75, period_s=10.0, height_m=0.75):
    """A level figure eight, x = a cos(w t/2), y = b sin(w t) (chapter 6, figure 6.4); all of it takes 2 periods."""
    paths = _harmonic(vehicles, 2.0 * period_s, height_m, [(length_m, 1, 0.0)], [(width_m, 2, -0.25)])
    return _spread("flat8", paths, vehicles)


def slanted8(vehicles, length_m=1.5, width_m=0.75, slant_m=0.5, period_s=10.0, height_m=COURSE_HEIGHT_M):
    """The figure eight with height = n + c sin(w t) (chapter 6, figure 6.3)."""
    paths = _harmonic(
        vehicles, 2.0 * period_s, height_m, [(length_m, 1, 0.0)], [(width_m, 2, -0.25)], [(slant_m, 2, -0.25)]
    )
    return _spread("slanted8", paths, vehicles)


def origin(vehicles, height_m=COURSE_HEIGHT_M, spacing_m=0.95):
    """Above the origin; several vehicles stand on a circle around it, spacing_m apart."""
    radius_m = 0.0 if vehicles == 1 else 0.5 * spacing_m / math.sin(math.pi / vehicles)
    return points("origin", _ring(vehicles, radius_m, height_m))


def points(name, positions_m):
    """Course that stands still at positions (n, 3), one a vehicle."""
    positions = np.array(positions_m, dtype=float)
    paths = HarmonicPaths(positions, np.zeros((1, 1, 1)), 0.0, 0.0, period_s=8.0)
    return Course(name, paths, np.zeros(len(positions)), YawProgram())


def circles3(vehicles, radius_m=0.35, period_s=8.0, height_m=COURSE_HEIGHT_M, centre_m=0.5, turn_s=24.0):
    """A circle for each vehicle, centres around the origin, noses turning.

    All are at the same phase, so their distance is that of the centres at all times: 0.866 m for three with centres
    0.5 m from the origin. With more vehicles the centres move out to keep it. One turn of the nose takes turn_s: the
    original's 8 s is more than twice the yaw rate that an AR.Drone is given.
    """
    closest_m = 2.0 * centre_m * math.sin(math.pi / 3.0)
    if vehicles > 3:
        centre_m = 0.5 * closest_m / math.sin(math.pi / vehicles)
    amplitude = np.array([radius_m, radius_m, 0.0]).reshape(1, 3, 1)
    phase = np.array([0.0, -0.5 * math.pi, 0.0]).reshape(1, 3, 1)
    paths = HarmonicPaths(
        _ring(vehicles, centre_m, height_m), amplitude, 2.0 * math.pi / period_s, phase, period_s=period_s
    )
    offsets = tuple(2.0 * math.pi * k / vehicles for k in range(vehicles))
    return Course("circles3", paths, np.zeros(vehicles), YawProgram(offsets, 2.0 * math.pi / turn_s))


def knot(vehicles, radius_m=0.65, tube_m=0.25, period_s=10.0, loops=3, turns=2, height_m=COURSE_HEIGHT_M):
    """A torus knot: r = a + b cos(q th/p), z = n + b sin(q th/p) with th = w t; the whole knot takes p periods.

    The products of the cylindrical form are sums of harmonics, so its derivatives are exact like all others (D-34).
    """
    # in units of the knot's own frequency w/p: th = p, q th/p = q
    half_m = 0.5 * tube_m
    x = [(radius_m, turns, 0.0), (half_m, loops + turns, 0.0), (half_m, loops - turns, 0.0)]
    y = [(radius_m, turns, -0.25), (half_m, loops + turns, -0.25), (-half_m, loops - turns, -0.25)]
    paths = _harmonic(vehicles, turns * period_s, height_m, x, y, [(tube_m, loops, -0.25)])
    return _spread("knot", paths, vehicles)


def quadrant(number, vehicles, reach_m=0.75, height_m=COURSE_HEIGHT_M):
    """Course that stands in a quadrant, 1 to 4; further vehicles stand in the next ones. Raises ValueError for > 4."""
    return points("quadrant %d" % number, quadrants(vehicles, reach_m, height_m).paths.points_m[:, (number - 1) % 4])


def quadrants(vehicles, reach_m=0.75, height_m=COURSE_HEIGHT_M, rest_s=3.0, move_s=4.0):
    """From quadrant to quadrant, I to IV, with a rest in each; every vehicle starts in another one."""
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * reach_m
    if vehicles > len(corners):
        raise ValueError("quadrants is for at most %d vehicles, got %d" % (len(corners), vehicles))
    stops = np.column_stack([corners, np.full(len(corners), height_m)])
    points = np.stack([np.roll(stops, -k, axis=0) for k in range(vehicles)])
    return Course("quadrants", WaypointTour(points, rest_s, move_s), np.zeros(vehicles), YawProgram())


def spin(vehicles, turn_s=30.0, height_m=COURSE_HEIGHT_M, spacing_m=0.95):
    """Stand as on `origin` and turn, once in turn_s (the original's coop_traj1, which forgot the time)."""
    course = origin(vehicles, height_m, spacing_m)
    return course._replace(name="spin", yaw=YawProgram(rate_rad_s=2.0 * math.pi / turn_s))


COURSES = {course.__name__: course for course in (circle, circles3, flat8, knot, origin, quadrants, slanted8, spin)}


def make_course(name, vehicles, yaw=None, **options):
    """The Course of that name for so many vehicles.

    yaw: YawProgram instead of the course's own.  options: the keyword arguments of the function in COURSES.
    Raises ValueError for an unknown name or option, or a course that is not for so many vehicles.
    """
    if name not in COURSES:
        raise ValueError("unknown trajectory '%s'; known are: %s" % (name, ", ".join(sorted(COURSES))))
    if vehicles < 1:
        raise ValueError("a course needs at least one vehicle, got %r" % (vehicles,))
    known = list(inspect.signature(COURSES[name]).parameters)[1:]
    for option, value in options.items():
        if option not in known:
            raise ValueError("trajectory '%s' has no %s; it has: %s" % (name, option, ", ".join(known)))
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value) or value <= 0.0:
            raise ValueError("%s of trajectory '%s' must be a number > 0, got %r" % (option, name, value))
    course = COURSES[name](vehicles, **options)
    return course if yaw is None else course.with_yaw(yaw)


def peak_yaw_rate_rad_s(course, samples=400):
    """Largest yaw rate [rad/s] that a course asks for."""
    times = np.linspace(0.0, course.period_s, samples, endpoint=False)
    return max(float(np.abs(course.at(time_s)[1][1]).max()) for time_s in times)


def minimum_separation(positions_m):
    """Smallest distance [m] between any two of n vehicles over positions (k, n, 3); inf for one vehicle."""
    n = positions_m.shape[1]
    if n < 2:
        return math.inf
    first, second = np.triu_indices(n, 1)
    return float(np.sqrt(((positions_m[:, first] - positions_m[:, second]) ** 2).sum(axis=2).min()))


def course_separation(course, samples=2000):
    """Smallest distance [m] between any two vehicles of a course over its period."""
    times = np.linspace(0.0, course.period_s, samples, endpoint=False)
    return minimum_separation(np.array([course.at(time_s)[0][0] for time_s in times]))


def _harmonic(vehicles, period_s, height_m, *axes):
    """HarmonicPaths of equal paths: axes x, y[, z] as lists of (amplitude, multiple of 1/period, phase in turns)."""
    terms = max(len(axis) for axis in axes)
    table = np.zeros((3, 3, terms))  # amplitude, frequency, phase
    for axis, entries in enumerate(axes):
        for term, (amplitude, multiple, turns) in enumerate(entries):
            table[:, axis, term] = amplitude, 2.0 * math.pi * multiple / period_s, 2.0 * math.pi * turns
    centre = np.tile([0.0, 0.0, height_m], (vehicles, 1))
    return HarmonicPaths(centre, *table[:, None], period_s=period_s)


def _spread(name, paths, vehicles):
    """All on one path, vehicle k ahead by k equal shifts: 1/n of the period, or what keeps them further apart.

    Equal parts of the period are no good on a path that crosses itself: half a period apart, two vehicles meet in the
    middle of an eight.
    """
    grid = 240
    times = paths.period_s * np.arange(grid) / grid
    points = np.array([paths.at(time_s)[0, 0] for time_s in times])
    # distance over a period of two vehicles that are m grid steps apart, at its smallest
    apart_m = np.array([np.sqrt(((points - np.roll(points, -m, axis=0)) ** 2).sum(axis=1)).min() for m in range(grid)])

    def separation(step):
        return min((apart_m[(k * step) % grid] for k in range(1, vehicles)), default=np.inf)

    step = grid / vehicles
    if separation(int(round(step))) < SAFE_SEPARATION_M:
        step = max(range(1, grid), key=separation)
    return Course(name, paths, paths.period_s * np.arange(vehicles) * step / grid, YawProgram())


def _ring(vehicles, radius_m, height_m):
    angles = 2.0 * math.pi * np.arange(vehicles) / vehicles
    return np.stack([radius_m * np.cos(angles), radius_m * np.sin(angles), np.full(vehicles, height_m)], axis=1)


# ------------------------------------------------------------------------------------------- motions and blends
#
# A motion is a function of times (k,) that returns ((5, k, 3) position to snap, (3, k) yaw to its acceleration).

_STOP_S = 1.0  # time constant with which a vehicle that drifts is brought to rest


def standing(position_m, yaw_rad):
    """Motion of a vehicle that stands still at a position (3,)."""
    return coasting(position_m, np.zeros(3), yaw_rad, 0.0)


def coasting(position_m, velocity_m_s, yaw_rad, begin_s):
    """Motion of a vehicle that is at a position (3,) with a velocity (3,) at begin_s, and comes to rest."""
    position_m, velocity_m_s = np.array(position_m, dtype=float), np.array(velocity_m_s, dtype=float)  # may be views

    def motion(times_s):
        derivatives, yaw = np.zeros((ORDERS, len(times_s), 3)), np.zeros((YAW_ORDERS, len(times_s)))
        decay = np.exp(-np.maximum(times_s - begin_s, 0.0) / _STOP_S)[:, None]
        derivatives[0] = position_m + velocity_m_s * _STOP_S * (1.0 - decay)
        for order in range(1, ORDERS):
            derivatives[order] = velocity_m_s * decay * (-1.0 / _STOP_S) ** (order - 1)
        yaw[0] = yaw_rad
        return derivatives, yaw

    return motion


def on_course(course, vehicle, epoch_s):
    """Motion of one vehicle of a course that began at epoch_s."""

    own = course.reordered([vehicle])

    def motion(times_s):
        times = times_s - epoch_s + own.shifts_s
        derivatives = own.paths.at(times)
        return derivatives, own.yaw.at(times, derivatives)

    return motion


class Blend:
    """Motion from one motion into another: start + s (end - start), s the least-snap step from 0 to 1.

    It has the derivatives of `start` up to snap at the beginning and those of `end` at the end, and every position in
    between lies on the line between the two: where both are inside the (convex) arena, so is the way. A polynomial
    between two states of motion has no such bound; for the yaw, which needs none, it is the better way, because a
    vehicle need not chase a nose that turns.
    """

    def __init__(self, start, end, begin_s, duration_s):
        """start, end: motions, asked at the same times.  The end's yaw is turned by whole revolutions to be nearest."""
        if not duration_s > 0.0:
            raise ValueError("a blend needs a time > 0, got %r" % (duration_s,))
        self.start, self.end, self.begin_s, self.duration_s = start, end, begin_s, duration_s
        self._scale = duration_s ** -np.arange(ORDERS, dtype=float)[:, None]
        first = start(np.array([begin_s]))[1][:, 0]
        last = end(np.array([self.end_s]))[1][:, 0]
        # the nose turns on meanwhile: what must be nearest is the end less that turn
        carried = 0.5 * (first[1] + last[1]) * duration_s
        self._revolutions_rad = 2.0 * math.pi * round((last[0] - carried - first[0]) / (2.0 * math.pi))
        last = last - (self._revolutions_rad, 0.0, 0.0)
        polynomial = BPoly.from_derivatives([begin_s, self.end_s], [first, last])
        self._yaw = [polynomial, polynomial.derivative(), polynomial.derivative(2)]

    @property
    def end_s(self):
        """Time at which `end` is reached."""
        return self.begin_s + self.duration_s

    def __call__(self, times_s):
        """The motion; before its beginning that of `start`, after its end that of `end`."""
        (start, start_yaw), (end, end_yaw) = self.start(times_s), self.end(times_s)
        step = smooth_step((times_s - self.begin_s) / self.duration_s) * self._scale
        # Leibniz' rule: the derivatives of s (end - start)
        leibniz = _BINOMIAL[:, :, None] * step[_ORDER_LEFT]
        path = start + np.einsum("opk,pkx->okx", leibniz, end - start)
        yaw = np.stack([polynomial(times_s) for polynomial in self._yaw])
        before, after = times_s < self.begin_s, times_s > self.end_s
        if before.any() or after.any():
            yaw = np.where(before, start_yaw, np.where(after, end_yaw - _turned(self._revolutions_rad), yaw))
        return path, yaw


def _turned(angle_rad):
    return np.array([[angle_rad], [0.0], [0.0]])


# _BINOMIAL[o, p] = o over p; _ORDER_LEFT[o, p] = o - p where that is not negative
_BINOMIAL = np.array([[math.comb(order, part) for part in range(ORDERS)] for order in range(ORDERS)], dtype=float)
_ORDER_LEFT = np.maximum(np.subtract.outer(np.arange(ORDERS), np.arange(ORDERS)), 0)

# Coefficients of t^5 to t^9 of the least-snap step: value 1 and no derivatives at t = 1, nothing at t = 0.
_POWERS = np.arange(2 * ORDERS)
_DERIVATIVE = np.array([[np.prod(np.arange(p, p - d, -1.0)) for p in _POWERS] for d in range(ORDERS)])
_STEP = np.concatenate([np.zeros(ORDERS), np.linalg.solve(_DERIVATIVE[:, ORDERS:], np.eye(ORDERS)[0])])
# (5, 10): row d holds the coefficients of the d-th derivative
_STEP_DERIVATIVES = np.array([np.roll(_DERIVATIVE[d] * _STEP, -d) for d in range(ORDERS)])


def smooth_step(fraction):
    """(5, n) value and derivatives of the least-snap way from 0 (before 0) to 1 (after 1) over fractions (n,)."""
    inside = np.clip(fraction, 0.0, 1.0)
    result = _STEP_DERIVATIVES @ inside ** _POWERS[:, None]
    result[1:, inside != fraction] = 0.0
    return result
