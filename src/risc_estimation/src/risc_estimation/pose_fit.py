"""From markers to poses: every known body of a frame is fitted, and what is not believed is refused (thesis 4.2, 4.3).

The first stage of `state_estimator`. Nothing here is smoothed, and a frame knows nothing of the one before it, but for
the whole turns of the angles. The second stage is a filter, see risc_estimation/filters.
"""

import math
from collections import Counter
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from risc_estimation.landmark_positions import LANDMARK, locate_landmark
from risc_estimation.rigid_fit import MIN_MARKERS, POSE, WORK, fit_pose, fit_pose_without_worst
from risc_lab.compiled import compiled, record, with_row
from risc_lab.frames import euler_of_body_in_cortex
from risc_lab.lab import templates as kinds
from risc_lab.lab.arena import NET_HALF_X_M, NET_HALF_Y_M, NET_HEIGHT_M
from risc_lab.settings import NotNegative, Positive, Settings, between


@dataclass(frozen=True)
class PoseFitParams(Settings):
    """Which markers and poses are believed: parameters of states_estimation.py, too."""

    marker_limit_m: Positive = 100.0  # [m] larger coordinates mean a lost marker (9999.999 m in bags of the original)
    marker_noise_m: NotNegative = 0.002  # [m] 1 sigma of a marker, for the covariances; 0: from each fit's residual
    # a marker with the very same coordinates in so many frames in a row is lost: its picture stands still; 0 = off, for
    # exact simulators. Cameras measure a marker anew in each frame, however still it is
    frozen_frames: between(0, 1000) = 3
    # [m] worst rms distance of the markers from the fitted template; with four or more markers the worst one is left
    # out and the rest tried again
    residual_max_m: Positive = 0.015
    min_spread_m: Positive = 0.01  # [m] markers closer than this to one line give no attitude
    tilt_max_rad: Positive = 2.1  # [rad] 120 degrees: three markers of a square fit upside down when two are swapped
    # [m] a vehicle outside of this box is invisible: the net of the fleet file, unless these are set
    arena_x_m: Positive = NET_HALF_X_M  # half its length
    arena_y_m: Positive = NET_HALF_Y_M  # half its width
    arena_z_min_m: float = -0.1  # floor; a landed vehicle must stay visible
    arena_z_max_m: float = NET_HEIGHT_M
    arena_margin_m: float = 0.05  # [m] so far outside still counts as inside

    def within(self, arena):
        """The same settings for another Arena."""
        return replace(self, arena_x_m=arena.half_x_m, arena_y_m=arena.half_y_m, arena_z_max_m=arena.height_m)

    def limits(self):
        """(1,) LIMITS."""
        lower_m = np.array([-self.arena_x_m, -self.arena_y_m, self.arena_z_min_m]) - self.arena_margin_m
        upper_m = np.array([self.arena_x_m, self.arena_y_m, self.arena_z_max_m]) + self.arena_margin_m
        cos_tilt_max = math.cos(min(self.tilt_max_rad, math.pi))
        gates = (
            self.marker_limit_m,
            self.residual_max_m,
            self.min_spread_m,
            cos_tilt_max,
            self.frozen_frames or math.inf,
        )
        row = (*gates, lower_m, upper_m)
        return np.array([row], dtype=LIMITS)

    def __post_init__(self):
        super().__post_init__()
        if not self.arena_z_min_m < self.arena_z_max_m:
            raise ValueError(
                "arena_z_min_m must be below arena_z_max_m, got %r and %r" % (self.arena_z_min_m, self.arena_z_max_m)
            )


LIMITS = record(
    "marker_m residual_max_m min_spread_m cos_tilt_max frozen_frames",
    ("lower_m", float, (3,)),  # corners of the arena
    ("upper_m", float, (3,)),
)
# how often a gate has refused; the fields of `risc_estimation.state_estimator.EstimatorCounts`
_GATES = "markers_left_out", "markers_frozen", "misfits", "collinear", "tilted", "outside"
REFUSALS = record(*[(gate, int) for gate in _GATES])
BODY = record(
    ("markers", int),  # of its template
    ("has_attitude", bool),  # not of an attached body
    ("first", int),  # its markers in those of the frame
    ("count", int),
    ("stamp_s", float),  # of its newest pose
    ("residual_m", float),
    ("rotation", float, (3, 3)),
)
FIXED = record(("limits", LIMITS), ("refusals", REFUSALS), ("work", WORK), ("pose", POSE))  # what all bodies share


class _Bodies(NamedTuple):
    """What is known of the vehicles and of what is attached to them, one row each. `Poses` explains most of it."""

    table: np.ndarray  # (bodies,) BODY
    templates_m: np.ndarray  # (bodies, most markers, 3)
    newest: np.ndarray  # (bodies, most markers, 4): its coordinates in the newest frame [m], in how many before it, too
    used: np.ndarray  # (bodies, most markers) bool: the markers that the newest fit rests on
    flags: np.ndarray  # (2, bodies) bool: present, inside
    measured: np.ndarray  # (2, bodies, 3): positions [m], angles [rad]


class _Landmarks(NamedTuple):
    """What is known of the landmarks."""

    table: np.ndarray  # (landmarks,) LANDMARK
    offsets_m: np.ndarray  # (landmarks, most markers, 3)
    positions_m: np.ndarray  # (landmarks, 3) of those seen in the newest frame, which come first
    rows: np.ndarray  # (landmarks,) which ones these are


class Poses:
    """Raw poses of the newest frame, a row a body. Cortex frame, SI units. Valid until the next frame: copy what stays.

    A body whose markers were not believed is not present; it keeps the numbers, and the stamp, of its last pose that
    was. Bodies join at the end, when they are first seen. `flags` (2, n) is `present` and `inside`, `measured` (2, n,
    3) `position_m` and `angles_rad`: for compiled code, where every array that is passed costs time.
    """

    def __init__(self, bodies, marker_noise_m):
        self.stamp_s = -math.inf  # of the newest frame: time of exposure [s]
        self.names = ()
        self._marker_noise_m = marker_noise_m
        self.take(bodies)

    def take(self, bodies):
        """Have these arrays, which are filled again with every frame."""
        self._bodies, self.flags, self.measured = bodies, bodies.flags, bodies.measured
        self.present, self.inside = bodies.flags  # (n,) bool: the newest frame gave a pose; and it is inside the arena
        # (n, 3) of the template's origin [m]; (n, 3) roll pitch yaw [rad] without jumps of whole turns, 0 of what is
        # attached
        self.position_m, self.angles_rad = bodies.measured
        self._covariances_ = np.empty((len(bodies.table), 6, 6))

    @property
    def stamps_s(self):
        """(n,) stamp of each body's pose [s]; that of the frame where it is present, -inf before the first."""
        return self._bodies.table["stamp_s"]

    @property
    def rotation(self):
        """(n, 3, 3) template axes (for vehicles: body axes) to cortex axes."""
        return self._bodies.table["rotation"]

    @property
    def marker_counts(self):
        """[(used, of its template)] of each body: on how many of its markers its newest pose rests."""
        return list(zip(self._bodies.used.sum(axis=1).tolist(), self._bodies.table["markers"].tolist()))

    @property
    def residual_m(self):
        """(n,) rms distance of the used markers from the fitted template [m]."""
        return self._bodies.table["residual_m"]

    def covariances(self):
        """(n, 6, 6) covariance of position [m] and of a small rotation about cortex x, y, z [rad], in this order.

        NaN where a body is not present; nothing is computed before it is asked for. Errors p of the position and theta
        of the rotation move marker i by  p + theta x R t_i,  so their covariance is, to first order,

            noise^2 (sum_i J_i^T J_i)^-1,   J_i = (I, -[R t_i]x),

        noise: of each coordinate of a marker, white: `marker_noise_m`, or, where that is 0, from the fit's residual.
        """
        bodies, here = self._bodies, self.present
        _covariances(bodies.table, bodies.templates_m, bodies.used, here, self._marker_noise_m, self._covariances_)
        return self._covariances_.copy()


class PoseFit:
    """Frames of named marker sets in, `Poses` and landmarks out. Not thread-safe."""

    def __init__(self, templates, params=None, on_body=lambda template: None):
        """templates: dict name -> risc_lab.lab.templates.Template.   on_body: told of every body that gets a row.

        Raises ValueError if a template of another kind than landmark has fewer than three markers.
        """
        params = params or PoseFitParams()
        self.names, self.landmark_names = (), ()
        self.unknown = Counter()  # frames by name that no template knows
        self._templates, self._on_body = dict(templates), on_body
        for template in self._templates.values():
            if template.kind != kinds.LANDMARK and len(template.markers_m) < MIN_MARKERS:
                raise ValueError(
                    "template '%s' has %d markers; a body of kind %s needs at least %d"
                    % (template.name, len(template.markers_m), template.kind, MIN_MARKERS)
                )
        most = max([len(template.markers_m) for template in self._templates.values()], default=0)
        self._fixed, self._marker_visible = np.zeros(1, dtype=FIXED), np.zeros(most, dtype=bool)
        self._fixed["limits"] = params.limits()
        self._bodies = _Bodies(
            table=np.zeros(0, dtype=BODY),
            templates_m=np.zeros((0, most, 3)),
            newest=np.zeros((0, most, 4)),
            used=np.zeros((0, most), dtype=bool),
            flags=np.zeros((2, 0), dtype=bool),
            measured=np.zeros((2, 0, 3)),
        )
        self._landmarks = _Landmarks(
            table=np.zeros(0, dtype=LANDMARK),
            offsets_m=np.zeros((0, most, 3)),
            positions_m=np.zeros((0, 3)),
            rows=np.zeros(0, dtype=int),
        )
        self.poses = Poses(self._bodies, params.marker_noise_m)
        self._layout = None
        self.update(-math.inf, (), np.zeros((0, 3)))  # without bodies: loads the compiled code

    @property
    def refusals(self):
        """{gate: how often it has refused}, up to now."""
        return dict(zip(REFUSALS.names, self._fixed["refusals"][0].tolist()))

    def body_names(self):
        """Names of the templates of all bodies that may get a row."""
        return sorted(name for name, template in self._templates.items() if template.kind != kinds.LANDMARK)

    def admit(self, name):
        """A row for a body, if it has none yet and a template knows it."""
        template = self._templates.get(name)
        if template is None or name in self.names or name in self.landmark_names:
            return
        self._layout = None  # its plan has no row for it
        count = len(template.markers_m)
        if template.kind == kinds.LANDMARK:
            self.landmark_names += (name,)
            self._landmarks = landmarks = _with_row(self._landmarks)
            landmarks.table["markers"][-1] = count
            landmarks.offsets_m[-1, :count] = template.markers_m
        else:
            self.names += (name,)
            self._bodies = bodies = _with_row(self._bodies)
            table = bodies.table[-1:]
            table["markers"], table["has_attitude"], table["stamp_s"] = count, template.kind == kinds.VEHICLE, -math.inf
            bodies.templates_m[-1, :count] = template.markers_m
            self.poses.names = self.names
            self.poses.take(self._bodies)
            self._on_body(template)

    def update(self, stamp_s, layout, markers_m):
        """Fit one frame: brings `poses` up to date. Returns (names of the landmarks seen, (landmarks, 3) [m]).

        stamp_s: time of exposure [s].   layout: ((name, number of markers), ...), a tuple.   markers_m: (markers, 3) of
        all bodies in that order [m], cortex frame, each body's in its template's order. A lost marker is NaN, infinite
        or beyond marker_limit_m; markers beyond the template's are ignored, missing ones at the end count as lost. Of
        two bodies of one name the first counts.
        Raises ValueError when layout and markers_m do not match.
        """
        if layout != self._layout:
            self._plan_for(layout)
        shape = markers_m.shape if isinstance(markers_m, np.ndarray) else np.shape(markers_m)
        if shape != self._markers_m.shape:
            raise ValueError("the layout has %d markers, the array is %r" % (len(self._markers_m), shape))
        self._markers_m[:] = markers_m
        for name in self._unknown_here:
            self.unknown[name] += 1
        self.poses.stamp_s = stamp_s = float(stamp_s)
        seen = _fit_frame(stamp_s, *self._arguments)
        names = self.landmark_names
        if seen < len(names):
            names = tuple([names[row] for row in self._landmarks.rows[:seen]])
        return names, self._landmarks.positions_m[:seen].copy()

    def _plan_for(self, layout):
        """Find every body's markers in those of the frame; bodies seen for the first time are admitted."""
        places, first = {}, 0
        for name, count in layout:
            places.setdefault(name, (first, count))
            first += count
        for name in places:
            self.admit(name)
        for names, table in (self.names, self._bodies.table), (self.landmark_names, self._landmarks.table):
            for row, name in enumerate(names):
                table["first"][row], table["count"][row] = places.get(name, (0, 0))
        self._layout, self._markers_m = layout, np.zeros((first, 3))
        self._unknown_here = [name for name in places if name not in self._templates]
        self._arguments = self._markers_m, self._fixed, self._marker_visible, *self._bodies, *self._landmarks


def _with_row(table):
    """A NamedTuple of arrays with one more row; that is their first axis, but for flags and measured."""
    return table._make([with_row(a, 1 if name in ("flags", "measured") else 0) for name, a in table._asdict().items()])


# --- compiled: all bodies of a frame in one call


# The arrays come one by one, since a tuple of them takes three times as long to pass.
@compiled
def _fit_frame(
    stamp_s, markers_m, fixed, marker_visible,
    table, templates_m, newest, used, flags, measured,
    l_table, l_offsets_m, l_positions_m, l_rows,
):  # fmt: skip
    """One frame: updates all tables. Returns how many landmarks are seen.

    stamp_s [s]; markers_m (markers, 3) [m]; fixed: (1,) FIXED; marker_visible: (most markers,) bool.  After them: the
    fields of _Bodies and of _Landmarks.
    """
    bodies = _Bodies(table, templates_m, newest, used, flags, measured)
    limits, refusals = fixed[0].limits, fixed[0].refusals
    for i in range(len(table)):
        flags[0, i] = flags[1, i] = _locate(bodies, i, stamp_s, markers_m, fixed[0])
        for axis in range(3):
            if flags[1, i] and not limits.lower_m[axis] <= measured[0, i, axis] <= limits.upper_m[axis]:
                refusals.outside += 1
                flags[1, i] = False
    landmarks = _Landmarks(l_table, l_offsets_m, l_positions_m, l_rows)
    return _find_landmarks(landmarks, markers_m, limits, marker_visible)


@compiled
def see_markers(markers, limits, visible):
    """Fills visible (n,): which of the first n markers (k, 3) [m] are there and not lost. Returns how many."""
    count = 0
    for i in range(len(visible)):
        visible[i] = (
            i < len(markers)
            and abs(markers[i, 0]) < limits.marker_m
            and abs(markers[i, 1]) < limits.marker_m
            and abs(markers[i, 2]) < limits.marker_m
        )
        if visible[i]:
            count += 1
    return count


@compiled
def _leave_frozen(newest, markers, limits, used):
    """Take those out of used (n,) bool that stand still; returns how many. newest: (>= n, 4) of _Bodies."""
    count = 0
    for i in range(min(len(used), len(markers))):
        same = True
        for axis in range(3):
            same = same and newest[i, axis] == markers[i, axis]
            newest[i, axis] = markers[i, axis]
        newest[i, 3] = newest[i, 3] + 1.0 if same else 0.0
        if used[i] and newest[i, 3] + 1.0 >= limits.frozen_frames:
            used[i] = False
            count += 1
    return count


@compiled
def _locate(bodies, i, stamp_s, markers_m, fixed):
    """Pose of a body from the markers of this frame; returns whether it is believed."""
    limits, refusals, work, pose = fixed.limits, fixed.refusals, fixed.work, fixed.pose
    body, template = bodies.table[i], bodies.templates_m[i]
    markers, used = markers_m[body.first : body.first + body.count], bodies.used[i, : body.markers]
    count = see_markers(markers, limits, used)
    frozen = _leave_frozen(bodies.newest[i], markers, limits, used)
    count, refusals.markers_frozen = count - frozen, refusals.markers_frozen + frozen
    if count < MIN_MARKERS:
        return False
    fit_pose(template, markers, used, work, pose)
    if not pose.residual_m <= limits.residual_max_m:
        if count > MIN_MARKERS:
            fit_pose_without_worst(template, markers, used, work, pose)
        if not pose.residual_m <= limits.residual_max_m:
            refusals.misfits += 1
            return False
        refusals.markers_left_out += 1
    if not pose.spread_m >= limits.min_spread_m:
        refusals.collinear += 1
        return False
    if body.has_attitude and not -pose.rotation[2, 2] >= limits.cos_tilt_max:
        refusals.tilted += 1
        return False
    body.stamp_s, body.residual_m = stamp_s, pose.residual_m
    body.rotation[:, :] = pose.rotation
    bodies.measured[0, i] = pose.position_m
    if body.has_attitude:
        phi, theta, psi = euler_of_body_in_cortex(pose.rotation)
        angles_rad = bodies.measured[1, i]
        for axis in range(3):  # whole turns are added to be nearest to the last
            turned = (phi, theta, psi)[axis] - angles_rad[axis]
            angles_rad[axis] += turned - 2.0 * math.pi * round(turned * (0.5 / math.pi))
    return True


@compiled
def _covariances(table, templates_m, used, present, noise_m, out):
    """Fill out (bodies, 6, 6), see `Poses.covariances`: by template axes, in which R is 1, turned then."""
    A, turned = np.empty((6, 12)), np.empty((6, 6))
    for i in range(len(table)):
        out[i] = np.nan
        if not present[i]:
            continue
        A[:, :], count = 0.0, 0
        for k in range(table[i].markers):
            if used[i, k]:
                count += 1
                x, y, z = templates_m[i, k]
                A[0, 4] += z
                A[0, 5] -= y
                A[1, 5] += x
                A[3, 3] += y * y + z * z
                A[4, 4] += x * x + z * z
                A[5, 5] += x * x + y * y
                A[3, 4] -= x * y
                A[3, 5] -= x * z
                A[4, 5] -= y * z
        A[1, 3], A[2, 3], A[2, 4] = -A[0, 4], -A[0, 5], -A[1, 5]
        for j in range(3):
            A[j, j] = count
        variance_m2 = noise_m * noise_m
        if noise_m == 0.0:
            variance_m2 = table[i].residual_m ** 2 * count / (3.0 * count - 6.0)
        for j in range(6):
            A[j, 6 + j] = variance_m2
            for k in range(j):
                A[j, k] = A[k, j]
        _solve(A)
        R = table[i].rotation
        for block in range(4):
            j, k = 3 * (block // 2), 3 * (block % 2)
            for row in range(3):
                for column in range(3):
                    total = 0.0
                    for m in range(3):
                        for n in range(3):
                            total += R[row, m] * A[j + m, 6 + k + n] * R[column, n]
                    turned[j + row, k + column] = total
        for j in range(6):
            for k in range(6):
                out[i, j, k] = 0.5 * (turned[j, k] + turned[k, j])


@compiled
def _solve(A):
    """Gauss and Jordan's elimination: A (n, m) = (S | B) becomes (1 | S^-1 B). S: symmetric, positive definite."""
    n, m = A.shape
    for i in range(n):
        pivot = A[i, i]
        for k in range(i, m):
            A[i, k] /= pivot
        for j in range(n):
            if j != i and A[j, i] != 0.0:
                factor = A[j, i]
                for k in range(i, m):
                    A[j, k] -= factor * A[i, k]


@compiled
def _find_landmarks(landmarks, markers_m, limits, marker_visible):
    """Fills positions and rows of the landmarks that are seen in this frame; returns how many."""
    count = 0
    for i in range(len(landmarks.table)):
        landmark = landmarks.table[i]
        measured = markers_m[landmark.first : landmark.first + landmark.count]
        seen = marker_visible[: landmark.markers]
        see_markers(measured, limits, seen)
        offsets, position_m = landmarks.offsets_m[i], landmarks.positions_m[count]
        if locate_landmark(landmark, offsets, measured, seen, limits.residual_max_m, position_m):
            landmarks.rows[count] = i
            count += 1
    return count
