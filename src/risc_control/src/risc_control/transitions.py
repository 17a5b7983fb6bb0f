"""Ways of several vehicles to a course or home, planned together so that they keep apart.

A way is a blend from the present motion of a vehicle into the one that it is to fly, after a delay and over a
duration. An assignment decides which vehicle flies which path. The first attempt lets all vehicles leave and arrive
together: that is soonest and, on the nearest paths, mostly keeps them apart. Where it does not, single vehicles leave
later, take longer, or fly over the others, until every pair is far enough apart. The yaw may take longer than the path.

Ways are smooth to the order of their task: all derivatives to it are continuous, also at start and end (the yaw: to its
acceleration). The computing time grows with the square of the number of vehicles. The same task gives the same plan:
nothing here reads a clock.
"""

import math
from bisect import bisect_left
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from risc_control.motions import RAMP, blend, rise_values, standing, step_values, turn
from risc_control.reference_buffer import Axis, Order
from risc_control.trajectories import Course, minimum_separation, on_course
from risc_lab.compiled import compiled
from risc_lab.settings import Positive, Settings

_STEP_S = 0.25  # for distances, ways count as straight over this time; the true ones are up to 0.01 m smaller
_BEYOND_M = 0.01  # more than the safe distance is enough,
_DELAY_SPAN_S = 9.0  # candidate delays span this time, or that of the ways if it is longer
_DELAYS = np.linspace(0.0, 1.0, 13)  # as fractions of the span
_MANY = 20  # with more vehicles than this every other delay is tried
_STRETCHES = (1.0, 1.3, 1.7, 2.2, 3.0)  # candidate durations over the shortest duration
_RISES_M = (0.1, 0.6)  # and candidate heights above the direct way, over others
_RISE_STRETCHES = (1.1, 1.5, 2.0)  # candidate durations of a way that rises, over its shortest
_WORTH_M = 0.02  # this much more distance is worth a later arrival
_TRIES = 3  # changes of options that are tried: for each vehicle,
_MORE_TRIES = 40  # and for all together
_FRACTIONS = np.linspace(0.0, 1.0, 32)  # of a way, where its speed is sampled
_LITTLE_MORE = 1.1  # times the peaks of its course: a way may reach this in any case
_DURATION_STEP = 1.15  # ratio of the durations that are tried

_COURSE_STARTS = 12  # candidate moments of the course at which the vehicles set out for it
_COURSE_GRID_S = 0.05  # resolution of the course for that choice
_ROUGH_FRACTIONS = np.linspace(0.0, 1.0, 41)  # of each way, where distances are sampled
_GENTLE = 1.35  # ratio of the time of a way to a course to that from rest to rest at the limits
_SPARE_M = 0.1  # separation beyond what is needed: more room for tracking errors;
_SPARE_S_M = 20.0  # cost [s] of each metre of it that is lacking; and of each metre that is needed,
_NEEDED_S_M = 1000.0  # which is worth any detour
_PEAK_SPEED, _PEAK_ACCELERATION = 2.46, 7.52  # about, of a least-snap step of 1 m in 1 s [m/s, m/s^2]


@dataclass(frozen=True)
class WayLimits(Settings):
    """Limits of the ways to the course and home."""

    speed_m_s: Positive = 0.6
    acceleration_m_s2: Positive = 0.5
    yaw_rate_rad_s: Positive = 0.32
    shortest_s: Positive = 2.5
    longest_s: Positive = 40.0
    highest_m: Positive = 2.4  # a way that leads over others goes no higher
    # limits however fast the course is
    speed_most_m_s: Positive = math.inf
    acceleration_most_m_s2: Positive = math.inf

    def __post_init__(self):
        super().__post_init__()
        if self.longest_s < self.shortest_s:
            raise ValueError("longest_s must not be below shortest_s, got %r" % (self,))


class Home(NamedTuple):
    """Position and yaw to which a vehicle returns at the end."""

    position_m: tuple  # (3,) cortex frame
    yaw_rad: float


class Task(NamedTuple):
    """What is to be planned, with all inputs. None of it changes afterwards."""

    begin_s: float  # the earliest departure
    starts: dict  # {vehicle: its present motion} of the vehicles that are to leave, in order
    others: tuple  # motions of the other vehicles, which are not changed and are to be avoided
    places_m: np.ndarray  # (n, 3) where each vehicle was seen last
    course: Course
    epoch_s: float | None  # when the course began; None: the plan chooses it, and which vehicle flies which path
    homes: tuple | None  # Home of each vehicle; None: they fly to the course
    limits: WayLimits
    calls: tuple  # numbers of their motions for the way, and for what comes after it
    smooth: int  # order to which the ways are continuous
    safe_m: float  # distance that is to be kept between any two, if possible


class Plan(NamedTuple):
    """Result of the planning."""

    ways: dict  # {vehicle: Motion}
    course: Course  # reordered, if the assignment of paths was free
    epoch_s: float | None
    closest_m: float  # smallest distance between two vehicles


def plan_ways(task):
    """The Plan of a Task."""
    course, epoch_s, shortest_s, together_s = task.course, task.epoch_s, None, None
    if task.homes is not None:
        ends = {i: standing(*task.homes[i]) for i in task.starts}
    else:
        if epoch_s is None:
            course, epoch_s, shortest_s, together_s = _begin_course(task)
        ends = {i: on_course(course, i, epoch_s) for i in task.starts}
    pairs = [_Pair(start, ends[i].with_fields(smooth=task.smooth)) for i, start in task.starts.items()]
    if shortest_s is None:
        shortest_s = _shortest_s(pairs, task.begin_s, task.limits)
    timetable = _Timetable(pairs, task, shortest_s, together_s or shortest_s)
    closest_m, choice = timetable.best()
    ways = {}
    for i, pair, option in zip(ends, pairs, choice):
        rise_m, _, delay_s, duration_s = timetable.options[option]
        turning = pair.turning(task.begin_s + delay_s, duration_s, task.limits)
        ways[i] = blend(*pair, task.begin_s + delay_s, duration_s, rise_m, *turning, task.calls)
    return Plan(ways, course, epoch_s, closest_m)


def load():
    """Call each compiled function once, so that none is loaded while vehicles fly."""
    tracks_m, steps = np.zeros((2, 2, 3)), np.zeros((1, 2, 2))
    _fly(tracks_m[0], tracks_m[1], steps[0], tracks_m[0])
    _update_distances(tracks_m, 0, np.zeros((2, 2)))
    _lacking(tracks_m[0], tracks_m[1], steps, tracks_m, 0.0, np.ones(2), np.empty(1))
    minimum_separation(tracks_m)
    standing(np.zeros(3), 0.0).at(np.zeros(2))


# ------------------------------------------------------------------------------------------- when each one leaves


class _Option(NamedTuple):
    """How a vehicle may fly its way. Without a rise is better than with one."""

    rise_m: float
    arrival_s: float  # after the earliest departure
    delay_s: float
    duration_s: float


def _options(delays, shortest_s, together_s, limits, safe_m):
    longest_s = max(shortest_s, limits.longest_s)
    delays_s = [float(part * max(_DELAY_SPAN_S, shortest_s)) for part in delays]
    choices = {(delay_s, min(shortest_s * stretch, longest_s)) for delay_s in delays_s for stretch in _STRETCHES}
    options = [_Option(0.0, sum(choice), *choice) for choice in choices | {(0.0, together_s)}]
    for rise_m in (safe_m + higher_m for higher_m in _RISES_M):
        by_acceleration_s = math.sqrt(_PEAK_ACCELERATION * rise_m / limits.acceleration_m_s2)
        ramp_s = max(_PEAK_SPEED * rise_m / limits.speed_m_s, by_acceleration_s)
        for stretch in _RISE_STRETCHES:
            duration_s = stretch * max(shortest_s, ramp_s / RAMP)
            if duration_s <= longest_s:
                options += [_Option(rise_m, delay_s + duration_s, delay_s, duration_s) for delay_s in delays_s[::2]]
    return sorted(options)


class _Timetable:
    """Delays, durations and rises of given ways."""

    def __init__(self, pairs, task, shortest_s, together_s):
        """shortest_s: duration in which all the ways of these pairs keep the limits.

        together_s: duration of the ways, all leaving at once, of the choice that is tried first.
        """
        self._pairs, self._begin_s, self._limits = pairs, task.begin_s, task.limits
        delays = _DELAYS if len(pairs) <= _MANY else _DELAYS[::2]
        # the best first: without rise, then early
        self.options = _options(delays, shortest_s, together_s, task.limits, task.safe_m)
        self._level = sum(option.rise_m == 0.0 for option in self.options)
        self._first = self.options.index(_Option(0.0, together_s, 0.0, together_s))
        self._fitting = {}  # (vehicle, option): whether the way keeps the limits
        times = np.arange(0.0, max(option.arrival_s for option in self.options) + 2.0 * _STEP_S, _STEP_S)
        rises_m, _, delays_s, durations_s = np.array(self.options).T[..., None]
        fractions = (times - delays_s) / durations_s
        # (options, 2, t): progress along the way, 0 to 1, and the rise [m]
        how_high_m = rises_m * rise_values(fractions, task.smooth)
        self._steps = np.stack([step_values(fractions, task.smooth), how_high_m], axis=1)
        self._starts = _positions([pair.start for pair in pairs], task.begin_s + times)  # (movers, t, 3)
        self._ends = _positions([pair.end for pair in pairs], task.begin_s + times)
        # tracks of all with the present choice: the vehicles that leave, then the others
        self._tracks = np.concatenate([self._starts, _positions(task.others, task.begin_s + times)])
        self._near_m = np.full((len(self._tracks), len(self._tracks)), math.inf)  # smallest distance of each pair
        apart_m = minimum_separation(np.ascontiguousarray(self._ends.transpose(1, 0, 2)))
        # no more is possible than the course itself has
        self._enough_m = min(task.safe_m + _BEYOND_M, apart_m - 0.003)

    def best(self):
        """(smallest distance, choice: an option for each vehicle that leaves): apart if possible, then early."""
        best = self._all_choose([self._first] * len(self._pairs))
        if best[0] < self._enough_m:
            staggered = self._staggered(best[1])
            best = self._better_of(best, staggered)
            for option in range(self._level):
                if best[0] >= self._enough_m and self.options[option].arrival_s >= self._arrival_s(best[1]):
                    break
                found = self._all_choose([option] * len(self._pairs))
                if self._better_of(best, found) is found and all(self._fits(*way) for way in enumerate(found[1])):
                    best = found
            if best[0] < self._enough_m and best is not staggered:
                best = self._better_of(best, self._staggered(best[1]))
        return best

    def _arrival_s(self, choice):
        """When the last one arrives."""
        return max(self.options[option].arrival_s for option in choice)

    def _better_of(self, known, found):
        """Of two (smallest distance, choice) the first, unless the second is clearly farther, or enough and earlier."""
        if known[0] >= self._enough_m:
            is_better = found[0] >= self._enough_m and self._arrival_s(found[1]) < self._arrival_s(known[1])
        else:
            is_better = found[0] >= self._enough_m or found[0] > known[0] + _WORTH_M
        return found if is_better else known

    def _fits(self, i, option):
        """Whether a way keeps the limits."""
        if (i, option) not in self._fitting:
            rise_m, _, delay_s, duration_s = self.options[option]
            track_m = np.empty(self._starts[i].shape)
            _fly(self._starts[i], self._ends[i], self._steps[option], track_m)
            is_low = rise_m == 0.0 or track_m[:, Axis.Z].max() <= self._limits.highest_m
            begin_s = self._begin_s + delay_s
            self._fitting[i, option] = is_low and self._pairs[i].fits(begin_s, duration_s, self._limits, rise_m)
        return self._fitting[i, option]

    def _choose(self, i, option):
        _fly(self._starts[i], self._ends[i], self._steps[option], self._tracks[i])
        _update_distances(self._tracks, i, self._near_m)

    def _all_choose(self, choice):
        """(smallest distance, choice)"""
        for i, option in enumerate(choice):
            self._choose(i, option)
        return float(self._near_m.min()), list(choice)

    def _staggered(self, choice):
        """(smallest distance, choice): some options changed, one after the other, to increase the distances."""
        best, choice, movers = self._all_choose(choice), list(choice), len(choice)
        weights = np.ones(self._near_m.shape)  # pairs that stay too near count more from then on
        tries = _TRIES * movers + _MORE_TRIES
        while tries > 0 and best[0] < self._enough_m:
            changed = False
            for i in np.argsort(self._near_m[:movers].min(axis=1), kind="stable"):
                if self._near_m[i].min() < self._enough_m and tries > 0:
                    tries -= 1
                    option = self._better(i, choice[i], weights)
                    if option is not None:
                        choice[i], changed = option, True
                        self._choose(i, option)
            if self._near_m.min() > best[0]:
                best = float(self._near_m.min()), list(choice)
            if not changed:
                weights[self._near_m < self._enough_m] += 1.0
        return self._hastened(best[1]) if best[0] >= self._enough_m else best

    def _hastened(self, choice):
        """(smallest distance, choice): vehicles arrive earlier, the last one first, if they stay apart."""
        _, choice = self._all_choose(choice)
        weights = np.ones(self._near_m.shape)
        for i in sorted(range(len(choice)), key=lambda i: -self.options[choice[i]].arrival_s):
            present = self.options[choice[i]]
            for k in np.flatnonzero(self._lacking(i, weights) == 0.0):
                option = self.options[k]
                sooner = option.rise_m <= present.rise_m and option.arrival_s < present.arrival_s - 1e-6
                if sooner and self._fits(i, k):
                    choice[i] = k
                    self._choose(i, k)
                    break
        return self._all_choose(choice)

    def _lacking(self, i, weights):
        """(options,) weighted sum of the distances that vehicle i lacks to all others. weights: (n, n) of the pairs."""
        own_m, lacking_m = np.concatenate([self._starts[i], self._ends[i]]), np.empty(len(self.options))
        low_m, high_m = own_m.min(axis=0) - self._enough_m, own_m.max(axis=0) + self._enough_m
        high_m[Axis.Z] += self._steps[:, 1].max()
        can_meet = ((self._tracks.max(axis=1) >= low_m) & (self._tracks.min(axis=1) <= high_m)).all(axis=1)
        can_meet[i] = False
        counts = weights[i] * can_meet
        _lacking(self._starts[i], self._ends[i], self._steps, self._tracks, self._enough_m, counts, lacking_m)
        return lacking_m

    def _better(self, i, present, weights):
        """An option of a vehicle with which it lacks less distance to the others than now; None = there is none."""
        lacking_m = self._lacking(i, weights)
        better = [k for k in np.argsort(lacking_m, kind="stable") if lacking_m[k] <= lacking_m[present] - 1e-6]
        return next((option for option in better if self._fits(i, option)), None)


def _positions(motions, times_s):
    """(motions, t, 3)"""
    tracks_m = [motion.at(times_s, Order.POSITION)[0, :, : Axis.PSI] for motion in motions]
    return np.array(tracks_m).reshape(-1, len(times_s), 3)


@compiled
def _fly(start_m, end_m, steps, track_m):
    """Fill track_m (t, 3) with the way from one track to another; steps (2, t): progress, and rise."""
    for k in range(len(track_m)):
        for axis in range(3):
            track_m[k, axis] = start_m[k, axis] + steps[0, k] * (end_m[k, axis] - start_m[k, axis])
        track_m[k, 2] += steps[1, k]


@compiled
def _nearest(first_m, second_m):
    """Smallest distance of two vehicles on tracks (t, 3) that are straight from one time to the next."""
    x, y, z = first_m[0, 0] - second_m[0, 0], first_m[0, 1] - second_m[0, 1], first_m[0, 2] - second_m[0, 2]
    least = x * x + y * y + z * z
    for k in range(1, len(first_m)):
        before_x, before_y, before_z = x, y, z
        x, y, z = first_m[k, 0] - second_m[k, 0], first_m[k, 1] - second_m[k, 1], first_m[k, 2] - second_m[k, 2]
        square = x * x + y * y + z * z
        least = min(least, square)
        dx, dy, dz = x - before_x, y - before_y, z - before_z
        ahead = x * dx + y * dy + z * dz
        if ahead > 0.0 and before_x * dx + before_y * dy + before_z * dz < 0.0:  # they pass each other in between
            least = min(least, square - ahead * ahead / (dx * dx + dy * dy + dz * dz))
    return math.sqrt(max(least, 0.0))


@compiled
def _update_distances(tracks_m, i, near_m):
    """Update row and column of vehicle i in near_m (n, n) for tracks (n, t, 3)."""
    for j in range(len(tracks_m)):
        if j != i:
            near_m[i, j] = near_m[j, i] = _nearest(tracks_m[i], tracks_m[j])


@compiled
def _lacking(start_m, end_m, steps, tracks_m, enough_m, weights, lacking_m):
    """Fill lacking_m (options,): weighted sum of the distances to tracks (n, t, 3) that a vehicle lacks by option.

    steps: (options, 2, t) as of `_fly`.  weights: (n,) of the tracks.
    """
    track_m = np.empty(start_m.shape)
    for option in range(len(steps)):
        _fly(start_m, end_m, steps[option], track_m)
        lacking_m[option] = 0.0
        for j in range(len(tracks_m)):
            if weights[j] > 0.0:
                lacking_m[option] += weights[j] * max(0.0, enough_m - _nearest(track_m, tracks_m[j]))


# ------------------------------------------------------------------------------------------- who flies which path


def _begin_course(task):
    """Choose which vehicle flies which path, and when the course begins: far enough apart first, then early.

    Returns (course reordered, its epoch, least time of the ways [s], time of the ways when all leave together [s]).
    """
    course, limits, begin_s = task.course, task.limits, task.begin_s
    paths_m = course.over_period(math.ceil(course.period_s / _COURSE_GRID_S))[:, 0, :, : Axis.PSI]
    grid_s = course.period_s / len(paths_m)

    def slots(course_s):
        return paths_m[int(round(course_s / grid_s)) % len(paths_m)]

    times = begin_s + np.arange(0.0, limits.longest_s + _STEP_S, _STEP_S)
    here_m = np.repeat(task.places_m[None], len(times), axis=0)  # (t, n, 3)
    here_m[:, list(task.starts)] = _positions(task.starts.values(), times).transpose(1, 0, 2)
    choices = {}  # {(when on the course, order): (longest way [m], how long it takes at least [s])}
    for course_s in course.period_s * np.arange(_COURSE_STARTS) / _COURSE_STARTS:
        _, far_m = _assignment(here_m[0], slots(course_s))
        about_s = _GENTLE * max(limits.shortest_s, _PEAK_SPEED * far_m / limits.speed_m_s)
        # two vehicles on the lines of least squared length come no closer than their starts or their ends are apart
        for part in (0.0, 0.5, 1.0, 2.0):
            then = min(int(part * about_s / _STEP_S), len(times) - 1)
            order, far_m = _assignment(here_m[then], slots(course_s + part * about_s))
            choices[float(course_s), tuple(order)] = far_m, min(about_s, float(limits.longest_s))
    steps = int(math.log(limits.longest_s / limits.shortest_s) / math.log(_DURATION_STEP)) + 1
    best_s, best = math.inf, None
    for course_s, order in sorted(choices, key=choices.get):
        ways_m = np.linalg.norm(here_m[0] - slots(course_s)[list(order)], axis=1)
        far_first = sorted(task.starts, key=lambda i: -ways_m[i])  # the farthest is the most likely to be too fast
        ends = {i: on_course(course, order[i], begin_s - course_s).with_fields(smooth=task.smooth) for i in far_first}
        pairs = [_Pair(task.starts[i], end) for i, end in ends.items()]
        durations_s = choices[course_s, order][1] * _DURATION_STEP ** np.arange(steps)
        durations_s = durations_s[(durations_s <= limits.longest_s) & (durations_s < best_s)]
        rows = (course_s + _ROUGH_FRACTIONS * durations_s[:, None]) / grid_s
        apart_m = _rough_distances(here_m, paths_m[:, order], rows, durations_s, task.smooth)
        for cost_s, duration_s in sorted(zip(durations_s + _worth_s(apart_m, task.safe_m), durations_s)):
            if cost_s >= best_s:
                break
            if all(pair.fits(begin_s, duration_s, limits) for pair in pairs):
                best_s, best = cost_s, (order, course_s, pairs, float(duration_s))
        if best is None:  # perhaps no way keeps the limits
            best = order, course_s, pairs, float(limits.longest_s)
    order, course_s, pairs, together_s = best
    shortest_s = min(together_s, max(_shortest_s(pairs, begin_s, limits), choices[course_s, order][1]))

    def turning_s(epoch_s):
        pairs = [_Pair(start, on_course(course, order[i], epoch_s)) for i, start in task.starts.items()]
        return max(pair.turning(begin_s, together_s, limits)[0] for pair in pairs)

    # paths repeat earlier than the yaw: any round may be chosen
    epochs_s = begin_s - course_s - np.arange(0.0, course.repeat_s - 1e-6, course.period_s)
    return course.reordered(order), float(min(epochs_s, key=turning_s)), shortest_s, together_s


def _worth_s(apart_m, safe_m):
    """Cost [s] of coming within apart_m of each other, to be weighed against the time of a detour."""
    spare_m, needed_m = safe_m + _SPARE_M - apart_m, safe_m - apart_m
    return _SPARE_S_M * np.maximum(0.0, spare_m) + _NEEDED_S_M * np.maximum(0.0, needed_m)


def _assignment(here_m, there_m):
    """(order, longest way [m]): vehicle i flies to place order[i], with the least sum of squares."""
    cost = cdist(here_m, there_m, "sqeuclidean")
    rows, order = linear_sum_assignment(cost)
    return order.tolist(), math.sqrt(cost[rows, order].max())


def _rough_distances(here_m, paths_m, rows, durations_s, smooth):
    """(d,) smallest distance [m] between two vehicles on ways of equal duration, for each of the durations (d,).

    here_m: (t, n, 3) present positions, every _STEP_S.  paths_m: (k, n, 3) positions on the course; rows:
    (d, _ROUGH_FRACTIONS) indices of these, with fractions.
    """
    now = np.minimum((_ROUGH_FRACTIONS * durations_s[:, None] / _STEP_S).astype(int), len(here_m) - 1)
    low = rows.astype(int)
    before_m, after_m = paths_m[low % len(paths_m)], paths_m[(low + 1) % len(paths_m)]
    there_m = before_m + (rows - low)[..., None, None] * (after_m - before_m)
    step, tracks_m = step_values(_ROUGH_FRACTIONS, smooth)[:, None, None], here_m[now]
    tracks_m += step * (there_m - tracks_m)
    return np.array([minimum_separation(track_m) for track_m in tracks_m])


# ------------------------------------------------------------------------------------------------------- limits


class _Pair(NamedTuple):
    """Two motions: a vehicle flies from the first into the second."""

    start: object
    end: object

    def fits(self, begin_s, duration_s, limits, rise_m=0.0):
        """Whether a blend keeps speed and acceleration.

        A motion may itself need more than is allowed (a fast course): then its own peaks are the limits, and a little
        more, as far as the vehicles can fly it.
        """
        first, last = (motion.at(begin_s + duration_s * _FRACTIONS, Order.ACCELERATION)[..., :3] for motion in self)
        smooth = int(self.end.links["smooth"][0])
        step, rise = _unit_blend(smooth)
        scale = duration_s ** -np.arange(3.0)[:, None, None]
        s, d = scale * step, last - first
        velocity = first[1] + s[0] * d[1] + s[1] * d[0] + rise_m * scale[1] * rise[1]
        acceleration = first[2] + s[0] * d[2] + 2.0 * s[1] * d[1] + s[2] * d[0] + rise_m * scale[2] * rise[2]
        own = np.sqrt((np.stack([first[1:], last[1:]]) ** 2).sum(axis=-1)).max(axis=(0, 2))
        peaks = np.sqrt((np.stack([velocity, acceleration]) ** 2).sum(axis=-1)).max(axis=1)
        allowed = np.maximum([limits.speed_m_s, limits.acceleration_m_s2], own * (1.2, 1.5))
        most = np.maximum([limits.speed_most_m_s, limits.acceleration_most_m_s2], own * _LITTLE_MORE)
        allowed = np.minimum(allowed, most)
        return bool((peaks <= allowed).all())

    def turning(self, begin_s, duration_s, limits):
        """(duration of the turn [s], revolutions beyond the nearest): the shortest that keeps the yaw rate."""
        best_rad_s, best = math.inf, None
        while True:
            times = begin_s + duration_s * _FRACTIONS
            first, last = (motion.at(times, Order.ACCELERATION)[..., Axis.PSI] for motion in self)
            # a motion may itself turn faster
            allowed_rad_s = max(limits.yaw_rate_rad_s, 1.2 * np.abs([first[1], last[1]]).max())
            for revolutions in (0, -1, 1):
                polynomial = turn(first[:, 0], last[:, -1], duration_s, revolutions)
                rates_rad_s = np.polyval(np.arange(5, 0, -1) * polynomial[:0:-1], _FRACTIONS) / duration_s
                rate_rad_s = np.abs(rates_rad_s).max()
                if rate_rad_s < best_rad_s:
                    best_rad_s, best = rate_rad_s, (duration_s, revolutions)
                if rate_rad_s <= allowed_rad_s:
                    return duration_s, revolutions
            duration_s *= _DURATION_STEP
            if duration_s > limits.longest_s:
                return best


@cache
def _unit_blend(smooth):
    """Step (3, f, 1) and rise along z (3, f, 3) of a blend that takes 1 s, with two derivatives, at _FRACTIONS."""
    step, rise = (np.array([values(_FRACTIONS, smooth, d) for d in range(3)]) for values in (step_values, rise_values))
    return step[..., None], rise[..., None] * (0.0, 0.0, 1.0)


def _shortest_s(pairs, begin_s, limits):
    """Least time [s] in which the blends of all these pairs of motions stay within the limits."""
    count = int(math.ceil(math.log(limits.longest_s / limits.shortest_s) / math.log(_DURATION_STEP)))
    durations_s = [min(limits.shortest_s * _DURATION_STEP**k, float(limits.longest_s)) for k in range(count + 1)]

    def fits(duration_s):
        return all(pair.fits(begin_s, duration_s, limits) for pair in pairs)

    return durations_s[bisect_left(durations_s, True, hi=count, key=fits)]  # longer ways are gentler
