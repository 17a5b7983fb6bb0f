"""From markers to the twelve states of every vehicle and the positions of the landmarks (thesis 4.2, 4.3).

Bodies are keyed by name; their order in a frame means nothing. Time comes from the frames' stamps.
"""

import math
from collections import Counter
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple, Tuple

import numpy as np

from risc_control.frames import cortex_to_ned, euler_from_body_to_ned, wrap_angle
from risc_control.lab.arena import NET_HALF_X_M, NET_HALF_Y_M, NET_HEIGHT_M
from risc_estimation.landmarks import LandmarkTracker
from risc_estimation.least_squares import SlidingFit
from risc_estimation.rigid_fit import MIN_MARKERS, TemplateStack, fit_rigid, fit_without_worst

LEGACY_WINDOW_S = 0.25  # the original release: a line through 50 samples at 200 Hz


class S(IntEnum):
    """Columns of a state: position [m], velocity [m/s], roll pitch yaw [rad], their rates [rad/s]."""

    X, Y, Z, U, V, W, PHI, THETA, PSI, P, Q, R = range(12)


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
    backward_reset_s: float = 1.0  # [s] stamps that fall back further than this restart everything
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

    def __post_init__(self):
        for name in (
            "position_window_s",
            "angle_window_s",
            "max_gap_s",
            "backward_reset_s",
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
    names: Tuple[str, ...]  # every known vehicle, seen or not
    visible: np.ndarray  # (vehicles,) bool
    states: np.ndarray  # (vehicles, 12), columns `S`; the last known where not visible, first 0
    landmark_names: Tuple[str, ...]  # the landmarks seen in this frame
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
    backward_stamps: int = 0  # frames refused: older than the one before, or not a number
    clock_resets: int = 0  # stamps fell back by more than backward_reset_s: started afresh
    markers_left_out: int = 0  # one marker did not fit and the body was estimated without it
    misfits: int = 0  # body refused: residual too large
    collinear: int = 0  # body refused: visible markers on one line
    tilted: int = 0  # body refused: upside down
    outside: int = 0  # body invisible: outside the arena
    unknown: Counter = field(default_factory=Counter)  # frames by name that no template knows


class _Slot(NamedTuple):
    """Where the markers of one body go: rows of the vehicles' or the landmarks' frame buffer."""

    buffer: np.ndarray  # (markers, 3) view of the buffer, as many as the template has
    markers: int


class StatesEstimator(object):
    """Frames of named marker sets in, `FrameEstimate` out. Not thread-safe.

    A vehicle is visible when enough of its markers fit its template, it is inside the arena and its windows hold
    enough samples for a velocity: `min_samples` that span `min_span_s` (the tenth frame at 200 Hz after a restart;
    a line then has 44 mm/s of noise for 2 mm positions). Dropouts up to `max_gap_s` do not restart the windows: the
    fit runs on real stamps, so the vehicle is visible again with its first good frame.
    """

    def __init__(self, templates, params=None, vehicles=()):
        """templates: dict name -> risc_control.lab.templates.Template.   vehicles: names listed from the start on.

        Raises ValueError if a listed vehicle has no template of kind vehicle or pendulum_tip, or if such a template
        has fewer than three markers.
        """
        self.params = params = params or EstimatorParams()
        self.counts = EstimatorCounts()
        self._templates = dict(templates)
        orders, windows_s = (
            (params.position_order, params.angle_order),
            (params.position_window_s, params.angle_window_s),
        )
        self._smooth = (params.smooth_position, params.smooth_angles)
        if params.legacy_window:
            orders, windows_s, self._smooth = (1, 1), (LEGACY_WINDOW_S, LEGACY_WINDOW_S), (False, False)
        self._position_fit, self._angle_fit = [
            SlidingFit(window_s, order, 3, params.max_gap_s, params.max_rate_hz)
            for window_s, order in zip(windows_s, orders)
        ]
        margin_m = params.arena_margin_m
        self._lower_m = np.array([-params.arena_x_m, -params.arena_y_m, params.arena_z_min_m]) - margin_m
        self._upper_m = np.array([params.arena_x_m, params.arena_y_m, params.arena_z_max_m]) + margin_m
        self._cos_tilt_max = math.cos(min(params.tilt_max_rad, math.pi))

        self._last_stamp_s = None
        self._names = ()
        self._is_tip = np.zeros(0, dtype=bool)
        self._stack = TemplateStack([])
        self._blank = self._frame = np.zeros((0, MIN_MARKERS, 3))
        self._states = np.zeros((0, len(S)))
        self._unwrapped = np.zeros((0, 3))
        self._landmarks = LandmarkTracker(params.residual_max_m)
        self._landmark_blank = self._landmark_frame = np.zeros((0, 0, 3))
        self._slots = {}
        for template in self._templates.values():
            if template.kind != "landmark" and len(template.markers_m) < MIN_MARKERS:
                raise ValueError(
                    "template '%s' has %d markers; a body of kind %s needs at least %d"
                    % (template.name, len(template.markers_m), template.kind, MIN_MARKERS)
                )
        for name in vehicles:
            template = self._templates.get(name)
            if template is None or template.kind == "landmark":
                raise ValueError(
                    "vehicle '%s' needs a template of kind vehicle; there are %s. Add it to the templates "
                    "file or correct the name" % (name, ", ".join(sorted(self._vehicle_names())))
                )
            if name not in self._names:
                self._add_vehicle(template)

    @property
    def names(self):
        """Names of all known vehicles: the listed ones, then the others in the order they were first seen."""
        return self._names

    def update(self, stamp_s, bodies):
        """Estimate one frame.

        stamp_s: time of exposure [s].   bodies: dict name -> (k, 3) markers [m], cortex frame, in the template's
        order. A lost marker is NaN, infinite or beyond marker_limit_m; markers beyond the template's are ignored,
        missing ones at the end count as lost.
        Returns FrameEstimate, or None when the stamp does not advance (counted).
        """
        if not self._accept_stamp(stamp_s):
            return None
        self.counts.frames += 1
        np.copyto(self._frame, self._blank)
        np.copyto(self._landmark_frame, self._landmark_blank)
        for name, markers in bodies.items():
            slot = self._slots.get(name) or self._admit(name)
            if slot is not None:
                if len(markers) == slot.markers:
                    slot.buffer[:] = markers
                elif len(markers):
                    slot.buffer[: len(markers)] = markers[: slot.markers]
        visible = self._update_vehicles(stamp_s)
        landmark_names, landmarks_m = self._update_landmarks()
        return FrameEstimate(stamp_s, self._names, visible, self._states.copy(), landmark_names, landmarks_m)

    def lost(self):
        """FrameEstimate for "no frames arrive any more": the last numbers, nothing visible. None before any."""
        if self._last_stamp_s is None:
            return None
        return FrameEstimate(
            self._last_stamp_s,
            self._names,
            np.zeros(len(self._names), dtype=bool),
            self._states.copy(),
            (),
            np.zeros((0, 3)),
        )

    def _accept_stamp(self, stamp_s):
        if not math.isfinite(stamp_s):
            self.counts.backward_stamps += 1
            return False
        last_s = self._last_stamp_s
        if last_s is not None and stamp_s <= last_s:
            if stamp_s == last_s:
                self.counts.duplicate_stamps += 1
                return False
            if last_s - stamp_s <= self.params.backward_reset_s:
                self.counts.backward_stamps += 1
                return False
            self.counts.clock_resets += 1  # a bag was started again, or the clock was set
            self._position_fit.reset()
            self._angle_fit.reset()
        self._last_stamp_s = stamp_s
        return True

    def _vehicle_names(self):
        return [name for name, template in self._templates.items() if template.kind != "landmark"]

    def _admit(self, name):
        """Slot of a body seen for the first time; None, counted, if no template knows it."""
        template = self._templates.get(name)
        if template is None:
            self.counts.unknown[name] += 1
            return None
        if template.kind == "landmark":
            self._add_landmark(template)
        else:
            self._add_vehicle(template)
        return self._slots[name]

    def _add_vehicle(self, template):
        self._names += (template.name,)
        self._is_tip = np.append(self._is_tip, template.kind == "pendulum_tip")
        self._stack = TemplateStack([self._templates[name].markers_m for name in self._names])
        self._states = np.vstack([self._states, np.zeros(len(S))])
        self._unwrapped = np.vstack([self._unwrapped, np.zeros(3)])
        self._position_fit.add_body()
        self._angle_fit.add_body()
        self._blank, self._frame = self._new_frame(self._frame, self._stack.defined, self._names)

    def _add_landmark(self, template):
        self._landmarks.add(template.name, template.markers_m)
        self._landmark_blank, self._landmark_frame = self._new_frame(
            self._landmark_frame, self._landmarks.defined, self._landmarks.names
        )

    def _new_frame(self, old, defined, names):
        """Frame buffer for so many bodies, keeping what `old` already holds, and its blank: NaN = not seen."""
        blank = np.zeros(defined.shape + (3,))
        blank[defined] = np.nan
        frame = blank.copy()
        frame[: old.shape[0], : old.shape[1]] = old
        for row, name in enumerate(names):
            count = len(self._templates[name].markers_m)
            self._slots[name] = _Slot(frame[row, :count], count)
        return blank, frame

    def _update_vehicles(self, stamp_s):
        """Fit, gate, differentiate; returns visible (vehicles,) and refreshes self._states where visible."""
        count = len(self._names)
        visible = np.zeros(count, dtype=bool)
        if count == 0:
            return visible
        rows, positions, rotations = self._fit_poses()
        if rows is None:  # the usual case: every known vehicle has a pose
            rows, present = slice(None), None
        else:
            present = np.zeros(count, dtype=bool)
            present[rows] = True
        everyone = present is None
        fitted = None if everyone else rows

        angles = np.stack(euler_from_body_to_ned(rotations), axis=-1)
        angles[self._is_tip[rows]] = 0.0  # three degrees of freedom: a rod's tip has no attitude of interest
        turned = angles - self._unwrapped[rows]
        turned -= (2.0 * np.pi) * np.rint(turned * (0.5 / np.pi))
        self._unwrapped[rows] += turned
        if everyone:
            self._position_fit.push(stamp_s, positions)
        else:
            padded = np.zeros((count, 3))
            padded[rows] = positions
            self._position_fit.push(stamp_s, padded, present)
        self._angle_fit.push(stamp_s, self._unwrapped, present)
        if not everyone and rows.size == 0:
            return visible

        value, velocity, samples, spans_s = self._position_fit.estimate(fitted)
        angle, rate, samples_angle, spans_angle_s = self._angle_fit.estimate(fitted)
        inside = ((positions >= self._lower_m) & (positions <= self._upper_m)).all(axis=1)
        if not inside.all():
            self.counts.outside += int((~inside).sum())
        shown = (
            inside
            & (np.minimum(samples, samples_angle) >= self.params.min_samples)
            & (np.minimum(spans_s, spans_angle_s) >= self.params.min_span_s)
        )
        smooth_position, smooth_angles = self._smooth
        fresh = np.concatenate(
            [
                value if smooth_position else positions,
                velocity,
                wrap_angle(angle if smooth_angles else self._unwrapped[rows]),
                rate,
            ],
            axis=1,
        )
        visible[rows] = shown
        if shown.all():
            self._states[rows] = fresh
        else:
            self._states[visible] = fresh[shown]
        return visible

    def _fit_poses(self):
        """Poses of the bodies in the frame buffer that pass the gates.

        Returns rows (None = all), positions (rows, 3) [m] cortex frame, rotations body -> NED (rows, 3, 3).
        """
        params = self.params
        frame = self._frame
        rows = seen = None
        finite = np.abs(frame) < params.marker_limit_m
        if not finite.all():
            seen = finite.all(axis=2) & self._stack.defined
            frame = np.where(seen[:, :, None], frame, 0.0)
            rows = np.flatnonzero(seen.sum(axis=1) >= MIN_MARKERS)
            fit = fit_rigid(self._stack, frame[rows], seen[rows], rows)
        else:
            fit = fit_rigid(self._stack, frame)
        rotations, positions = fit.rotations, fit.positions
        good = fit.residuals_m <= params.residual_max_m
        if not good.all():
            self._retry_misfits(fit, good, frame, self._stack.defined if seen is None else seen, rows)
        rotations = cortex_to_ned(rotations.swapaxes(1, 2)).swapaxes(1, 2)
        broad = fit.spreads_m >= params.min_spread_m
        upright = rotations[:, 2, 2] >= self._cos_tilt_max
        if not (broad & upright).all():
            upright |= self._is_tip if rows is None else self._is_tip[rows]
            self.counts.collinear += int((good & ~broad).sum())
            self.counts.tilted += int((good & broad & ~upright).sum())
            good &= broad & upright
        if good.all():
            return rows, positions, rotations
        rows = np.flatnonzero(good) if rows is None else rows[good]
        return rows, positions[good], rotations[good]

    def _retry_misfits(self, fit, good, frame, seen, rows):
        """Refit, without their worst marker, the bodies that do not fit; `fit` and `good` are updated in place."""
        for index in np.flatnonzero(~good):
            row = index if rows is None else rows[index]
            if seen[row].sum() > MIN_MARKERS:
                retry, _ = fit_without_worst(self._stack, row, frame[row], seen[row])
                if retry.residuals_m[0] <= self.params.residual_max_m:
                    for whole, part in zip(fit, retry):
                        whole[index] = part[0]
                    good[index] = True
                    self.counts.markers_left_out += 1
                    continue
            self.counts.misfits += 1

    def _update_landmarks(self):
        """Names and positions (landmarks, 3) [m] of the landmarks seen in this frame."""
        if not self._landmarks.names:
            return (), np.zeros((0, 3))
        frame = self._landmark_frame
        seen = self._landmarks.defined
        finite = np.abs(frame) < self.params.marker_limit_m
        if not finite.all():
            seen = finite.all(axis=2) & seen
            frame = np.where(seen[:, :, None], frame, 0.0)
        positions, visible = self._landmarks.update(frame, seen)
        if visible.all():
            return tuple(self._landmarks.names), positions
        names = tuple(name for name, shown in zip(self._landmarks.names, visible) if shown)
        return names, positions[visible]
