"""Courses: paths of several vehicles with exact derivatives up to snap, yaw programs, and smooth ways between them.

A course is a set of paths, one a vehicle, that keep the vehicles apart. `COURSES` holds them by name: each entry makes
the course for a number of vehicles, `make_course("flat8", 3)`. Add a function to `COURSES` and it is a name for every
node and for `--trajectory`. `course_for_fleet` makes copies of a figure when there are too many vehicles for one.

Frame: cortex (x forward, y left, z up), metres, seconds. Yaw psi is + clockwise seen from above (NED sense), radians;
at yaw psi the nose points along (cos psi, -sin psi). Arrays of derivatives have the order (0 = position ... 4 = snap)
as their first axis.
"""

import inspect
import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from risc_control.motions import (
    BY_FUNCTION,
    HARMONIC,
    NO_PATHS,
    NO_TABLE,
    ORDERS,
    TABLE_WIDTH,
    TOUR,
    YAW_ORDERS,
    Motion,
    new_links,
    sample_paths,
)
from risc_lab.compiled import compiled
from risc_lab.lab.generated_fleet import SPACING_M, rows

# Courses of chapter 6 and of the original release.
COURSE_HEIGHT_M = 1.0
SAFE_SEPARATION_M = 0.75  # between centres: AR.Drones are 0.55 m wide with their hull
FEW_VEHICLES = 5  # so many fly one figure in the laboratory's net, however near each other it brings them
_FROM_NET_M = 0.7  # a course keeps so far inside the net: the fence is 0.2 m inside and looks half a second ahead
_FROM_TOP_M = 0.5
_BETWEEN_COPIES_M = 1.2  # of a figure,
_WITHIN_COPIES_M = 0.85  # and between the vehicles of each: there is room for the ways of others


class _TablePaths:
    """Paths of n vehicles that compiled code knows."""

    def __init__(self, links, table, period_s):
        """links: (n,) LINK, one a vehicle.  table: (rows, TABLE_WIDTH).  period_s: after it every path repeats."""
        self.links, self.table, self.period_s = links, np.ascontiguousarray(table, dtype=float), period_s

    def __len__(self):
        return len(self.links)

    def at(self, times_s):
        """(5, n, 3) position to snap, every vehicle at its own time (n,) or all at one (scalar).

        Paths of a single vehicle take any number of times (k,) and return (5, k, 3).
        """
        times = np.full(len(self), times_s) if np.ndim(times_s) == 0 else np.asarray(times_s, dtype=float)
        path, yaw = np.empty((ORDERS, len(times), 3)), np.empty((YAW_ORDERS, len(times)))
        sample_paths(self.links, self.table, NO_PATHS, times, path, yaw)
        return path

    def reordered(self, order):
        """The same paths in another order of the vehicles."""
        return _TablePaths(self.links[np.asarray(order)], self.table, self.period_s)

    def moved(self, offset_m):
        """The same paths somewhere else."""
        links, table = self.links.copy(), self.table.copy()
        links["position_m"] += offset_m
        for link in links[links["kind"] == TOUR]:
            table[link["first"] : link["first"] + link["rows"], :3] += offset_m
        return _TablePaths(links, table, self.period_s)

    def beside(self, other):
        """These paths and others of the same period."""
        links = np.concatenate([self.links, other.links])
        links["first"][len(self) :] += len(self.table)
        return _TablePaths(links, np.concatenate([self.table, other.table]), self.period_s)


class HarmonicPaths(_TablePaths):
    """Paths of n vehicles: centre + sum of amplitude cos(frequency t + phase) in every axis."""

    def __init__(self, centre_m, amplitude_m, frequency_rad_s, phase_rad, period_s):
        """centre: (n, 3).  amplitude, frequency, phase: broadcast to (n, 3, terms).  period_s: of the whole course."""
        n, terms = len(centre_m), np.shape(amplitude_m)[-1]
        table = np.stack(
            [np.broadcast_to(part, (n, 3, terms)) for part in (amplitude_m, frequency_rad_s, phase_rad)], axis=1
        )
        links = new_links(n, HARMONIC, first=terms * np.arange(n), rows=terms, position_m=centre_m)
        super().__init__(links, table.transpose(0, 3, 1, 2).reshape(n * terms, TABLE_WIDTH), period_s)


class WaypointTour(_TablePaths):
    """Paths of n vehicles through points in turn: rest at each, then a smooth move to the next, for ever."""

    def __init__(self, points_m, rest_s, move_s):
        """points_m: (n, stops, 3), the stops of every vehicle."""
        n, stops = np.shape(points_m)[:2]
        links = new_links(n, TOUR, first=stops * np.arange(n), rows=stops, rest_s=rest_s, move_s=move_s)
        table = np.zeros((n * stops, TABLE_WIDTH))
        table[:, :3] = np.reshape(points_m, (-1, 3))
        super().__init__(links, table, (rest_s + move_s) * stops)


# ---------------------------------------------------------------------------------------------------------- yaw


@dataclass(frozen=True)
class YawProgram:
    """Yaw over time: constant, turning at a constant rate, or along the path."""

    offsets_rad: tuple = (0.0,)  # one for all vehicles, or one a vehicle
    rate_rad_s: float = 0.0
    along_path: bool = False  # the nose leads; offsets are added

    def reordered(self, order):
        """The same program for another order of the vehicles."""
        if len(self.offsets_rad) == 1:
            return self
        return YawProgram(tuple(self.offsets_rad[i] for i in order), self.rate_rad_s, self.along_path)


# ------------------------------------------------------------------------------------------------------ courses


@dataclass(frozen=True, eq=False)
class Course:
    """What n vehicles fly: their paths, when each is where (phase shifts), and where their noses point."""

    name: str
    # HarmonicPaths, WaypointTour, or anything with their at, reordered, len and period_s: then Python works it out
    paths: object
    shifts_s: np.ndarray  # (n,) the vehicle is so far ahead on its path
    yaw: YawProgram

    def __len__(self):
        return len(self.paths)

    @property
    def by_function(self):
        """Whether the paths are a Python function."""
        return not isinstance(self.paths, _TablePaths)

    @cached_property
    def links(self):
        """(n,) LINK of the vehicles, from time 0 on."""
        links = new_links(len(self), BY_FUNCTION) if self.by_function else self.paths.links.copy()
        links["ahead_s"] = self.shifts_s
        links["yaw_rad"], links["yaw_rate_rad_s"] = self.yaw.offsets_rad, self.yaw.rate_rad_s
        links["along_path"] = self.yaw.along_path
        return links

    def at(self, time_s):
        """((5, n, 3) position to snap, (3, n) yaw to its acceleration) at a time on the course."""
        path, yaw = np.empty((ORDERS, len(self), 3)), np.empty((YAW_ORDERS, len(self)))
        table, given = NO_TABLE, NO_PATHS
        if self.by_function:
            given = np.ascontiguousarray(self.path_at(time_s).transpose(1, 0, 2)[:, None])
        else:
            table = self.paths.table
        sample_paths(self.links, table, given, np.full(len(self), float(time_s)), path, yaw)
        return path, yaw

    @cached_property
    def _newest(self):
        return [(None, None)]

    def path_at(self, time_s):
        """(5, n, 3) position to snap at a time on the course; for the same time again the same array."""
        newest_s, path = self._newest[0]
        if newest_s != time_s:
            path = self.paths.at(time_s + self.shifts_s)
            self._newest[0] = time_s, path
        return path

    def reordered(self, order):
        """The same course with vehicle i flying what was the path of vehicle order[i]."""
        order = [int(i) for i in order]
        return Course(self.name, self.paths.reordered(order), self.shifts_s[order], self.yaw.reordered(order))

    def with_yaw(self, yaw):
        """The same course with another YawProgram."""
        return replace(self, yaw=yaw)

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
    """Above the origin; several vehicles stand on a circle around it, spacing_m apart, more than five in rows."""
    if vehicles > FEW_VEHICLES:
        return points("origin", _rows(vehicles, height_m, spacing_m))
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
    0.5 m from the origin. With more vehicles the centres move out to keep it; those of more than five are in rows, as
    the starts of a generated fleet, and the noses turn together. One turn of the nose takes turn_s: the original's 8 s
    is more than twice the yaw rate that an AR.Drone is given.
    """
    closest_m = 2.0 * centre_m * math.sin(math.pi / 3.0)
    offsets = tuple(2.0 * math.pi * k / vehicles for k in range(vehicles))
    if vehicles > FEW_VEHICLES:
        centres, offsets = _rows(vehicles, height_m, max(SPACING_M, closest_m)), (0.0,)
    elif vehicles > 3:
        centres = _ring(vehicles, 0.5 * closest_m / math.sin(math.pi / vehicles), height_m)
    else:
        centres = _ring(vehicles, centre_m, height_m)
    amplitude = np.array([radius_m, radius_m, 0.0]).reshape(1, 3, 1)
    phase = np.array([0.0, -0.5 * math.pi, 0.0]).reshape(1, 3, 1)
    paths = HarmonicPaths(centres, amplitude, 2.0 * math.pi / period_s, phase, period_s=period_s)
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
    return points("quadrant %d" % number, _quadrant_stops(vehicles, reach_m, height_m)[:, (number - 1) % 4])


def quadrants(vehicles, reach_m=0.75, height_m=COURSE_HEIGHT_M, rest_s=3.0, move_s=4.0):
    """From quadrant to quadrant, I to IV, with a rest in each; every vehicle starts in another one."""
    stops = _quadrant_stops(vehicles, reach_m, height_m)
    return Course("quadrants", WaypointTour(stops, rest_s, move_s), np.zeros(vehicles), YawProgram())


def _quadrant_stops(vehicles, reach_m, height_m):
    """(n, 4, 3) quadrants I to IV, beginning with another one for every vehicle."""
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * reach_m
    if vehicles > len(corners):
        raise ValueError("quadrants is for at most %d vehicles, got %d" % (len(corners), vehicles))
    stops = np.column_stack([corners, np.full(len(corners), height_m)])
    return np.stack([np.roll(stops, -k, axis=0) for k in range(vehicles)])


def spin(vehicles, turn_s=30.0, height_m=COURSE_HEIGHT_M, spacing_m=0.95):
    """Stand as on `origin` and turn, once in turn_s (the original's coop_traj1, which forgot the time)."""
    course = origin(vehicles, height_m, spacing_m)
    return replace(course, name="spin", yaw=YawProgram(rate_rad_s=2.0 * math.pi / turn_s))


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


def course_for_fleet(name, vehicles, arena, yaw=None, **options):
    """As `make_course`; where one figure cannot keep so many apart inside an Arena, they fly copies of it.

    Copies are side by side first, then above each other. Raises ValueError when there is no room. Up to FEW_VEHICLES
    fly one figure in any case.
    """
    if vehicles <= FEW_VEHICLES:
        return make_course(name, vehicles, yaw, **options)
    figure = make_course(name, 1, yaw, **options)  # whatever else is wrong is said here
    whole = _if_for(name, vehicles, yaw, options)
    if whole and _room(whole, arena):
        return whole
    most, course, apart_m = 0, figure, SAFE_SEPARATION_M if figure.by_function else _WITHIN_COPIES_M
    while course and course_separation(course, 400) >= apart_m:
        if _room(course, arena):
            most, figure = len(course), course
        course = _if_for(name, len(course) + 1, yaw, options) if len(course) < vehicles else None
    offsets = [] if figure.by_function or not most else _places_for_copies(figure, arena)
    if most * len(offsets) < vehicles:
        raise ValueError(
            "'%s' has no room for %d vehicles, %g m apart, in a net of %.1f x %.1f x %.1f m: at most %d"
            % (name, vehicles, SAFE_SEPARATION_M, 2.0 * arena.half_x_m, 2.0 * arena.half_y_m, arena.height_m,
               most * max(1, len(offsets)))
        )  # fmt: skip
    copies = math.ceil(vehicles / most)
    sizes = [vehicles // copies + (k < vehicles % copies) for k in range(copies)]
    return _copied([make_course(name, size, yaw, **options) for size in sizes], offsets)


def _if_for(name, vehicles, yaw, options):
    """The course, None when it is not for so many vehicles."""
    try:
        return make_course(name, vehicles, yaw, **options)
    except ValueError:
        return None


def _extent(course, samples=400):
    """(least, largest) corner (3,) [m] of all paths."""
    times = np.linspace(0.0, course.period_s, samples, endpoint=False)
    positions = np.array([course.at(time_s)[0][0] for time_s in times])
    return positions.min(axis=(0, 1)), positions.max(axis=(0, 1))


def _limits(arena):
    half = np.array([arena.half_x_m, arena.half_y_m]) - _FROM_NET_M
    return np.array([*-half, 0.0]), np.array([*half, arena.height_m - _FROM_TOP_M])


def _room(course, arena):
    """Whether a course keeps its vehicles apart and inside an arena."""
    (low, high), (least, largest) = _limits(arena), _extent(course)
    inside = (least >= low - 1e-9).all() and (largest <= high + 1e-9).all()
    return inside and course_separation(course, 400) >= SAFE_SEPARATION_M


def _places_for_copies(figure, arena):
    """(k, 3) offsets at which copies of a course fit into an arena, those of the lowest layer first."""
    (low, high), (least, largest) = _limits(arena), _extent(figure)
    pitch = largest - least + _BETWEEN_COPIES_M
    counts = np.floor((high - low - (largest - least)) / pitch + 1e-9).astype(int)[:2] + 1
    layers = 1 + int((high[2] - largest[2]) / pitch[2] + 1e-9)
    along_x, along_y = (pitch[k] * (np.arange(counts[k]) - 0.5 * (counts[k] - 1)) for k in range(2))
    middle = 0.5 * (least + largest)
    flat = sorted(((x, y) for x in along_x for y in along_y), key=lambda place: (math.hypot(*place), place))
    return [(x - middle[0], y - middle[1], pitch[2] * layer) for layer in range(layers) for x, y in flat]


def _copied(courses, offsets):
    """One Course of several, each somewhere else."""
    paths = courses[0].paths.moved(offsets[0])
    for course, offset in zip(courses[1:], offsets[1:]):
        paths = paths.beside(course.paths.moved(offset))
    yaw = courses[0].yaw
    if len(yaw.offsets_rad) > 1:
        yaw = replace(yaw, offsets_rad=tuple(angle for course in courses for angle in course.yaw.offsets_rad))
    return Course(courses[0].name, paths, np.concatenate([course.shifts_s for course in courses]), yaw)


def peak_yaw_rate_rad_s(course, samples=400):
    """Largest yaw rate [rad/s] that a course asks for."""
    times = np.linspace(0.0, course.period_s, samples, endpoint=False)
    return max(float(np.abs(course.at(time_s)[1][1]).max()) for time_s in times)


@compiled
def _smallest_distance(positions_m):
    least = np.inf
    for k in range(positions_m.shape[0]):
        for i in range(1, positions_m.shape[1]):
            for j in range(i):
                dx = positions_m[k, i, 0] - positions_m[k, j, 0]
                dy = positions_m[k, i, 1] - positions_m[k, j, 1]
                dz = positions_m[k, i, 2] - positions_m[k, j, 2]
                least = min(least, dx * dx + dy * dy + dz * dz)
    return math.sqrt(least)


def minimum_separation(positions_m):
    """Smallest distance [m] between any two of n vehicles over positions (k, n, 3); inf for one vehicle."""
    return _smallest_distance(np.ascontiguousarray(positions_m, dtype=float))


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


def _rows(vehicles, height_m, spacing_m):
    return np.column_stack([rows(vehicles, spacing_m), np.full(vehicles, height_m)])


def _ring(vehicles, radius_m, height_m):
    angles = 2.0 * math.pi * np.arange(vehicles) / vehicles
    return np.stack([radius_m * np.cos(angles), radius_m * np.sin(angles), np.full(vehicles, height_m)], axis=1)


# ------------------------------------------------------------------------------------------- motions on a course


class _OwnPath:
    """The path of one vehicle of a course that is a Python function."""

    def __init__(self, course, vehicle, epoch_s):
        self._course, self._vehicle, self._epoch_s = course, vehicle, epoch_s
        self._own = course.paths.reordered([vehicle])

    def __call__(self, times_s):
        return self._own.at(times_s - self._epoch_s + self._course.shifts_s[self._vehicle])

    def at(self, time_s):
        """(5, 3) at one time; all vehicles of the course are asked for at once, by whoever is first."""
        return self._course.path_at(time_s - self._epoch_s)[:, self._vehicle]


def on_course(course, vehicle, epoch_s):
    """Motion of one vehicle of a course that began at epoch_s."""
    link = course.links[vehicle : vehicle + 1].copy()
    link["epoch_s"] = epoch_s
    if course.by_function:
        return Motion(link, functions={0: _OwnPath(course, vehicle, epoch_s)})
    first, rows = int(link["first"][0]), int(link["rows"][0])
    link["first"] = 0
    return Motion(link, course.paths.table[first : first + rows])
