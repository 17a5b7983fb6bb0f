"""What every vehicle's reference is at any time: hold, approach, course, home (the brain of all trajectory nodes).

A vehicle that nobody flies automatically has the reference "where it is". When its vehicle node says that it is
autonomous it flies smoothly to its place on the course, meeting it in position to snap, and stays on the course until
it is sent home. Ways are planned together, so that vehicles keep apart on them too. Times are seconds of any one clock.
"""

import itertools
import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from risc_control.trajectories import (
    ORDERS,
    SAFE_SEPARATION_M,
    YAW_ORDERS,
    Blend,
    Course,
    coasting,
    minimum_separation,
    on_course,
    smooth_step,
    standing,
)

_GATHER_S = 0.3  # vehicles that become autonomous within this time start together
_PLAN_SAMPLES = 32  # positions of each candidate way that are checked
_STRETCHES = (1.0, 1.3, 1.7, 2.2)  # candidate durations of a way, times the shortest
_STRETCHES_ALONE = tuple(1.0 + 0.125 * k for k in range(25))  # the same for a single vehicle that joins others
_MEETING_S = 0.25  # vehicles that fly towards each other close 0.4 m in this time
_DURATION_STEP = 1.15  # ratio of the durations that are tried
_COURSE_STARTS = 12  # candidate moments of the course at which the vehicles set out for it
_COURSE_GRID_S = 0.125  # resolution of the course for that choice
_ROUGH_STRETCHES = (1.2, 1.5, 2.0, 2.7, 3.6)  # candidate durations, times that of the longest way from rest to rest
_EXACT_TRIES = 16  # of the most promising choices
_ALL_ORDERS = 5  # up to so many vehicles every assignment of paths is tried, beyond only the nearest one
_SPARE_M = 0.1  # of separation beyond what is needed: the rough judgement errs,
_SPARE_S_M = 20.0  # and each metre of it is worth so many seconds; what is needed is worth any detour,
_NEEDED_S_M = 1000.0
_AIRBORNE_M = 0.3  # higher than this a vehicle that is not flown automatically is in the way of the others
_DEPARTURES = 16  # candidate times of leaving the course for home,
_DEPARTURE_SPAN_S = 7.5  # spread over so long
_DEEPEST = 4  # blends of blends; somebody who changes his mind faster starts from a coasting vehicle


class Phase(Enum):
    """What a vehicle's reference is doing; the values are the words on trajectory_phase."""

    HOLD = "hold"  # where the vehicle is, or where it became autonomous
    APPROACH = "approach"
    COURSE = "course"
    HOME = "home"
    HOMED = "homed"


@dataclass(frozen=True)
class WayLimits:
    """What the ways to the course and home may ask of a vehicle."""

    speed_m_s: float = 0.6
    acceleration_m_s2: float = 0.5
    yaw_rate_rad_s: float = 0.32
    shortest_s: float = 2.5
    longest_s: float = 40.0

    def __post_init__(self):
        for name in ("speed_m_s", "acceleration_m_s2", "yaw_rate_rad_s", "shortest_s"):
            if not getattr(self, name) > 0.0:
                raise ValueError("%s must be > 0, got %r" % (name, getattr(self, name)))
        if not self.longest_s >= self.shortest_s:
            raise ValueError("longest_s must not be below shortest_s, got %r" % (self,))


class Home(NamedTuple):
    """Where a vehicle goes at the end."""

    position_m: tuple  # (3,) cortex frame
    yaw_rad: float


class Reference(NamedTuple):
    """References of all vehicles at one time."""

    derivatives: np.ndarray  # (5, n, 4) x, y, z, psi: value to snap; those of psi beyond its acceleration are 0
    phases: tuple  # of Phase


class _Leg(NamedTuple):
    """A stretch of a vehicle's plan, from start_s until the next one's."""

    start_s: float
    phase: Phase
    motion: object  # of the vehicle, over absolute time


class TrajectoryManager:
    """References of n vehicles. Not thread-safe."""

    def __init__(self, names, homes, course, limits=None, smooth=True, wait_for_all=True):
        """names: of the vehicles.  homes: a Home each.  course: Course for so many vehicles.

        smooth=False: on the course from the first moment on, whatever the vehicles do (simulations, teaching).
        wait_for_all: nobody starts while another vehicle hovers there that is not flown automatically: courses lead
        through the places where the others wait.
        """
        if not len(names) == len(homes) == len(course.paths):
            raise ValueError("%d vehicles, %d homes and a course for %d" % (len(names), len(homes), len(course.paths)))
        self.names = tuple(names)
        self.course = course
        self.limits = limits or WayLimits()
        self.closest_m = math.inf  # smallest planned distance of the last plan
        self._homes = homes
        self._unordered = course
        self._pairs = list(itertools.combinations(range(len(names)), 2))
        self._seen = [(np.array(home.position_m, dtype=float), home.yaw_rad) for home in homes]
        self._velocity = np.zeros((len(names), 3))
        self._autonomous = [False] * len(names)
        self._airborne = [False] * len(names)
        self._smooth, self._wait_for_all = smooth, wait_for_all
        self._epoch_s = None  # when the course began; None = nobody flies it yet
        self._joining_s = None  # when the vehicles that became autonomous start
        self._joining = set()
        self._legs = [[_Leg(-math.inf, Phase.HOLD, standing(*place))] for place in self._seen]

    # ---------------------------------------------------------------------------------------------- what happens

    def see(self, name, position_m, velocity_m_s, yaw_rad):
        """A vehicle was seen there (cortex frame, yaw in the NED sense): its reference while nobody flies it."""
        i = self.names.index(name)
        if not (np.isfinite(position_m).all() and np.isfinite(velocity_m_s).all() and math.isfinite(yaw_rad)):
            return
        self._seen[i] = np.array(position_m, dtype=float), float(yaw_rad)
        self._velocity[i] = velocity_m_s
        self._airborne[i] = position_m[2] > _AIRBORNE_M
        if not self._autonomous[i]:
            self._hold(i, standing(*self._seen[i]))

    @property
    def watching(self):
        """True while it matters where the vehicles are: some are not flown automatically."""
        return not all(self._autonomous)

    def waiting_for(self, now_s):
        """Names of the vehicles that the others wait for before they start."""
        if not self._joining or now_s < self._joining_s or self._epoch_s is not None or not self._wait_for_all:
            return ()
        others = zip(self.names, self._airborne, self._autonomous)
        return tuple(name for name, airborne, autonomous in others if airborne and not autonomous)

    def set_autonomous(self, name, autonomous, now_s):
        """A vehicle is, or is no longer, flown by its references. Returns whether that is new."""
        i = self.names.index(name)
        if autonomous == self._autonomous[i]:
            return False
        if not autonomous and self._smooth:
            # until it is seen again it is where it was to be
            derivatives = self.sample(now_s).derivatives
            self._seen[i] = derivatives[0, i, :3], float(derivatives[0, i, 3])
            self._velocity[i] = 0.0
        self._autonomous[i] = autonomous
        self._hold(i, standing(*self._seen[i]))
        if autonomous:
            self._joining.add(i)
            self._joining_s = now_s + _GATHER_S
        else:
            self._joining.discard(i)
            if not any(self._autonomous):
                self._epoch_s = None
        return True

    def set_course(self, course, now_s):
        """Leave what is flown for another course (for as many vehicles), smoothly."""
        if len(course.paths) != len(self.names):
            raise ValueError("the course is for %d vehicles, there are %d" % (len(course.paths), len(self.names)))
        movers = [i for i, phase in enumerate(self.sample(now_s).phases) if phase in (Phase.APPROACH, Phase.COURSE)]
        starts = self._motions(movers, now_s)
        self.course = self._unordered = course
        self._epoch_s = None
        if movers:
            self._join(movers, now_s, starts)

    def start(self, now_s):
        """Vehicles that are home and autonomous fly to the course again. Returns their names."""
        phases = self.sample(now_s).phases
        movers = [i for i, phase in enumerate(phases) if phase is Phase.HOMED and self._autonomous[i]]
        if movers:
            if not any(phase in (Phase.APPROACH, Phase.COURSE) for phase in phases):
                self._epoch_s = None
            self._join(movers, now_s, self._motions(movers, now_s))
        return [self.names[i] for i in movers]

    def go_home(self, now_s):
        """All vehicles that fly leave for home. Returns their names."""
        self._begin_joining(now_s)
        phases = self.sample(now_s).phases
        movers = [
            i
            for i, phase in enumerate(phases)
            if phase in (Phase.APPROACH, Phase.COURSE) or (phase is Phase.HOLD and self._autonomous[i])
        ]
        if movers:
            self._joining.clear()
            self._send_home(movers, now_s)
        return [self.names[i] for i in movers]

    # --------------------------------------------------------------------------------------------------- sampling

    def sample(self, now_s):
        """Reference at now_s; times must not decrease by more than a prediction horizon."""
        if not self._smooth:
            return self._on_course_from_start(now_s)
        self._begin_joining(now_s)
        n = len(self.names)
        derivatives = np.zeros((ORDERS, n, 4))
        legs = [self._leg(i, now_s) for i in range(n)]
        if any(leg.phase is Phase.COURSE for leg in legs):
            path, yaw = self.course.at(now_s - self._epoch_s)
            derivatives[..., :3], derivatives[:YAW_ORDERS, :, 3] = path, yaw
        for i, leg in enumerate(legs):
            if leg.phase is not Phase.COURSE:
                path, yaw = leg.motion(np.array([now_s]))
                derivatives[:, i, :3], derivatives[:YAW_ORDERS, i, 3] = path[:, 0], yaw[:, 0]
        return Reference(derivatives, tuple(leg.phase for leg in legs))

    def _on_course_from_start(self, now_s):
        if self._epoch_s is None:
            self._epoch_s = now_s
        path, yaw = self.course.at(now_s - self._epoch_s)
        derivatives = np.zeros((ORDERS, len(self.names), 4))
        derivatives[..., :3], derivatives[:YAW_ORDERS, :, 3] = path, yaw
        return Reference(derivatives, (Phase.COURSE,) * len(self.names))

    def _hold(self, i, motion):
        self._legs[i] = [_Leg(-math.inf, Phase.HOLD, motion)]

    def _leg(self, i, time_s):
        legs = self._legs[i]
        return next((leg for leg in reversed(legs) if time_s >= leg.start_s), legs[0])

    def _track(self, i, times_s):
        """(k, 3) positions of one vehicle as planned, at increasing times."""
        positions = np.empty((len(times_s), 3))
        legs = self._legs[i]
        ends = [leg.start_s for leg in legs[1:]] + [math.inf]
        for leg, end_s in zip(legs, ends):
            part = (times_s >= leg.start_s) & (times_s < end_s)
            if part.any():
                positions[part] = leg.motion(times_s[part])[0][0]
        return positions

    # --------------------------------------------------------------------------------------------------- planning

    def _begin_joining(self, now_s):
        if self._joining and now_s >= self._joining_s and not self.waiting_for(now_s):
            movers, self._joining = sorted(self._joining), set()
            starts = {i: coasting(self._seen[i][0], self._velocity[i], self._seen[i][1], now_s) for i in movers}
            self._join(movers, now_s, starts)

    def _motions(self, movers, now_s):
        """{vehicle: the motion that it is in}, to blend from."""
        return {i: _simplified(self._leg(i, now_s).motion, now_s) for i in movers}

    def _join(self, movers, now_s, starts):
        """Plan ways to the course. starts: {vehicle: motion that it is in}."""
        shortest_s = self._begin_course(movers, now_s, starts) if self._epoch_s is None else None
        ends = {i: on_course(self.course, i, self._epoch_s) for i in movers}
        if shortest_s is None:
            shortest_s = self._shortest_s([(starts[i], ends[i]) for i in movers], now_s)

        def way(i, stretch):
            return Blend(starts[i], ends[i], now_s, shortest_s * stretch)

        ways = self._keep_apart(movers, now_s, shortest_s * _STRETCHES_ALONE[-1] + 1.0, way)
        for i, chosen in ways.items():
            self._legs[i] = [_Leg(now_s, Phase.APPROACH, chosen), _Leg(chosen.end_s, Phase.COURSE, ends[i])]

    def _begin_course(self, movers, now_s, starts):
        """Choose who gets which path, when the course begins, and how long the ways take [s, returned].

        All combinations are judged roughly, the most promising ones exactly: first by what keeps the vehicles apart,
        then by what is soon there.
        """
        n, unordered = len(self.names), self._unordered
        here = np.array([place for place, _ in self._seen])
        for i in movers:
            here[i] = starts[i](np.array([now_s]))[0][0, 0]
        fractions = np.linspace(0.0, 1.0, _PLAN_SAMPLES)
        steps = smooth_step(fractions)[0][:, None, None]
        grid = int(math.ceil(unordered.period_s / _COURSE_GRID_S))
        grid_s = unordered.period_s / grid
        paths = np.array([unordered.at(k * grid_s)[0][0] for k in range(grid)])
        candidates = []  # (cost [s], order, begin_s, duration_s)
        for begin_s in unordered.period_s * np.arange(_COURSE_STARTS) / _COURSE_STARTS:
            there = paths[int(round(begin_s / grid_s)) % grid]
            cost = ((here[:, None] - there[None]) ** 2).sum(axis=2)
            _, nearest = linear_sum_assignment(cost)
            # a least-snap step from rest to rest reaches 2.46 times its mean speed
            far_m = math.sqrt(cost[np.arange(n), nearest].max())
            for stretch in _ROUGH_STRETCHES:
                duration_s = stretch * max(self.limits.shortest_s, 2.46 * far_m / self.limits.speed_m_s)
                slots = paths[np.rint((begin_s + duration_s * fractions) / grid_s).astype(int) % grid]  # (k, n, 3)
                tracks = here[:, None, None] + steps * (slots[None] - here[:, None, None])
                between_m = _closest(tracks.transpose(0, 2, 1, 3))
                for order in itertools.permutations(range(n)) if n <= _ALL_ORDERS else [nearest]:
                    apart_m = min((between_m[i, order[i], j, order[j]] for i, j in self._pairs), default=math.inf)
                    longest_m = math.sqrt(max(cost[i, order[i]] for i in range(n)))
                    cost_s = duration_s + longest_m / self.limits.speed_m_s
                    cost_s += _SPARE_S_M * max(0.0, SAFE_SEPARATION_M + _SPARE_M - apart_m)
                    cost_s += _NEEDED_S_M * max(0.0, SAFE_SEPARATION_M - apart_m)
                    candidates.append((cost_s, order, begin_s, duration_s))
        candidates.sort(key=lambda candidate: candidate[0])
        rounds_s = np.arange(0.0, unordered.repeat_s - 1e-6, unordered.period_s)
        best, tries, too_short_s = None, 0, 0.0
        for _, order, begin_s, duration_s in candidates:
            if duration_s <= too_short_s:
                continue
            course, fits = unordered.reordered(order), False
            # the paths repeat sooner than the yaw: any round will do whose yaw is near enough
            for epoch_s in now_s - begin_s - rounds_s:
                pairs = [(starts[i], on_course(course, i, epoch_s)) for i in movers]
                fits = self._fits(pairs, now_s, duration_s)
                if fits:
                    break
            tries += 1
            if not fits:
                too_short_s = 1.05 * duration_s
            if fits or best is None:
                needed_s = duration_s if fits else self._shortest_s(pairs, now_s)
                tracks = [Blend(*pair, now_s, needed_s)(now_s + needed_s * fractions)[0][0] for pair in pairs]
                score = min(minimum_separation(np.stack(tracks, axis=1)), SAFE_SEPARATION_M), -needed_s
                if best is None or score > best[0]:
                    best = score, course, epoch_s, needed_s
            if (fits and best[0][0] >= SAFE_SEPARATION_M) or tries == _EXACT_TRIES:
                break
        _, self.course, self._epoch_s, duration_s = best
        return duration_s

    def _send_home(self, movers, now_s):
        starts = self._motions(movers, now_s)
        ends = {i: standing(np.array(self._homes[i].position_m, dtype=float), self._homes[i].yaw_rad) for i in movers}
        pairs = [(starts[i], ends[i]) for i in movers]
        shortest_s = self._shortest_s(pairs, now_s)
        delays_s = np.linspace(0.0, _DEPARTURE_SPAN_S, _DEPARTURES)
        best = None
        for delay_s, stretch in sorted(itertools.product(delays_s, _STRETCHES), key=lambda o: o[0] + shortest_s * o[1]):
            leave_s, duration_s = now_s + delay_s, shortest_s * stretch
            ways = {i: Blend(starts[i], ends[i], leave_s, duration_s) for i in movers}
            times = np.linspace(now_s, leave_s + duration_s, _PLAN_SAMPLES)
            tracks = [ways[i](times)[0][0] if i in ways else self._track(i, times) for i in range(len(self.names))]
            apart_m = minimum_separation(np.stack(tracks, axis=1))
            better = best is None or min(apart_m, SAFE_SEPARATION_M) > min(best[0], SAFE_SEPARATION_M) + 1e-6
            if better and (delay_s == 0.0 or self._fits(pairs, leave_s, duration_s)):
                best = apart_m, ways
                if apart_m >= SAFE_SEPARATION_M:
                    break
        self.closest_m, ways = best
        for i, way in ways.items():
            kept = [leg for leg in self._legs[i] if leg.start_s < way.begin_s]
            self._legs[i] = kept + [_Leg(way.begin_s, Phase.HOME, way), _Leg(way.end_s, Phase.HOMED, ends[i])]

    def _keep_apart(self, movers, now_s, span_s, way):
        """{vehicle: way} from way(i, stretch) with the largest of the smallest distances, preferring short ways."""
        stretches = _STRETCHES_ALONE if len(movers) == 1 else _STRETCHES
        times = np.arange(now_s, now_s + span_s, _MEETING_S)
        others = [i for i in range(len(self.names)) if i not in movers and self._autonomous[i]]
        fixed = [self._track(i, times) for i in others]
        candidates = {i: [way(i, stretch) for stretch in stretches] for i in movers}
        tracks = {i: [candidate(times)[0][0] for candidate in candidates[i]] for i in movers}
        choices = [(option,) * len(movers) for option in range(len(stretches))]
        if len(stretches) ** len(movers) <= 64:
            choices += sorted(itertools.product(range(len(stretches)), repeat=len(movers)), key=sum)
        best = None
        for choice in choices:
            apart_m = minimum_separation(np.stack(fixed + [tracks[i][k] for i, k in zip(movers, choice)], axis=1))
            if best is None or apart_m > best[0] + 0.02:
                best = apart_m, choice
            if best[0] >= SAFE_SEPARATION_M:
                break
        self.closest_m, choice = best
        return {i: candidates[i][k] for i, k in zip(movers, choice)}

    def _shortest_s(self, pairs, begin_s):
        """Least time [s] in which the blends of all these pairs of motions stay within the limits."""
        limits = self.limits
        count = int(math.ceil(math.log(limits.longest_s / limits.shortest_s) / math.log(_DURATION_STEP)))
        low, high = 0, count  # longer ways are gentler: bisection finds where they begin to fit
        while low < high:
            middle = (low + high) // 2
            if self._fits(pairs, begin_s, limits.shortest_s * _DURATION_STEP**middle):
                high = middle
            else:
                low = middle + 1
        return min(limits.shortest_s * _DURATION_STEP**low, limits.longest_s)

    def _fits(self, pairs, begin_s, duration_s):
        """Whether blends of this duration stay within the limits.

        A motion may ask for more than the limits by itself (a fast course): then its own peaks are the limits.
        """
        limits = self.limits
        limits = np.array([limits.speed_m_s, limits.acceleration_m_s2, limits.yaw_rate_rad_s])
        times = begin_s + duration_s * np.linspace(0.0, 1.0, _PLAN_SAMPLES)
        for start, end in pairs:
            own = np.maximum(_peaks(start(times)), _peaks(end(times)))
            peaks = _peaks(Blend(start, end, begin_s, duration_s)(times))
            if (peaks > np.maximum(limits, own * (1.2, 1.5, 1.2))).any():
                return False
        return True


def _closest(tracks):
    """(n, m, n, m) smallest distance between vehicle i on path a and vehicle j on path b; tracks: (n, m, k, 3)."""
    difference = tracks[:, :, None, None] - tracks[None, None]
    return np.sqrt((difference * difference).sum(axis=-1)).min(axis=-1)


def _peaks(sampled):
    """Largest speed [m/s], acceleration [m/s^2] and yaw rate [rad/s] of a sampled motion."""
    path, yaw = sampled
    speed, acceleration = np.sqrt((path[1:3] ** 2).sum(axis=2)).max(axis=1)
    return np.array([speed, acceleration, np.abs(yaw[1]).max()])


def _simplified(motion, now_s):
    """The same motion from now on: a blend that has ended is its end; one too deep begins as a coasting vehicle."""
    while isinstance(motion, Blend) and now_s >= motion.end_s:
        motion = motion.end
    depth, inner = 0, motion
    while isinstance(inner, Blend):
        depth, inner = depth + 1, inner.start
    if depth < _DEEPEST:
        return motion
    path, yaw = motion(np.array([now_s]))
    return coasting(path[0, 0], path[1, 0], yaw[0, 0], now_s)


def phase_text(names, phases):
    """The text on trajectory_phase: 'fluffy_II: course; Raven: hold'."""
    return "; ".join("%s: %s" % (name, phase.value) for name, phase in zip(names, phases))


def make_manager(vehicles, course, home_height_m=1.0, limits=None, kind=TrajectoryManager, **options):
    """TrajectoryManager of FleetVehicles: home is above where they started.

    kind: it, or a subclass.  options: of TrajectoryManager.
    """
    if not isinstance(course, Course):
        raise TypeError("course must be a Course, got %r" % (course,))
    homes = [Home((v.start_position_m[0], v.start_position_m[1], home_height_m), v.start_yaw_rad) for v in vehicles]
    return kind([v.template for v in vehicles], homes, course, limits, **options)
