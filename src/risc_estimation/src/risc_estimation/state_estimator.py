"""From markers to the twelve states of every vehicle and the positions of the landmarks (thesis 4.2, 4.3).

Two stages: `pose_fit` turns the markers of a frame into raw poses, a filter (risc_estimation/filters) turns poses into
states. `StatesEstimator` runs both, `PosesEstimator` only the filter. Bodies are identified by name; their order in a
frame means nothing. Time comes from the frames' stamps.
"""

import copy
import math
from collections import Counter, deque
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from risc_estimation.filters import make_filter
from risc_estimation.given_poses import GivenPoses
from risc_estimation.pose_fit import NOTHING, PoseFit
from risc_lab.clock_guard import ClockGuard, Step
from risc_lab.lab.templates import LANDMARK, VEHICLE

_LATE = 128  # frames


class FrameEstimate(NamedTuple):
    """Estimate of one frame. SI units, cortex axes, angles in the NED sense; rows in the order of `names`."""

    stamp_s: float
    names: tuple[str, ...]  # every known vehicle or attached body, seen or not
    visible: np.ndarray  # (vehicles,) bool
    states: np.ndarray  # (vehicles, 12), columns `S`; the last known values where not visible, 0 at first
    landmark_names: tuple[str, ...]  # the landmarks seen in this frame
    landmarks_m: np.ndarray  # (landmarks, 3) their positions [m]


@dataclass
class EstimatorCounts:
    """Counts since the start of what was refused and why, for diagnostics."""

    frames: int = 0  # frames estimated
    late_frames: int = 0  # of these, frames older than the newest one that the filter still used
    duplicate_stamps: int = 0  # frames refused: same stamp as the one before
    backward_stamps: int = 0  # frames refused: older than the one before, far ahead of it, or not a number
    clock_resets: int = 0  # a new clock, or ten seconds of silence: the estimator started afresh
    markers_left_out: int = 0  # a marker did not fit and the body was estimated without it
    markers_frozen: int = 0  # a marker was ignored because its coordinates were frozen
    misfits: int = 0  # body refused: residual too large
    collinear: int = 0  # body refused: visible markers on one line
    tilted: int = 0  # body refused: upside down
    jumps: int = 0  # body refused: it cannot have moved there
    outside: int = 0  # body invisible: outside the arena
    swaps_mended: int = 0  # body estimated although labels of its markers were exchanged
    filled_in: int = 0  # body estimated with markers that have no label
    exchanges: int = 0  # bodies had each other's names, and got their own markers back
    unknown: Counter = field(default_factory=Counter)  # frames, by name of a body without a template
    exchanged: Counter = field(default_factory=Counter)  # exchanges by (body, name that its markers had)


class _Estimator:
    """A filter, and in front of it the handling of late frames, duplicates and clocks that were set.

    Subclasses define what a frame is and how poses are made of it. Not thread-safe.
    """

    def __init__(self, velocity_filter, poses):
        self._filter = velocity_filter
        self.poses = poses  # raw `pose_fit.Poses` of the newest frame, rows as in `names`: with covariances
        self._counts = EstimatorCounts()
        self._stamps = ClockGuard()
        self._coasted_s = -math.inf  # up to here states were predicted without frames
        self._late = deque(maxlen=_LATE)  # frames that are late or of a new clock: the next one decides

    def _pose(self, stamp_s, *frame):
        """Bring `poses` up to date with a frame. Returns (names of landmarks seen, (landmarks, 3) [m]), or ()."""
        raise NotImplementedError

    def _forget(self):
        """Forget earlier poses: the clock was set, so their stamps mean nothing now."""

    @property
    def names(self):
        """Names of all known vehicles and attached bodies: the listed ones, then the others as they were first seen."""
        return self.poses.names

    @property
    def counts(self):
        """EstimatorCounts up to now."""
        return replace(self._counts)

    @property
    def frames(self):
        """Number of frames taken so far."""
        return self._counts.frames

    @property
    def on_board_wanted(self):
        """Set of the quantities that the filter wants through `on_board`; see `filters.VelocityFilter`."""
        return frozenset(self._filter.ON_BOARD)

    def status(self):
        """[`filters.Status`] of all bodies in the newest frame."""
        return self._filter.status(self.poses)

    def counters(self):
        """(bodies,) `filters.COUNTS` up to now; None if the filter does not count."""
        return self._filter.counters()

    def covariances(self):
        """(vehicles, 12, 12) covariances of the newest states; None if the filter has none."""
        return self._filter.covariances()

    def accelerations(self):
        """(vehicles, 3) [m/s^2] of the newest states, see `filters.VelocityFilter`; None if the filter has no model."""
        return self._filter.accelerations()

    def _update(self, stamp_s, *frame):
        """See `StatesEstimator.update`."""
        newest_s = self._stamps.newest_s
        step = self._stamps.look(stamp_s)
        if step is Step.REFUSED:
            if stamp_s == newest_s:
                self._counts.duplicate_stamps += 1
            elif stamp_s < newest_s <= stamp_s + self._filter.late_s:
                self._late.append((stamp_s, *copy.deepcopy(frame)))
            else:
                self._counts.backward_stamps += 1
            return None
        if step is Step.NEW_CLOCK:
            self._counts.clock_resets += 1
            self._late.clear()
            self._forget()
            self._filter.reset()
            self._coasted_s = -math.inf
        while self._late:
            self._counts.late_frames += 1
            self._take(*self._late.popleft())
        landmarks = self._take(stamp_s, *frame)
        if stamp_s <= self._coasted_s:
            return None
        return self._estimate(self._filter.visible.copy(), *landmarks)

    def coast(self, stamp_s):
        """FrameEstimate of a time [s] for which no frame has come; None if no body is visible then."""
        newest_s = max(self._stamps.newest_s, self._coasted_s)
        if not stamp_s > newest_s > -math.inf or not self._filter.coast(stamp_s):
            return None
        self._coasted_s = stamp_s
        return self._estimate(self._filter.visible.copy())._replace(stamp_s=stamp_s)

    def _take(self, stamp_s, *frame):
        landmarks = self._pose(stamp_s, *frame)
        self._counts.frames += 1
        self._filter.update(self.poses)
        return landmarks

    def _estimate(self, visible, landmark_names=(), landmarks_m=np.zeros((0, 3))):
        states = self._filter.states.copy()
        return FrameEstimate(self.poses.stamp_s, self.names, visible, states, landmark_names, landmarks_m)

    def on_board(self, name, stamp_s, what, values):
        """Pass on what the filter wants of a known body, see `VelocityFilter.on_board`; anything else is ignored."""
        if what in self._filter.ON_BOARD and name in self.names:
            self._filter.on_board(self.names.index(name), stamp_s, what, values)

    def lost(self):
        """FrameEstimate for when frames have stopped: the last numbers, nothing visible. None before the first."""
        if self._stamps.newest_s == -math.inf:
            return None
        return self._estimate(np.zeros(len(self.names), dtype=bool))


class StatesEstimator(_Estimator):
    """Frames of named marker sets in, `FrameEstimate` out.

    The pose fit decides which poses are accepted, the filter when a vehicle is visible.
    """

    def __init__(self, templates, params=None, vehicles=(), velocity_filter=None, vehicle_types=None):
        """templates: dict name -> risc_lab.lab.templates.Template.   params: PoseFitParams.   vehicles: names listed
        from the start.   velocity_filter: a new `filters.VelocityFilter`; None: the default one.   vehicle_types:
        {name: VehicleType} of the vehicles of the fleet.

        Raises ValueError if a listed vehicle has no template or a landmark's, or if a template other than a landmark's
        has fewer than three markers.
        """
        velocity_filter, types = velocity_filter or make_filter(), vehicle_types or {}

        def add(template):
            velocity_filter.add_body(template, types.get(template.name))

        self._fit = PoseFit(templates, params, add, velocity_filter.GATES)
        super().__init__(velocity_filter, self._fit.poses)
        self._counts.unknown, self._counts.exchanged = self._fit.unknown, self._fit.exchanged
        _check_listed(vehicles, self._fit.body_names())
        for name in vehicles:
            self._fit.admit(name)

    @property
    def counts(self):
        return replace(super().counts, **self._fit.refusals)

    def innovations(self):
        """`filters.Innovations` of the newest frame; None if the filter has none."""
        return self._filter.innovations(self.poses)

    @property
    def misses_a_body(self):
        """True if a body that was seen recently has no pose in the newest frame."""
        return self._fit.misses_a_body

    def update(self, stamp_s, layout, markers_m, loose_m=NOTHING):
        """Estimate one frame. layout, markers_m and loose_m: see `PoseFit.update`.

        stamp_s: time of exposure [s]. Returns FrameEstimate; None when the stamp does not advance (counted), or is not
        later than states that `coast` has given. A frame that is late by at most the filter's late_s is kept, and
        reaches the filter with the next one that advances: by then it is known that the clock was not set.
        Raises ValueError when layout and markers_m do not match.
        """
        return self._update(stamp_s, layout, markers_m, loose_m)

    def _pose(self, stamp_s, layout, markers_m, loose_m):
        return self._fit.update(stamp_s, layout, markers_m, loose_m)

    def _forget(self):
        self._fit.forget()


class PosesEstimator(_Estimator):
    """Frames of raw poses that were fitted elsewhere (/mocap_poses) in, `FrameEstimate` out, without landmarks."""

    def __init__(self, templates, vehicles=(), velocity_filter=None, vehicle_types=None):
        """As `StatesEstimator`. Raises ValueError if a listed vehicle has no template, or a landmark's."""
        super().__init__(velocity_filter or make_filter(), GivenPoses())
        self._bodies = {name: template for name, template in templates.items() if template.kind != LANDMARK}
        self._types, self._newest_names = vehicle_types or {}, ()
        _check_listed(vehicles, sorted(self._bodies))
        self._admit(vehicles)

    def update(self, stamp_s, frame):
        """Estimate one frame of raw poses, a `given_poses.PoseFrame`. Otherwise as `StatesEstimator.update`."""
        return self._update(stamp_s, frame)

    def _pose(self, stamp_s, frame):
        if frame.names != self._newest_names:
            self._newest_names = frame.names
            self._admit(frame.names)
        for name in self._unknown_here:
            self._counts.unknown[name] += 1
        self.poses.take(stamp_s, frame)
        return ()

    def _admit(self, names):
        """Add a row for each of these bodies that has a template and no row yet."""
        self._unknown_here = [name for name in names if name not in self._bodies]
        for name in names:
            if name in self._bodies and name not in self.names:
                self.poses.add(name, self._bodies[name].kind == VEHICLE)
                self._filter.add_body(self._bodies[name], self._types.get(name))


def _check_listed(vehicles, known):
    """Raises ValueError when one of these names is not among the known bodies."""
    for name in vehicles:
        if name not in known:
            raise ValueError(
                "vehicle '%s' needs a template of kind vehicle; there are %s. Add it to the templates file or correct "
                "the name" % (name, ", ".join(known))
            )
