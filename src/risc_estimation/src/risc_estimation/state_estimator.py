"""From markers to the twelve states of every vehicle and the positions of the landmarks (thesis 4.2, 4.3).

Two stages: `pose_fit` makes raw poses of a frame's markers, a filter (risc_estimation/filters) makes states of them.
`StatesEstimator` is both, `PosesEstimator` the second one alone. Bodies are keyed by name; their order in a frame means
nothing. Time comes from the frames' stamps.
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
from risc_lab.clock import ClockGuard, Step
from risc_lab.lab.templates import LANDMARK, VEHICLE

_LATE = 128  # frames


class FrameEstimate(NamedTuple):
    """What one frame says. SI units, cortex axes, angles in the NED sense; rows in the order of `names`."""

    stamp_s: float
    names: tuple[str, ...]  # every known vehicle or attached body, seen or not
    visible: np.ndarray  # (vehicles,) bool
    states: np.ndarray  # (vehicles, 12), columns `S`; the last known where not visible, first 0
    landmark_names: tuple[str, ...]  # the landmarks seen in this frame
    landmarks_m: np.ndarray  # (landmarks, 3) their positions [m]


@dataclass
class EstimatorCounts:
    """What was refused and why; grows for ever, meant for diagnostics."""

    frames: int = 0  # frames estimated
    late_frames: int = 0  # of them, those that were older than another one, and that the filter still took
    duplicate_stamps: int = 0  # frames refused: same stamp as the one before
    backward_stamps: int = 0  # frames refused: older than the one before, far ahead of it, or not a number
    clock_resets: int = 0  # stamps of a new clock, or after ten seconds of silence: started afresh
    markers_left_out: int = 0  # a marker did not fit and the body was estimated without it
    markers_frozen: int = 0  # one marker stood still for some frames, and was no measurement any more
    misfits: int = 0  # body refused: residual too large
    collinear: int = 0  # body refused: visible markers on one line
    tilted: int = 0  # body refused: upside down
    jumps: int = 0  # body refused: where it cannot have come to
    outside: int = 0  # body invisible: outside the arena
    swaps_mended: int = 0  # body estimated although labels of its markers were exchanged
    filled_in: int = 0  # body estimated with markers that have no label
    exchanges: int = 0  # bodies had each other's name, and were given their markers
    unknown: Counter = field(default_factory=Counter)  # frames by name that no template knows
    exchanged: Counter = field(default_factory=Counter)  # exchanges by (body, name that its markers had)


class _Estimator:
    """A filter, and what may become of a stream of frames before it: late, twice, of a clock that was set.

    What a frame is, and how poses are made of it, is up to subclasses. Not thread-safe.
    """

    def __init__(self, velocity_filter, poses):
        self._filter = velocity_filter
        self.poses = poses  # raw `pose_fit.Poses` of the newest frame, rows as in `names`: with covariances
        self._counts = EstimatorCounts()
        self._stamps = ClockGuard()
        self._coasted_s = -math.inf  # up to here states were predicted without frames
        self._late = deque(maxlen=_LATE)  # frames that are late, or of a clock that was set: the next one tells

    def _pose(self, stamp_s, *frame):
        """Bring `poses` up to date with a frame. Returns (names of landmarks seen, (landmarks, 3) [m]), or ()."""
        raise NotImplementedError

    def _forget(self):
        """The clock was set: where bodies were when says nothing now."""

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
        """How many were taken, up to now."""
        return self._counts.frames

    @property
    def on_board_wanted(self):
        """What the filter wants to be given with `on_board`, a set; see `filters.VelocityFilter`."""
        return frozenset(self._filter.ON_BOARD)

    def status(self):
        """[`filters.Status`] of all bodies in the newest frame."""
        return self._filter.status(self.poses)

    def counters(self):
        """(bodies,) `filters.COUNTS` up to now; None if the filter does not count."""
        return self._filter.counters()

    def covariances(self):
        """(vehicles, 12, 12) of the newest states; None if the filter does not know."""
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
        """FrameEstimate of a time [s] for which no frame has come; None if nobody is visible then."""
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
        """Hand the filter what it wants of a body, see `VelocityFilter.on_board`; of one that is not known: nothing."""
        if what in self._filter.ON_BOARD and name in self.names:
            self._filter.on_board(self.names.index(name), stamp_s, what, values)

    def lost(self):
        """FrameEstimate for "no frames arrive any more": the last numbers, nothing visible. None before any."""
        if self._stamps.newest_s == -math.inf:
            return None
        return self._estimate(np.zeros(len(self.names), dtype=bool))


class StatesEstimator(_Estimator):
    """Frames of named marker sets in, `FrameEstimate` out.

    Which poses are believed is up to the pose fit; when a vehicle is visible, to the filter.
    """

    def __init__(self, templates, params=None, vehicles=(), velocity_filter=None, vehicle_types=None):
        """templates: dict name -> risc_lab.lab.templates.Template.   params: PoseFitParams.   vehicles: names listed
        from the start on.   velocity_filter: a new `filters.VelocityFilter`; None: the default one.   vehicle_types:
        {name: VehicleType} of those of the fleet.

        Raises ValueError if a listed vehicle has no template, or that of a landmark, or if a template that is no
        landmark's has fewer than three markers.
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
        """Whether one that was seen lately has no pose in the newest frame."""
        return self._fit.misses_a_body

    def update(self, stamp_s, layout, markers_m, loose_m=NOTHING):
        """Estimate one frame. layout, markers_m and loose_m: see `PoseFit.update`.

        stamp_s: time of exposure [s]. Returns FrameEstimate; None when the stamp does not advance (counted), or is not
        later than states that `coast` has given. A frame that is not older than the filter's late_s reaches the filter
        all the same, with the next one that advances: by then it is known that the clock was not set.
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
        """As `StatesEstimator`. Raises ValueError if a listed vehicle has no template, or that of a landmark."""
        super().__init__(velocity_filter or make_filter(), GivenPoses())
        self._bodies = {name: template for name, template in templates.items() if template.kind != LANDMARK}
        self._types, self._newest_names = vehicle_types or {}, ()
        _check_listed(vehicles, sorted(self._bodies))
        self._admit(vehicles)

    def update(self, stamp_s, frame):
        """Estimate one frame of raw poses, a `given_poses.PoseFrame`. stamp_s and what is returned: as there."""
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
        """A row for each of these bodies that has none yet and that a template knows."""
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
