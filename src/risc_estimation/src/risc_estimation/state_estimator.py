"""From markers to the twelve states of every vehicle and the positions of the landmarks (thesis 4.2, 4.3).

Bodies are keyed by name; their order in a frame means nothing. Time comes from the frames' stamps.
"""

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from risc_estimation.gates import REFUSALS, believe_pose, is_inside, is_settled, limits_of, see_markers
from risc_estimation.landmark_positions import LANDMARK, locate_landmark
from risc_estimation.least_squares import SlidingFit, Window, estimate_newest, push_samples
from risc_estimation.rigid_fit import MIN_MARKERS, POSE, WORK, fit_pose, fit_pose_without_worst
from risc_lab.clock import ClockGuard, Step
from risc_lab.compiled import compiled, record
from risc_lab.frames import euler_of_body_in_cortex, wrap_one_angle
from risc_lab.lab.arena import NET_HALF_X_M, NET_HALF_Y_M, NET_HEIGHT_M
from risc_lab.states import S

_LAYOUTS = 64  # that are remembered

LEGACY_WINDOW_S = 0.25  # the original release: a line through 50 samples at 200 Hz


ARENA_KEYS = ("arena_x_m", "arena_y_m", "arena_z_max_m")  # settings that are those of the net, unless set


@dataclass(frozen=True)
class EstimatorParams:
    """Settings of `StatesEstimator`; config/states_estimation.yaml explains and holds the same values."""

    position_window_s: float = 0.25  # [s] window of the position fit
    position_order: int = 2  # order of its polynomial
    angle_window_s: float = 0.15  # [s] window of the attitude fit
    angle_order: int = 2
    smooth_position: bool = True  # position: the fitted value at the newest sample; false: the raw one
    smooth_angles: bool = True
    legacy_window: bool = False  # the original's estimator: lines over 0.25 s, raw position and angles
    min_samples: int = 5  # samples in the shorter window before a vehicle is visible
    min_span_s: float = 0.042  # [s] and the time they span (10 samples at 200 Hz)
    max_gap_s: float = 0.1  # [s] a longer gap in a body's samples restarts its windows
    max_rate_hz: float = 500.0  # [Hz] highest frame rate that the windows are sized for
    marker_limit_m: float = 100.0  # [m] larger coordinates mean "lost" (9999.999 m in old bags)
    residual_max_m: float = 0.015  # [m] worst rms misfit between template and markers
    min_spread_m: float = 0.01  # [m] least extent of the visible markers across their line
    tilt_max_rad: float = 2.1  # [rad] more is taken for swapped markers, not for flight
    arena_x_m: float = NET_HALF_X_M  # [m] half length of the net
    arena_y_m: float = NET_HALF_Y_M  # [m] half width
    arena_z_min_m: float = -0.1  # [m] floor; a landed vehicle must stay visible
    arena_z_max_m: float = NET_HEIGHT_M  # [m] top of the net
    arena_margin_m: float = 0.05  # [m] how far outside a vehicle still counts as inside

    def within(self, arena, keep=()):
        """The same settings for another Arena, but for the fields named in `keep`."""
        net = zip(ARENA_KEYS, (arena.half_x_m, arena.half_y_m, arena.height_m))
        return replace(self, **{name: value for name, value in net if name not in keep})

    def __post_init__(self):
        for name in (
            "position_window_s",
            "angle_window_s",
            "max_gap_s",
            "max_rate_hz",
            "marker_limit_m",
            "residual_max_m",
            "min_spread_m",
            "tilt_max_rad",
            "arena_x_m",
            "arena_y_m",
        ):
            if not getattr(self, name) > 0.0:
                raise ValueError("%s must be positive, got %r" % (name, getattr(self, name)))
        for name in ("position_order", "angle_order"):
            if getattr(self, name) not in (1, 2, 3):
                raise ValueError("%s must be 1, 2 or 3, got %r" % (name, getattr(self, name)))
        if self.min_samples < 2:
            raise ValueError("min_samples must be at least 2 (a rate needs two), got %r" % (self.min_samples,))
        shorter_s = min(self.position_window_s, self.angle_window_s)
        if not 0.0 <= self.min_span_s < 0.9 * shorter_s:
            raise ValueError(
                "min_span_s must be in [0, 0.9 x the shorter window = %g s), got %r: no vehicle would "
                "ever become visible" % (0.9 * shorter_s, self.min_span_s)
            )
        if not self.arena_z_min_m < self.arena_z_max_m:
            raise ValueError(
                "arena_z_min_m must be below arena_z_max_m, got %r and %r" % (self.arena_z_min_m, self.arena_z_max_m)
            )


class FrameEstimate(NamedTuple):
    """What one frame says. SI units, cortex axes, angles in the NED sense; rows in the order of `names`."""

    stamp_s: float
    names: tuple[str, ...]  # every known vehicle, seen or not
    visible: np.ndarray  # (vehicles,) bool
    states: np.ndarray  # (vehicles, 12), columns `S`; the last known where not visible, first 0
    landmark_names: tuple[str, ...]  # the landmarks seen in this frame
    landmarks_m: np.ndarray  # (landmarks, 3) their positions [m]

    def vehicle(self, name):
        """(visible, state (12,)) of one vehicle. Raises KeyError if it is not known."""
        if name not in self.names:
            raise KeyError("no vehicle '%s'; known are %s" % (name, ", ".join(self.names) or "none"))
        row = self.names.index(name)
        return bool(self.visible[row]), self.states[row]


@dataclass
class EstimatorCounts:
    """What was refused and why; grows for ever, meant for diagnostics."""

    frames: int = 0  # frames estimated
    duplicate_stamps: int = 0  # frames refused: same stamp as the one before
    backward_stamps: int = 0  # frames refused: older than the one before, far ahead of it, or not a number
    clock_resets: int = 0  # stamps of a new clock, or after ten seconds of silence: started afresh
    markers_left_out: int = 0  # one marker did not fit and the body was estimated without it
    misfits: int = 0  # body refused: residual too large
    collinear: int = 0  # body refused: visible markers on one line
    tilted: int = 0  # body refused: upside down
    outside: int = 0  # body invisible: outside the arena
    unknown: Counter = field(default_factory=Counter)  # frames by name that no template knows


ROWS = record(("first", int), ("count", int))  # the markers of a body in those of the frame
VEHICLE = record(("markers", int), ("has_attitude", bool))  # number of its template's; not of an attached body


class Vehicles(NamedTuple):
    """What is known of the vehicles, one row each."""

    known: np.ndarray  # (vehicles,) VEHICLE
    templates_m: np.ndarray  # (vehicles, most markers, 3)
    poses: np.ndarray  # (vehicles,) POSE, body to cortex frame
    present: np.ndarray  # (vehicles,) bool: the newest frame gave a pose
    positions_m: np.ndarray  # (vehicles, 3) and which
    angles_rad: np.ndarray  # (vehicles, 3) roll pitch yaw, without jumps of a whole turn
    states: np.ndarray  # (vehicles, 12)


class Landmarks(NamedTuple):
    """What is known of the landmarks."""

    known: np.ndarray  # (landmarks,) LANDMARK
    offsets_m: np.ndarray  # (landmarks, most markers, 3)
    positions_m: np.ndarray  # (landmarks, 3) of those seen in the newest frame, which come first
    rows: np.ndarray  # (landmarks,) which ones these are


class _Plan(NamedTuple):
    """What a layout of the frame means."""

    vehicles: np.ndarray  # (vehicles,) ROWS
    landmarks: np.ndarray  # (landmarks,) ROWS
    unknown: tuple[str, ...]  # names without a template
    markers_m: np.ndarray  # (markers, 3) copy of the frame's


def pack_bodies(bodies):
    """(layout, markers_m) as `StatesEstimator.update` takes them, from a dict name -> (k, 3) markers [m]."""
    parts = [np.reshape(markers, (-1, 3)) for markers in bodies.values()]
    layout = tuple((name, len(part)) for name, part in zip(bodies, parts))
    return layout, np.concatenate([np.zeros((0, 3)), *parts])


class StatesEstimator:
    """Frames of named marker sets in, `FrameEstimate` out. Not thread-safe.

    A vehicle is visible when enough of its markers fit its template, it is inside the arena and its windows hold
    enough samples for a velocity: `min_samples` that span `min_span_s` (the tenth frame at 200 Hz after a restart;
    a line then has 44 mm/s of noise for 2 mm positions). Dropouts up to `max_gap_s` do not restart the windows: the
    fit runs on real stamps, so the vehicle is visible again with its first good frame.
    """

    def __init__(self, templates, params=None, vehicles=()):
        """templates: dict name -> risc_lab.lab.templates.Template.   vehicles: names listed from the start on.

        Raises ValueError if a listed vehicle has no template, or that of a landmark, or if a template of another kind
        has fewer than three markers.
        """
        self.params = params = params or EstimatorParams()
        self._counts = EstimatorCounts()
        self._refusals = np.zeros(1, dtype=REFUSALS)
        self._templates = dict(templates)
        self._stamps = ClockGuard()
        self._last_stamp_s = None
        self._names, self._landmark_names = (), ()
        for template in self._templates.values():
            if template.kind != "landmark" and len(template.markers_m) < MIN_MARKERS:
                raise ValueError(
                    "template '%s' has %d markers; a body of kind %s needs at least %d"
                    % (template.name, len(template.markers_m), template.kind, MIN_MARKERS)
                )

        orders, windows_s, smooth = (
            (params.position_order, params.angle_order),
            (params.position_window_s, params.angle_window_s),
            (params.smooth_position, params.smooth_angles),
        )
        if params.legacy_window:
            orders, windows_s, smooth = (1, 1), (LEGACY_WINDOW_S, LEGACY_WINDOW_S), (False, False)
        self._position_fit, self._angle_fit = [
            SlidingFit(window_s, order, 3, params.max_gap_s, params.max_rate_hz)
            for window_s, order in zip(windows_s, orders)
        ]
        most = max([len(template.markers_m) for template in self._templates.values()], default=0)
        self._fixed = (
            limits_of(params),
            self._refusals,
            np.zeros(1, dtype=WORK),
            np.zeros(most, dtype=bool),
            *map(bool, smooth),
        )
        self._vehicles = Vehicles(
            known=np.zeros(0, dtype=VEHICLE),
            templates_m=np.zeros((0, most, 3)),
            poses=np.zeros(0, dtype=POSE),
            present=np.zeros(0, dtype=bool),
            positions_m=np.zeros((0, 3)),
            angles_rad=np.zeros((0, 3)),
            states=np.zeros((0, len(S))),
        )
        self._landmarks = Landmarks(
            known=np.zeros(0, dtype=LANDMARK),
            offsets_m=np.zeros((0, most, 3)),
            positions_m=np.zeros((0, 3)),
            rows=np.zeros(0, dtype=int),
        )
        self._forget_layouts()
        self._estimate(0.0, self._plan_for(()))  # without bodies: loads the compiled code
        for name in vehicles:
            template = self._templates.get(name)
            if template is None or template.kind == "landmark":
                raise ValueError(
                    "vehicle '%s' needs a template of kind vehicle; there are %s. Add it to the templates "
                    "file or correct the name" % (name, ", ".join(sorted(self._vehicle_names())))
                )
            self._admit(name)

    @property
    def names(self):
        """Names of all known vehicles: the listed ones, then the others in the order they were first seen."""
        return self._names

    @property
    def counts(self):
        """EstimatorCounts up to now."""
        return replace(self._counts, **dict(zip(REFUSALS.names, self._refusals[0].tolist())))

    def update(self, stamp_s, layout, markers_m):
        """Estimate one frame.

        stamp_s: time of exposure [s].   layout: ((name, number of markers), ...), cheapest when it is the same object
        as long as it stays the same.   markers_m: (markers, 3) [m] of all bodies in that order, cortex frame, each
        body's in its template's order. A lost marker is NaN, infinite or beyond marker_limit_m; markers beyond the
        template's are ignored, missing ones at the end count as lost. Of two bodies of one name the first counts.
        Returns FrameEstimate, or None when the stamp does not advance (counted). Raises ValueError when layout and
        markers_m do not match.
        """
        if not self._accept_stamp(stamp_s):
            return None
        if layout is not self._layout:
            self._plan = self._plans.get(layout) or self._plan_for(layout)
            self._layout = layout
        plan = self._plan
        if np.shape(markers_m) != plan.markers_m.shape:
            raise ValueError("the layout has %d markers, the array is %r" % (len(plan.markers_m), np.shape(markers_m)))
        plan.markers_m[:] = markers_m
        self._counts.frames += 1
        for name in plan.unknown:
            self._counts.unknown[name] += 1
        visible, seen = self._estimate(float(stamp_s), plan)
        landmark_names = self._landmark_names
        if seen < len(landmark_names):
            landmark_names = tuple([landmark_names[row] for row in self._landmarks.rows[:seen]])
        return FrameEstimate(
            stamp_s,
            self._names,
            visible,
            self._vehicles.states.copy(),
            landmark_names,
            self._landmarks.positions_m[:seen].copy(),
        )

    def lost(self):
        """FrameEstimate for "no frames arrive any more": the last numbers, nothing visible. None before any."""
        if self._last_stamp_s is None:
            return None
        return FrameEstimate(
            self._last_stamp_s,
            self._names,
            np.zeros(len(self._names), dtype=bool),
            self._vehicles.states.copy(),
            (),
            np.zeros((0, 3)),
        )

    def _accept_stamp(self, stamp_s):
        step = self._stamps.look(stamp_s)
        if step is Step.REFUSED:
            if stamp_s == self._last_stamp_s:
                self._counts.duplicate_stamps += 1
            else:
                self._counts.backward_stamps += 1
            return False
        if step is Step.NEW_CLOCK:
            self._counts.clock_resets += 1
            self._position_fit.reset()
            self._angle_fit.reset()
        self._last_stamp_s = stamp_s
        return True

    def _vehicle_names(self):
        return [name for name, template in self._templates.items() if template.kind != "landmark"]

    def _plan_for(self, layout):
        """Plan of a layout, remembered; bodies seen for the first time are admitted."""
        places, first = {}, 0
        for name, count in layout:
            places.setdefault(name, (first, count))
            first += count
        for name in places:
            self._admit(name)
        if len(self._plans) >= _LAYOUTS:
            self._forget_layouts()
        plan = self._plans[layout] = _Plan(
            np.array([places.get(name, (0, 0)) for name in self._names], dtype=ROWS),
            np.array([places.get(name, (0, 0)) for name in self._landmark_names], dtype=ROWS),
            tuple([name for name in places if name not in self._templates]),
            np.zeros((first, 3)),
        )
        return plan

    def _forget_layouts(self):
        self._plans, self._layout, self._plan = {}, None, None

    def _admit(self, name):
        """A row for a body, if it has none yet and a template knows it."""
        template = self._templates.get(name)
        if template is None or name in self._names or name in self._landmark_names:
            return
        self._forget_layouts()  # their plans have no row for it
        markers = np.zeros((1,) + self._vehicles.templates_m.shape[1:])
        markers[0, : len(template.markers_m)] = template.markers_m
        if template.kind == "landmark":
            known = np.array([(len(template.markers_m), False)], dtype=LANDMARK)
            self._landmark_names += (name,)
            self._landmarks = _with_row(self._landmarks, known=known, offsets_m=markers)
        else:
            known = np.array([(len(template.markers_m), template.kind == "vehicle")], dtype=VEHICLE)
            self._names += (name,)
            self._vehicles = _with_row(self._vehicles, known=known, templates_m=markers)
            self._position_fit.add_body()
            self._angle_fit.add_body()

    def _estimate(self, stamp_s, plan):
        """(visible (vehicles,) bool, number of landmarks seen); states and landmarks are brought up to date."""
        visible = np.zeros(len(self._names), dtype=bool)
        seen = _estimate_frame(
            stamp_s,
            plan.markers_m,
            plan.vehicles,
            plan.landmarks,
            visible,
            *self._fixed,
            *self._vehicles,
            *self._position_fit.window,
            *self._angle_fit.window,
            *self._landmarks,
        )
        return visible, seen


def _with_row(table, **first):
    """A NamedTuple of arrays with one more row of zeros, or of what is given."""
    return table._make(
        np.concatenate([array, first.get(name, np.zeros((1,) + array.shape[1:], dtype=array.dtype))])
        for name, array in zip(table._fields, table)
    )


# --- compiled: all bodies of a frame in one call


# The arrays come one by one, since a tuple of them takes three times as long to pass.
@compiled
def _estimate_frame(
    stamp_s, markers_m, vehicle_rows, landmark_rows, visible,
    limits, refusals, work, marker_visible, smooth_position, smooth_angles,
    known, templates_m, poses, present, positions_m, angles_rad, states,
    p_fit, p_bodies, p_stamps_s, p_present, p_values, p_weights, p_estimates,
    a_fit, a_bodies, a_stamps_s, a_present, a_values, a_weights, a_estimates,
    l_known, l_offsets_m, l_positions_m, l_rows,
):  # fmt: skip
    """One frame: fills visible (vehicles,) and updates all tables. Returns how many landmarks are seen.

    stamp_s [s]; markers_m (markers, 3) [m]; vehicle_rows, landmark_rows: ROWS of each.  After them: `_fixed`, and the
    fields of Vehicles, of the Window of the positions and of that of the angles, and of Landmarks.
    """
    vehicles = Vehicles(known, templates_m, poses, present, positions_m, angles_rad, states)
    positions = Window(p_fit, p_bodies, p_stamps_s, p_present, p_values, p_weights, p_estimates)
    angles = Window(a_fit, a_bodies, a_stamps_s, a_present, a_values, a_weights, a_estimates)
    landmarks = Landmarks(l_known, l_offsets_m, l_positions_m, l_rows)
    if len(known) > 0:
        for i in range(len(known)):
            rows = vehicle_rows[i]
            measured = markers_m[rows.first : rows.first + rows.count]
            present[i] = _locate(vehicles, i, measured, limits[0], refusals[0], work[0], marker_visible)
        push_samples(positions, stamp_s, positions_m, present)
        push_samples(angles, stamp_s, angles_rad, present)
        estimate_newest(positions, present)
        estimate_newest(angles, present)
        for i in range(len(known)):
            visible[i] = present[i] and is_inside(positions_m[i], limits[0], refusals[0])
            visible[i] &= is_settled(p_bodies[i], limits[0]) and is_settled(a_bodies[i], limits[0])
            if visible[i]:
                _show(vehicles, i, p_estimates[i], a_estimates[i], smooth_position, smooth_angles)
    return _find_landmarks(landmarks, landmark_rows, markers_m, limits[0], marker_visible)


@compiled
def _locate(vehicles, i, measured, limits, refusals, work, marker_visible):
    """Pose of a vehicle from its markers of this frame; returns whether it is believed."""
    pose, template = vehicles.poses[i], vehicles.templates_m[i]
    has_attitude = vehicles.known[i].has_attitude
    seen = marker_visible[: vehicles.known[i].markers]
    count = see_markers(measured, limits, seen)
    if count < MIN_MARKERS:
        return False
    fit_pose(template, measured, seen, work, pose)
    if not pose.residual_m <= limits.residual_max_m:
        if count > MIN_MARKERS:
            fit_pose_without_worst(template, measured, seen, work, pose)
        if not pose.residual_m <= limits.residual_max_m:
            refusals.misfits += 1
            return False
        refusals.markers_left_out += 1
    if not believe_pose(pose, has_attitude, limits, refusals):
        return False
    vehicles.positions_m[i] = pose.position_m
    if has_attitude:
        phi, theta, psi = euler_of_body_in_cortex(pose.rotation)
        angles_rad = vehicles.angles_rad[i]
        angles_rad[0] = _nearest(phi, angles_rad[0])
        angles_rad[1] = _nearest(theta, angles_rad[1])
        angles_rad[2] = _nearest(psi, angles_rad[2])
    return True


@compiled
def _nearest(angle_rad, to_rad):
    """The angle, whole turns added, that is nearest to another."""
    turned = angle_rad - to_rad
    return to_rad + (turned - 2.0 * math.pi * round(turned * (0.5 / math.pi)))


@compiled
def _show(vehicles, i, position, angle, smooth_position, smooth_angles):
    """State of a vehicle from the estimates of its windows, each (2, 3): value and slope."""
    state = vehicles.states[i]
    for axis in range(3):
        state[axis] = position[0, axis] if smooth_position else vehicles.positions_m[i, axis]
        state[3 + axis] = position[1, axis]
        state[6 + axis] = wrap_one_angle(angle[0, axis] if smooth_angles else vehicles.angles_rad[i, axis])
        state[9 + axis] = angle[1, axis]


@compiled
def _find_landmarks(landmarks, landmark_rows, markers_m, limits, marker_visible):
    """Fills positions and rows of the landmarks that are seen in this frame; returns how many."""
    count = 0
    for i in range(len(landmarks.known)):
        landmark, rows = landmarks.known[i], landmark_rows[i]
        measured = markers_m[rows.first : rows.first + rows.count]
        seen = marker_visible[: landmark.markers]
        see_markers(measured, limits, seen)
        offsets, position_m = landmarks.offsets_m[i], landmarks.positions_m[count]
        if locate_landmark(landmark, offsets, measured, seen, limits.residual_max_m, position_m):
            landmarks.rows[count] = i
            count += 1
    return count
