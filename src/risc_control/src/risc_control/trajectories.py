"""Courses: paths of several vehicles with exact derivatives to any order, and yaw programs.

A course is a set of paths, one per vehicle, that keep the vehicles apart. `COURSES` holds them by name: each entry
makes the course for a number of vehicles, `make_course("flat8", 3)`. A function that is added to `COURSES` can be used
by its name in every node and for `--trajectory`. `course_for_fleet` makes copies of a figure when there are too many
vehicles for one.

A path is a function of the phase, written as in a textbook: `figure` computes its Fourier series, and from that all
derivatives. `quadrants` and fixed points are tours, whose moves are as smooth as `motions.blend`.

Frame: cortex (x forward, y left, z up), metres, seconds. Yaw psi is + clockwise seen from above (NED sense), radians;
at yaw psi the nose points along (cos psi, -sin psi). Arrays of derivatives have the order (0 = position ... 4 = snap)
as their first axis, and x, y, z, psi as their last.
"""

import inspect
import math
from dataclasses import dataclass, make_dataclass, replace
from functools import cached_property

import numpy as np

from risc_control.motions import Chains, simple_motion
from risc_control.reference_buffer import Axis, Order
from risc_control.waypoints import Waypoints, load_waypoints
from risc_lab.compiled import compiled
from risc_lab.lab.generated_fleet import SPACING_M, rows
from risc_lab.settings import Positive, Settings, settings_from

# Courses of chapter 6 and of the original release.
COURSE_HEIGHT_M = 1.0
SAFE_SEPARATION_M = 0.75  # between centres of AR.Drones; for others more, by what the two widest reach farther
_LEAST_SEPARATION_M = 0.6  # with less they hold (SafetyLimits.separation_m), with errors of 0.05 m
FEW_VEHICLES = 5  # up to this many fly one figure in the laboratory's net, however near each other it brings them
_FROM_NET_M = 0.7  # distance of a course from the net: the fence is 0.2 m inside and looks half a second ahead
_FROM_TOP_M = 0.5
_BETWEEN_COPIES_M = 1.2  # distance between copies of a figure,
_WITHIN_COPIES_M = 0.85  # and between the vehicles of each: there is room for the ways of others
_SAMPLES = 256  # of a path: it may have harmonics to a quarter of that
_SPEED_STEP_S = 0.02  # time step of the search for the largest speed
_LEAST_AMPLITUDE_M = 1e-12  # of a harmonic; less is rounding


@dataclass(frozen=True)
class YawProgram:
    """Yaw over time: constant, turning at a constant rate, or along the path."""

    offset_rad: float = 0.0
    rate_rad_s: float = 0.0
    along_path: bool = False  # the nose points along the path; offset and turning are added


@dataclass(frozen=True, eq=False)
class Course:
    """Positions and yaws of n vehicles over time."""

    name: str
    paths: tuple  # Motion of each, of a single link
    period_s: float  # after it every path repeats

    def __len__(self):
        return len(self.paths)

    @cached_property
    def _chains(self):
        return Chains(self.paths)

    def at(self, time_s, order=Order.SNAP):
        """(order + 1, n, 4) at a time on the course."""
        return self._chains.at(np.array([time_s], dtype=float), order)

    def over_period(self, samples, order=Order.POSITION):
        """(samples, order + 1, n, 4) at times evenly over the period."""
        return np.array([self.at(self.period_s * k / samples, order) for k in range(samples)])

    def reordered(self, order):
        """The same course with vehicle i flying what was the path of vehicle order[i]."""
        return replace(self, paths=tuple(self.paths[i] for i in order))

    def with_yaw(self, yaw):
        """The same course with a YawProgram instead of its own; None = its own."""
        if yaw is None:
            return self
        program = yaw.offset_rad, yaw.rate_rad_s, yaw.along_path
        return replace(self, paths=tuple(path.with_yaw(*program) for path in self.paths))

    def faster(self, factor):
        """The same course, flown `factor` times as fast."""
        return replace(self, paths=tuple(path.faster(factor) for path in self.paths), period_s=self.period_s / factor)

    @property
    def repeat_s(self):
        """Time after which paths and yaws have both completed at least one round."""
        rate_rad_s = max(abs(path.links["yaw_rate_rad_s"][0]) for path in self.paths)
        return max(self.period_s, 2.0 * math.pi / rate_rad_s if rate_rad_s else 0.0)


def on_course(course, vehicle, epoch_s):
    """Motion of one vehicle of a course that began at epoch_s."""
    path = course.paths[vehicle]
    return path.with_fields(epoch_s=path.links["epoch_s"][0] + epoch_s)


# ------------------------------------------------------------------------------------------------------- figures


def figure(name, vehicles, period_s, path):
    """Course on which all fly one path, vehicle k ahead by k equal shifts: 1/n of the period, or what keeps them apart.

    Equal parts of the period do not work on a path that crosses itself: half a period apart, two vehicles meet in the
    middle of an eight.

    path: function of the phase (k,) [rad], 2 pi in a period, that gives x, y, z [m].  Raises ValueError as `harmonics`.
    """
    return _one_after_the_other(name, vehicles, period_s, simple_motion(harmonics(path, period_s)))


def _one_after_the_other(name, vehicles, period_s, motion):
    """Course on which all fly one Motion, as in `figure`."""
    grid = 240
    points = motion.at(period_s * np.arange(grid) / grid, Order.POSITION)[0, :, : Axis.PSI]
    # distance over a period of two vehicles that are m grid steps apart, at its smallest
    apart_m = np.array([np.sqrt(((points - np.roll(points, -m, axis=0)) ** 2).sum(axis=1)).min() for m in range(grid)])

    def separation(step):
        return min((apart_m[(k * step) % grid] for k in range(1, vehicles)), default=np.inf)

    step = grid / vehicles
    if separation(int(round(step))) < SAFE_SEPARATION_M:
        step = max(range(1, grid), key=separation)
    ahead_s = period_s * np.arange(vehicles) * step / grid
    return Course(name, tuple(motion.with_fields(epoch_s=-time_s) for time_s in ahead_s), period_s)


def harmonics(path, period_s):
    """Rows of a link (see `motions`): the Fourier series of a path, a function as for `figure`.

    Raises ValueError for a path whose series does not end: it has corners, or is not closed.
    """
    phases = 2.0 * math.pi * np.arange(_SAMPLES) / _SAMPLES
    points = np.stack(np.broadcast_arrays(*path(phases), phases)[:3])
    amplitudes = np.fft.rfft(points, norm="forward")
    amplitudes[:, 1:] *= 2.0
    sizes_m = np.abs(amplitudes).max(axis=0)
    if not sizes_m[_SAMPLES // 4 :].max() < _LEAST_AMPLITUDE_M:
        raise ValueError("the path is not smooth: its Fourier series does not end within %d terms" % (_SAMPLES // 4))
    used = np.flatnonzero(sizes_m >= _LEAST_AMPLITUDE_M)
    return np.column_stack([2j * math.pi * used / period_s, amplitudes[:, used].T])


def points(name, positions_m):
    """Course that stands still at positions (n, 3), one a vehicle."""
    return Course(name, tuple(simple_motion(position_m=position_m) for position_m in positions_m), 8.0)


def circle(vehicles, radius_m=0.8, period_s=8.0, height_m=COURSE_HEIGHT_M):
    """One circle for all, evenly spread (chapter 6, figure 6.2)."""
    return figure("circle", vehicles, period_s, lambda a: (radius_m * np.cos(a), radius_m * np.sin(a), height_m))


def flat8(vehicles, length_m=1.5, width_m=0.75, period_s=10.0, height_m=0.75):
    """A level figure eight, x = a cos(w t/2), y = b sin(w t) (chapter 6, figure 6.4); all of it takes 2 periods."""
    return replace(slanted8(vehicles, length_m, width_m, 0.0, period_s, height_m), name="flat8")


def slanted8(vehicles, length_m=1.5, width_m=0.75, slant_m=0.5, period_s=10.0, height_m=COURSE_HEIGHT_M):
    """The figure eight with height = n + c sin(w t) (chapter 6, figure 6.3)."""

    def path(a):
        return length_m * np.cos(a), width_m * np.sin(2.0 * a), height_m + slant_m * np.sin(2.0 * a)

    return figure("slanted8", vehicles, 2.0 * period_s, path)


def knot(vehicles, radius_m=0.65, tube_m=0.25, period_s=10.0, loops=3, turns=2, height_m=COURSE_HEIGHT_M):
    """A torus knot: r = a + b cos(q th/p), z = n + b sin(q th/p) with th = w t; the whole knot takes p periods.

    Its derivatives are by time, like all others (D-34).
    """

    def path(a):  # th = p a
        r = radius_m + tube_m * np.cos(loops * a)
        return r * np.cos(turns * a), r * np.sin(turns * a), height_m + tube_m * np.sin(loops * a)

    return figure("knot", vehicles, turns * period_s, path)


def circles3(vehicles, radius_m=0.35, period_s=8.0, height_m=COURSE_HEIGHT_M, centre_m=0.5, turn_s=24.0):
    """A circle for each vehicle, centres around the origin, noses turning.

    All are at the same phase, so their distance is that of the centres at all times: 0.866 m for three with centres
    0.5 m from the origin. With more vehicles the centres move out to keep it; those of more than five are in rows, as
    the starts of a generated fleet, and the noses turn together. One turn of the nose takes turn_s: the original's 8 s
    is more than twice the yaw rate that an AR.Drone is given.
    """
    closest_m = 2.0 * centre_m * math.sin(math.pi / 3.0)
    offset_rad = 2.0 * math.pi / vehicles
    if vehicles > FEW_VEHICLES:
        centres, offset_rad = _rows(vehicles, height_m, max(SPACING_M, closest_m)), 0.0
    elif vehicles > 3:
        centres = _ring(vehicles, 0.5 * closest_m / math.sin(math.pi / vehicles), height_m)
    else:
        centres = _ring(vehicles, centre_m, height_m)
    around = harmonics(lambda a: (radius_m * np.cos(a), radius_m * np.sin(a), 0.0), period_s)
    rate_rad_s = 2.0 * math.pi / turn_s
    paths = [
        simple_motion(around, position_m=centre, yaw_rad=k * offset_rad, yaw_rate_rad_s=rate_rad_s)
        for k, centre in enumerate(centres)
    ]
    return Course("circles3", tuple(paths), period_s)


def origin(vehicles, height_m=COURSE_HEIGHT_M, spacing_m=0.95):
    """Above the origin; several vehicles stand on a circle around it, spacing_m apart, more than five in rows."""
    if vehicles > FEW_VEHICLES:
        return points("origin", _rows(vehicles, height_m, spacing_m))
    radius_m = 0.0 if vehicles == 1 else 0.5 * spacing_m / math.sin(math.pi / vehicles)
    return points("origin", _ring(vehicles, radius_m, height_m))


def spin(vehicles, turn_s=30.0, height_m=COURSE_HEIGHT_M, spacing_m=0.95):
    """Stand as on `origin` and turn, once in turn_s (the original's coop_traj1, which left out the time)."""
    course = replace(origin(vehicles, height_m, spacing_m), name="spin")
    return course.with_yaw(YawProgram(rate_rad_s=2.0 * math.pi / turn_s))


def quadrants(vehicles, reach_m=0.75, height_m=COURSE_HEIGHT_M, rest_s=3.0, move_s=4.0):
    """From quadrant to quadrant, I to IV, with a rest in each; every vehicle starts in a different one."""
    stops = _quadrant_stops(vehicles, reach_m, height_m)
    paths = [simple_motion(np.insert(own, 0, 0.0, axis=1) + 0j, rest_s=rest_s, move_s=move_s) for own in stops]
    return Course("quadrants", tuple(paths), (rest_s + move_s) * stops.shape[1])


def quadrant(number, vehicles, reach_m=0.75, height_m=COURSE_HEIGHT_M):
    """Course that stands in a quadrant, 1 to 4; further vehicles stand in the next ones. Raises ValueError for > 4."""
    return points("quadrant %d" % number, _quadrant_stops(vehicles, reach_m, height_m)[:, (number - 1) % 4])


def _quadrant_stops(vehicles, reach_m, height_m):
    """(n, 4, 3) quadrants I to IV, beginning with a different one for every vehicle."""
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * reach_m
    if vehicles > len(corners):
        raise ValueError("quadrants is for at most %d vehicles, got %d" % (len(corners), vehicles))
    stops = np.column_stack([corners, np.full(len(corners), height_m)])
    return np.stack([np.roll(stops, -k, axis=0) for k in range(vehicles)])


def _rows(vehicles, height_m, spacing_m):
    return np.column_stack([rows(vehicles, spacing_m), np.full(vehicles, height_m)])


def _ring(vehicles, radius_m, height_m):
    angles = 2.0 * math.pi * np.arange(vehicles) / vehicles
    return np.stack([radius_m * np.cos(angles), radius_m * np.sin(angles), np.full(vehicles, height_m)], axis=1)


COURSES = {course.__name__: course for course in (circle, circles3, flat8, knot, origin, quadrants, slanted8, spin)}


# Parameter of a course that sets the distance of its vehicles: name, and its change per metre of distance.
_APART = {
    "circles3": ("centre_m", 0.5 / math.sin(math.pi / 3.0)),
    "origin": ("spacing_m", 1.0),
    "spin": ("spacing_m", 1.0),
}

# ------------------------------------------------------------------------------------------------ courses by name


def make_course(name, vehicles, **options):
    """The Course of that name for a number of vehicles.

    name: in COURSES, or Waypoints.  options: the keyword arguments of the function in COURSES.
    Raises ValueError for an unknown name or option, or a course that cannot be flown by that many vehicles.
    """
    if vehicles < 1:
        raise ValueError("a course needs at least one vehicle, got %r" % (vehicles,))
    numbers = settings_from(course_settings(name), options, "trajectory '%s'" % name)
    if isinstance(name, Waypoints):
        return _through_waypoints(name, vehicles)
    return COURSES[name](vehicles, **vars(numbers))


def _through_waypoints(waypoints, vehicles):
    motion, period_s = waypoints.path
    course = _one_after_the_other(waypoints.name, vehicles, period_s, motion)
    closest_m = course_separation(course, 400)
    if closest_m < _LEAST_SEPARATION_M:
        raise ValueError(
            "'%s' brings %d vehicles within %.2f m of each other: fly fewer of them, or through other waypoints"
            % (waypoints, vehicles, closest_m)
        )
    return course


def find_course(name):
    """Name for `make_course`: a name in COURSES as it is; for a file (.yaml), its Waypoints. Raises ValueError."""
    return load_waypoints(name) if str(name).endswith(".yaml") else name


def course_settings(name):
    """Dataclass of the parameters of a course; Waypoints have none. Raises ValueError for an unknown name."""
    if isinstance(name, Waypoints):
        return make_dataclass("numbers", (), bases=(Settings,), frozen=True)
    if name not in COURSES:
        known = ", ".join(sorted(COURSES))
        raise ValueError("unknown trajectory '%s'; known are: %s, and files of waypoints (.yaml)" % (name, known))
    _, *numbers = inspect.signature(COURSES[name]).parameters.values()
    numbers = [(number.name, Positive, number.default) for number in numbers]
    return make_dataclass(name, numbers, bases=(Settings,), frozen=True)


def course_for_fleet(name, vehicles, arena, wider_m=0.0, **options):
    """As `make_course`; if one figure cannot keep all vehicles apart inside an Arena, they fly copies of it.

    Copies are side by side first, then above each other. Raises ValueError when there is no room. Up to FEW_VEHICLES
    AR.Drones fly one figure in any case.

    wider_m: by how much the two widest of the fleet reach farther than two AR.Drones (`widest_pair_m`). If a course has
    a parameter for the distance of its vehicles, it is enlarged accordingly unless it is in options. Up to
    FEW_VEHICLES, some of them wider, fly one figure; ValueError if it brings them so near that they would hold.
    """
    safe_m = SAFE_SEPARATION_M + wider_m
    if vehicles <= FEW_VEHICLES:
        number, share = _APART.get(str(name), ("", 0.0))
        if wider_m and vehicles > 1 and number and number not in options:
            options |= {number: getattr(course_settings(name)(), number) + share * wider_m}
        course = make_course(name, vehicles, **options)
        closest_m, least_m = course_separation(course, 400), _LEAST_SEPARATION_M + wider_m
        if wider_m and closest_m < least_m:
            raise ValueError(
                "'%s' brings %d vehicles within %.2f m of each other, and the widest two of this fleet need %.2f m: "
                "fly fewer of them, or a wider course" % (name, vehicles, closest_m, least_m)
            )
        return course
    copied = make_course(name, 1, **options)  # raises for all other errors
    whole = _if_for(name, vehicles, options)
    if whole and _room(whole, arena, safe_m):
        return whole
    most, course = 0, copied
    while course and course_separation(course, 400) >= _WITHIN_COPIES_M + wider_m:
        if _room(course, arena, safe_m):
            most, copied = len(course), course
        course = _if_for(name, len(course) + 1, options) if len(course) < vehicles else None
    offsets = _places_for_copies(copied, arena, _BETWEEN_COPIES_M + wider_m) if most else []
    if most * len(offsets) < vehicles:
        raise ValueError(
            "'%s' has no room for %d vehicles, %g m apart, in a net of %.1f x %.1f x %.1f m: at most %d"
            % (name, vehicles, safe_m, 2.0 * arena.half_x_m, 2.0 * arena.half_y_m, arena.height_m,
               most * max(1, len(offsets)))
        )  # fmt: skip
    copies = math.ceil(vehicles / most)
    courses = [make_course(name, vehicles // copies + (k < vehicles % copies), **options) for k in range(copies)]
    paths = [
        path.with_fields(position_m=path.links["position_m"][0] + offset)
        for course, offset in zip(courses, offsets)
        for path in course.paths
    ]
    return replace(copied, paths=tuple(paths))


def _if_for(name, vehicles, options):
    """The course, None when it cannot be flown by that many vehicles."""
    try:
        return make_course(name, vehicles, **options)
    except ValueError:
        return None


def _extent(course):
    """(least, largest) corner (3,) [m] of all paths."""
    positions = course.over_period(400)[:, 0, :, : Axis.PSI]
    return positions.min(axis=(0, 1)), positions.max(axis=(0, 1))


def _limits(arena):
    half = np.array([arena.half_x_m, arena.half_y_m]) - _FROM_NET_M
    return np.array([*-half, 0.0]), np.array([*half, arena.height_m - _FROM_TOP_M])


def _room(course, arena, safe_m):
    """Whether a course keeps its vehicles safe_m apart and inside an arena."""
    (low, high), (least, largest) = _limits(arena), _extent(course)
    inside = (least >= low - 1e-9).all() and (largest <= high + 1e-9).all()
    return inside and course_separation(course, 400) >= safe_m


def _places_for_copies(course, arena, between_m):
    """(k, 3) offsets at which copies of a course fit into an arena, those of the lowest layer first."""
    (low, high), (least, largest) = _limits(arena), _extent(course)
    pitch = largest - least + between_m
    counts = np.floor((high - low - (largest - least)) / pitch + 1e-9).astype(int)[:2] + 1
    layers = 1 + int((high[2] - largest[2]) / pitch[2] + 1e-9)
    along_x, along_y = (pitch[k] * (np.arange(counts[k]) - 0.5 * (counts[k] - 1)) for k in range(2))
    middle = 0.5 * (least + largest)
    flat = sorted(((x, y) for x in along_x for y in along_y), key=lambda place: (math.hypot(*place), place))
    return [(x - middle[0], y - middle[1], pitch[2] * layer) for layer in range(layers) for x, y in flat]


def peak_speed_m_s(course):
    """Largest speed [m/s] on a course."""
    count = max(400, math.ceil(course.period_s / _SPEED_STEP_S))
    times = course.period_s * np.arange(count) / count
    velocities = (path.at(times, Order.VELOCITY)[Order.VELOCITY, :, : Axis.PSI] for path in course.paths)
    return max(float(np.linalg.norm(velocity, axis=1).max()) for velocity in velocities)


def parse_speed(speed):
    """(number, whether it is a factor) of a speed: 1.5 [m/s], or "2x" for twice as fast. Raises ValueError."""
    text = str(speed).strip()
    try:
        number = float(text.removesuffix("x"))
    except ValueError:
        number = math.nan
    if not 0.0 < number < math.inf:
        raise ValueError("a speed is a number of m/s > 0, or e.g. 2x for twice as fast, found '%s'" % text)
    return number, text.endswith("x")


def speed_factor(course, speed):
    """Factor by which a course is to be flown faster.

    speed: its largest speed [m/s]; "2x": twice its own; "": unchanged.  Raises ValueError.
    """
    if speed == "":
        return 1.0
    number, is_factor = parse_speed(speed)
    if is_factor:
        return number
    own_m_s = peak_speed_m_s(course)
    if not own_m_s > 0.0:
        raise ValueError("'%s' has no speed in m/s, it does not move: use a factor such as 2x" % course.name)
    return number / own_m_s


def speed_text(course, factor):
    """Speed as a text for `speed_factor` that gives this factor, rounded down."""
    own_m_s = peak_speed_m_s(course)
    speed = math.floor(100.0 * factor * (own_m_s or 1.0)) / 100.0
    return "%.2f" % speed if own_m_s else "%.2fx" % speed


@compiled
def minimum_separation(positions_m):
    """Smallest distance [m] between any two of n vehicles over positions (k, n, 3 or more); inf for one vehicle."""
    least = np.inf
    for k in range(positions_m.shape[0]):
        for i in range(1, positions_m.shape[1]):
            for j in range(i):
                dx = positions_m[k, i, 0] - positions_m[k, j, 0]
                dy = positions_m[k, i, 1] - positions_m[k, j, 1]
                dz = positions_m[k, i, 2] - positions_m[k, j, 2]
                least = min(least, dx * dx + dy * dy + dz * dz)
    return math.sqrt(least)


def course_separation(course, samples=2000):
    """Smallest distance [m] between any two vehicles of a course over its period."""
    return minimum_separation(course.over_period(samples)[:, 0])
