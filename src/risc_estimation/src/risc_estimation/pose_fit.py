"""From markers to poses: every known body of a frame is fitted, and implausible poses are refused (thesis 4.2, 4.3).

The first stage of `state_estimator`; the second is a filter, see risc_estimation/filters. Poses are not smoothed. Kept
from earlier frames: the tracks of recently seen bodies (`identity`), whose markers a body uses if names were exchanged,
and the whole turns of its angles. `body_fit` chooses the markers that a pose is fitted to.

When bodies contradict their tracks, each is compared with the markers of the others, all bodies of a frame at once, and
gets the markers that fit its predicted pose. It keeps them while it is seen, whatever name they have. A body that has
not been seen for memory_s gets the markers of its own name back, as soon as no recently seen body uses them.
"""

import math
from collections import Counter
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import pdist
from scipy.special import chdtri

from risc_estimation.body_fit import (
    COLLINEAR,
    FIT,
    JUMP,
    MISFIT,
    NONE,
    TILTED,
    UNSEEN,
    apart_m,
    find_markers,
    fit_markers,
    fit_some_markers,
    is_steady,
)
from risc_estimation.identity import PATH, contradict, foresee, go_on, is_known, marker_noise_m
from risc_estimation.landmark_positions import LANDMARK, locate_landmark
from risc_estimation.rigid_fit import MIN_MARKERS
from risc_lab.compiled import compiled, record, with_row
from risc_lab.frames import euler_of_body_in_cortex
from risc_lab.lab import templates as kinds
from risc_lab.lab.arena import NET_HALF_X_M, NET_HALF_Y_M, NET_HEIGHT_M
from risc_lab.settings import NotNegative, Positive, Settings, between

_CLEAR = 0.5  # markers are given to a body only if their distance is below this fraction of that of any alternative


@dataclass(frozen=True)
class PoseFitParams(Settings):
    """Which markers and poses are accepted; also parameters of states_estimation.py."""

    marker_limit_m: Positive = 100.0  # [m] larger coordinates mean a lost marker (9999.999 m in bags of the original)
    marker_noise_m: NotNegative = 0.002  # [m] 1 sigma of a marker coordinate; 0: estimated from each fit's residual
    # [m] 1 sigma of a marker coordinate in the template, from calipers or from a minute of motion capture
    template_tolerance_m: NotNegative = 0.001
    # probability that a good pose is refused, for its residual or its place, if both sigmas are true; 0: only
    # residual_max_m counts
    false_reject_probability: between(0.0, 0.1) = 1e-5
    # a marker with identical coordinates in this many frames in a row counts as lost: its data are frozen. 0 = off, for
    # simulators without noise; measured by cameras, even a marker at rest changes from frame to frame
    frozen_frames: between(0, 1000) = 3
    residual_max_m: Positive = 0.015  # [m] worst rms distance of the markers from the fitted template, in any case
    min_spread_m: Positive = 0.01  # [m] markers closer than this to one line give no attitude
    tilt_max_rad: Positive = 2.1  # [rad] 120 degrees: three markers of a square fit upside down when two are swapped
    # [s] a body seen within this time must be where it can have moved to; a pose elsewhere is refused for as long. 0:
    # each frame is judged on its own
    memory_s: NotNegative = 0.3
    # limits of a body's motion; they also hold for the tip of a pendulum, and for an IRIS+ thrown about by hand
    acceleration_max_m_s2: Positive = 20.0
    speed_max_m_s: Positive = 5.0  # greatest error of a predicted velocity, e.g. of a body that has just been seen
    angular_acceleration_max_rad_s2: Positive = 200.0  # attitude loop of 15 rad/s, stepped by 50 degrees
    turn_rate_max_rad_s: Positive = 8.0
    # [m] a vehicle outside of this box is invisible: the net of the fleet file, unless these are set
    arena_x_m: Positive = NET_HALF_X_M  # half its length
    arena_y_m: Positive = NET_HALF_Y_M  # half its width
    arena_z_min_m: float = -0.1  # floor; a landed vehicle must stay visible
    arena_z_max_m: float = NET_HEIGHT_M
    arena_margin_m: float = 0.05  # [m] up to this far outside still counts as inside

    def within(self, arena):
        """The same settings for another Arena."""
        return replace(self, arena_x_m=arena.half_x_m, arena_y_m=arena.half_y_m, arena_z_max_m=arena.height_m)

    def fixed(self):
        """(1,) FIXED with these settings."""
        fixed, on = np.zeros(1, dtype=FIXED), self.false_reject_probability > 0.0
        gates, limits, reach = fixed["gates"], fixed["fit"]["limits"], fixed["fit"]["reach"]
        gates["marker_m"], gates["frozen_frames"] = self.marker_limit_m, self.frozen_frames or math.inf
        gates["lower_m"] = -self.arena_x_m, -self.arena_y_m, self.arena_z_min_m
        gates["upper_m"] = self.arena_x_m, self.arena_y_m, self.arena_z_max_m
        gates["lower_m"] -= self.arena_margin_m
        gates["upper_m"] += self.arena_margin_m
        limits["residual_max_m"], limits["min_spread_m"] = self.residual_max_m, self.min_spread_m
        limits["cos_tilt_max"] = math.cos(min(self.tilt_max_rad, math.pi))
        limits["left_out_most"] = 2 if on else 1  # two of five leave three, which nearly anything fits without a gate
        reach["noise_m"] = self._sigma_m
        reach["gate"] = math.sqrt(chdtri(3, self.false_reject_probability)) if on else math.inf
        reach["memory_s"] = self.memory_s or -1.0  # never
        reach["acceleration_m_s2"], reach["speed_m_s"] = self.acceleration_max_m_s2, self.speed_max_m_s
        reach["angular_rad_s2"] = self.angular_acceleration_max_rad_s2
        reach["turn_rad_s"] = self.turn_rate_max_rad_s
        return fixed

    @property
    def _sigma_m(self):
        """Standard deviation of a marker coordinate from its place on the fitted template [m]."""
        return math.hypot(self.marker_noise_m or 0.2 * self.residual_max_m, self.template_tolerance_m)

    def residuals_m(self, most):
        """(most + 1,) largest accepted rms distance from the fitted template [m], by number of markers."""
        largest_m = np.full(most + 1, self.residual_max_m)
        if self.false_reject_probability > 0.0 and self.marker_noise_m > 0.0:
            count = np.arange(MIN_MARKERS, most + 1)
            squares = chdtri(3 * count - 6, self.false_reject_probability) / count
            largest_m[count] = np.minimum(self.residual_max_m, self._sigma_m * np.sqrt(squares))
        return largest_m

    def __post_init__(self):
        super().__post_init__()
        if not self.arena_z_min_m < self.arena_z_max_m:
            raise ValueError(
                "arena_z_min_m must be below arena_z_max_m, got %r and %r" % (self.arena_z_min_m, self.arena_z_max_m)
            )


GATES = record(
    "marker_m frozen_frames",
    ("lower_m", float, (3,)),  # corners of the arena
    ("upper_m", float, (3,)),
    ("shows_jumps", bool),  # poses that contradict the track still count as present: the filter has a gate of its own
)
# how often a gate refused or a fault was repaired; fields of `risc_estimation.state_estimator.EstimatorCounts`
_COUNTED = "markers_left_out", "markers_frozen", "misfits", "collinear", "tilted", "jumps", "outside"
_MENDED = "swaps_mended", "filled_in", "exchanges"
REFUSALS = record(*[(name, int) for name in _COUNTED + _MENDED])
BODY = record(
    ("markers", int),  # of its template
    ("has_attitude", bool),  # not of an attached body
    "apart_m",  # least distance between two markers of its template
    ("first", int),  # index in the frame of the first marker of its name; count: their number
    ("count", int),
    ("place", int),  # row of the body whose name its markers have: its own, unless names are exchanged
    ("moved", bool),  # it has just been given the markers of another name
    ("known", bool),  # it was seen within memory_s before the newest frame
    ("elsewhere", bool),  # its pose in the newest frame is accepted although it contradicts those before
    ("doubt", int),  # about its pose in the newest frame
    "stamp_s residual_m",  # of its newest pose
    ("rotation", float, (3, 3)),
)
FIXED = record(("gates", GATES), ("refusals", REFUSALS), ("fit", FIT))  # what all bodies share


class _Bodies(NamedTuple):
    """Data of the vehicles and attached bodies, one row each. `Poses` explains most of the fields."""

    table: np.ndarray  # (bodies,) BODY
    templates_m: np.ndarray  # (bodies, most markers, 3)
    # (bodies, most markers, 4): last coordinates of a marker [m], and in how many frames before they were the same
    newest: np.ndarray
    used: np.ndarray  # (bodies, most markers) bool: the markers used in the newest fit
    flags: np.ndarray  # (3, bodies) bool: present, inside, elsewhere
    measured: np.ndarray  # (2, bodies, 3): positions [m], angles [rad]
    paths: np.ndarray  # (bodies, 3) PATH: `identity` explains them


class _Landmarks(NamedTuple):
    """Data of the landmarks."""

    table: np.ndarray  # (landmarks,) LANDMARK
    offsets_m: np.ndarray  # (landmarks, most markers, 3)
    positions_m: np.ndarray  # (landmarks, 3) of those seen in the newest frame, which come first
    rows: np.ndarray  # (landmarks,) their rows in table


class _Scratch(NamedTuple):
    """Work arrays, overwritten for each body or frame, except residuals_m. n: largest number of markers."""

    seen: np.ndarray  # (n,) bool
    tried: np.ndarray  # (n,) bool
    found: np.ndarray  # (n,) int, see `find_markers`
    found_m: np.ndarray  # (n, 3)
    residuals_m: np.ndarray  # (n + 1,), see `PoseFitParams`
    # (bodies, bodies): distance of body i, fitted to the markers of body j, from its prediction; inf: no fit
    costs_m: np.ndarray


NOTHING = np.zeros((0, 3))


class Poses:
    """Raw poses of the newest frame, a row per body. Cortex frame, SI units. The next frame overwrites it: copy it.

    A body whose pose was refused is not present; it keeps the numbers and the stamp of its last accepted pose. (For a
    filter with a gate of its own, a body that has jumped is present.) New bodies are appended when first seen.
    `flags` (3, n) holds `present`, `inside` and `elsewhere`, `measured` (2, n, 3) `position_m` and `angles_rad`: for
    compiled code, where every array that is passed costs time.
    """

    def __init__(self, bodies, marker_noise_m):
        self.stamp_s = -math.inf  # of the newest frame: time of exposure [s]
        self.names = ()
        self._marker_noise_m = marker_noise_m
        self.take(bodies)

    def take(self, bodies):
        """Use these arrays, which every frame overwrites."""
        self._bodies, self.flags, self.measured = bodies, bodies.flags, bodies.measured
        # (n,) bool: the newest frame gave a pose; it is in the arena; it is accepted although it contradicts the track
        self.present, self.inside, self.elsewhere = bodies.flags
        # (n, 3) position of the template's origin [m]; (n, 3) roll, pitch, yaw [rad], unwrapped, 0 for attached bodies
        self.position_m, self.angles_rad = bodies.measured
        self._covariances_ = np.empty((len(bodies.table), 6, 6))

    @property
    def stamps_s(self):
        """(n,) stamp of each body's pose [s]; the frame's stamp where it is present, -inf before the first pose."""
        return self._bodies.table["stamp_s"]

    @property
    def rotation(self):
        """(n, 3, 3) template axes (for vehicles: body axes) to cortex axes."""
        return self._bodies.table["rotation"]

    @property
    def marker_counts(self):
        """[(used, in its template)] for each body: number of markers in the newest fit."""
        return list(zip(self._bodies.used.sum(axis=1).tolist(), self._bodies.table["markers"].tolist()))

    @property
    def residual_m(self):
        """(n,) rms distance of the used markers from the fitted template [m]."""
        return self._bodies.table["residual_m"]

    def covariances(self):
        """(n, 6, 6) covariance of position [m] and of a small rotation about cortex x, y, z [rad], in this order.

        NaN where a body is not present; computed on demand. Errors p of the position and theta of the rotation move
        marker i by  p + theta x R t_i,  so their covariance is, to first order,

            noise^2 (sum_i J_i^T J_i)^-1,   J_i = (I, -[R t_i]x),

        noise: standard deviation of each marker coordinate, white: `marker_noise_m`, or from the residual if that is 0.
        """
        bodies, here = self._bodies, self.present
        _covariances(bodies.table, bodies.templates_m, bodies.used, here, self._marker_noise_m, self._covariances_)
        return self._covariances_.copy()


class PoseFit:
    """Frames of named marker sets in, `Poses` and landmarks out. Not thread-safe."""

    def __init__(self, templates, params=None, on_body=lambda template: None, shows_jumps=False):
        """templates: dict name -> risc_lab.lab.templates.Template.   on_body: called for every body that gets a
        row.   shows_jumps: poses that contradict the track are counted, but still present.

        Raises ValueError if a template of another kind than landmark has fewer than three markers.
        """
        params = params or PoseFitParams()
        self.names, self.landmark_names = (), ()
        self.unknown = Counter()  # {name without a template: frames}
        self.exchanged = Counter()  # {(body, name that its markers had): how often}
        self._templates, self._on_body = dict(templates), on_body
        for template in self._templates.values():
            if template.kind != kinds.LANDMARK and len(template.markers_m) < MIN_MARKERS:
                raise ValueError(
                    "template '%s' has %d markers; a body of kind %s needs at least %d"
                    % (template.name, len(template.markers_m), template.kind, MIN_MARKERS)
                )
        most = max([len(template.markers_m) for template in self._templates.values()], default=0)
        self._fixed = params.fixed()
        self._fixed["gates"]["shows_jumps"] = shows_jumps
        self._bodies = _Bodies(
            table=np.zeros(0, dtype=BODY),
            templates_m=np.zeros((0, most, 3)),
            newest=np.zeros((0, most, 4)),
            used=np.zeros((0, most), dtype=bool),
            flags=np.zeros((3, 0), dtype=bool),
            measured=np.zeros((2, 0, 3)),
            paths=np.zeros((0, 3), dtype=PATH),
        )
        self._scratch = _Scratch(
            seen=np.zeros(most, dtype=bool),
            tried=np.zeros(most, dtype=bool),
            found=np.zeros(most, dtype=int),
            found_m=np.zeros((most, 3)),
            residuals_m=params.residuals_m(most),
            costs_m=np.zeros((0, 0)),
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
        """{gate: how often it has refused} so far."""
        return dict(zip(REFUSALS.names, self._fixed["refusals"][0].tolist()))

    @property
    def misses_a_body(self):
        """True if a body that was seen recently has no pose in the newest frame."""
        table = self._bodies.table
        return bool((table["known"] & (table["doubt"] != NONE)).any())

    def body_names(self):
        """Names of the templates of all bodies that may get a row."""
        return sorted(name for name, template in self._templates.items() if template.kind != kinds.LANDMARK)

    def admit(self, name):
        """Add a row for a body that has a template and no row yet."""
        template = self._templates.get(name)
        if template is None or name in self.names or name in self.landmark_names:
            return
        self._layout = None  # the plan has no row for this body
        count = len(template.markers_m)
        if template.kind == kinds.LANDMARK:
            self.landmark_names += (name,)
            self._landmarks = landmarks = _with_row(self._landmarks)
            landmarks.table["markers"][-1] = count
            landmarks.offsets_m[-1, :count] = template.markers_m
        else:
            row, self.names = len(self.names), (*self.names, name)
            self._bodies = bodies = _with_row(self._bodies)
            self._scratch = self._scratch._replace(costs_m=np.full((row + 1, row + 1), math.inf))
            table = bodies.table[-1:]
            table["markers"], table["has_attitude"], table["stamp_s"] = count, template.kind == kinds.VEHICLE, -math.inf
            table["place"], table["apart_m"] = row, pdist(template.markers_m).min()
            bodies.templates_m[-1, :count] = template.markers_m
            self.poses.names = self.names
            self.poses.take(self._bodies)
            self._on_body(template)

    def forget(self):
        """Forget all tracks: their stamps mean nothing on the clock of the next frame."""
        self._bodies.paths["lives"] = False
        self._bodies.table["place"] = np.arange(len(self.names))

    def update(self, stamp_s, layout, markers_m, loose_m=NOTHING):
        """Fit one frame: brings `poses` up to date. Returns (names of the landmarks seen, (landmarks, 3) [m]).

        stamp_s: time of exposure [s].   layout: ((name, number of markers), ...), a tuple.   markers_m: (markers, 3) of
        all bodies in that order [m], cortex frame, each body's in its template's order. A lost marker is NaN, infinite
        or beyond marker_limit_m; markers beyond the template's are ignored, missing ones at the end count as lost. Of
        two bodies of one name the first counts.   loose_m: (u, 3) markers without a label [m].
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
        if loose_m is not NOTHING:
            loose_m = np.array(loose_m, dtype=float).reshape(-1, 3)
        seen = _fit_frame(stamp_s, False, loose_m, *self._arguments)
        if seen < 0:
            self._exchange()
            seen = _fit_frame(stamp_s, True, loose_m, *self._arguments)
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
        self._arguments = self._markers_m, self._fixed, *self._scratch, *self._bodies, *self._landmarks

    def _exchange(self):
        """Reassign the markers of this frame to the bodies that they fit, where the assignment is clear."""
        table, costs_m = self._bodies.table, self._scratch.costs_m
        fits = np.isfinite(costs_m)
        rows, columns = np.flatnonzero(fits.any(axis=1)), np.flatnonzero(fits.any(axis=0))
        among_m = costs_m[np.ix_(rows, columns)]
        taken = {}  # body: the one whose markers it gets
        for row, column in zip(*linear_sum_assignment(np.where(np.isfinite(among_m), among_m, 1e9))):
            others_m = np.concatenate([np.delete(among_m[row], column), np.delete(among_m[:, column], row)])
            if among_m[row, column] < _CLEAR * others_m.min(initial=math.inf):
                taken[int(rows[row])] = int(columns[column])
        self._leave_one_sided(taken)
        places = table["place"].tolist()
        given = {mine: places[other] for mine, other in taken.items()}
        left = {places[mine] for mine in taken} - set(given.values())
        for other in set(taken.values()) - set(taken):
            given[other] = other if other in left else min(left)
            left.remove(given[other])
        for mine, place in given.items():
            table["place"][mine], table["moved"][mine] = place, True
            if not table["known"][mine]:  # its track was that of another body
                self._bodies.paths["lives"][mine] = False
        new = [(self.names[mine], self.names[given[mine]]) for mine in taken if given[mine] != mine]
        self.exchanged.update(new)
        self._fixed["refusals"]["exchanges"] += bool(new)

    def _leave_one_sided(self, taken):
        """Remove from taken, {body: the one whose markers it gets}, what is no exchange: a known body would lose its
        markers to one whose own markers are seen but fit no body. Such a fit is chance: all markers seen are false.
        """
        table = self._bodies.table
        while True:
            own = set(taken) - set(taken.values())
            wrong = [mine for mine in own if table["doubt"][mine] != UNSEEN and table["known"][taken[mine]]]
            if not wrong:
                return
            for mine in wrong:
                del taken[mine]


def _with_row(table):
    """A NamedTuple of arrays with one more row: axis 0, except in flags and measured (axis 1)."""
    return table._make([with_row(a, 1 if name in ("flags", "measured") else 0) for name, a in table._asdict().items()])


# --- compiled: all bodies of a frame in one call


# The arrays are passed one by one, since a tuple of them takes three times as long to pass.
@compiled
def _fit_frame(
    stamp_s, again, loose_m, markers_m, fixed,
    seen, tried, found, found_m, residuals_m, costs_m,
    table, templates_m, newest, used, flags, measured, paths,
    l_table, l_offsets_m, l_positions_m, l_rows,
):  # fmt: skip
    """One frame: updates all tables. Returns how many landmarks are seen; -1: names are exchanged, costs_m is filled.

    stamp_s [s]; again: second call for this frame, after markers were reassigned; loose_m: (u, 3) [m]; markers_m:
    (markers, 3) [m]; fixed: (1,) FIXED.  After them: the fields of _Scratch, of _Bodies and of _Landmarks.
    """
    scratch = _Scratch(seen, tried, found, found_m, residuals_m, costs_m)
    bodies = _Bodies(table, templates_m, newest, used, flags, measured, paths)
    gates, refusals = fixed[0].gates, fixed[0].refusals
    doubtful = False
    for i in range(len(table)):
        body = table[i]
        if not again:
            body.moved = False
            if body.place != i:
                _take_back(bodies, i, stamp_s, fixed[0].fit.reach)
        if body.moved or not again:
            markers, template, mine = _named(table[body.place], markers_m), templates_m[i], used[i, : body.markers]
            old, place, path = newest[i], measured[:, i], paths[i]
            body.doubt = _locate(body, template, markers, old, mine, place, path, residuals_m, stamp_s, fixed[0])
            if body.doubt != NONE:
                body.doubt = _recover(
                    body, template, markers, loose_m, old, mine, place, path, scratch, stamp_s, fixed[0]
                )
        doubtful = doubtful or body.doubt != NONE and body.known
    if doubtful and not again and _compare(bodies, stamp_s, markers_m, fixed[0], scratch):
        return -1
    for i in range(len(table)):
        doubt = table[i].doubt
        flags[0, i] = flags[1, i] = doubt == NONE or doubt == JUMP and gates.shows_jumps
        flags[2, i] = table[i].elsewhere
        for axis in range(3):
            if flags[1, i] and not gates.lower_m[axis] <= measured[0, i, axis] <= gates.upper_m[axis]:
                refusals.outside += 1
                flags[1, i] = False
        if doubt != NONE:
            refusals.misfits += doubt == MISFIT
            refusals.collinear += doubt == COLLINEAR
            refusals.tilted += doubt == TILTED
            refusals.jumps += doubt == JUMP
    landmarks = _Landmarks(l_table, l_offsets_m, l_positions_m, l_rows)
    return _find_landmarks(landmarks, markers_m, gates, fixed[0].fit.limits, seen)


@compiled
def see_markers(markers, gates, visible):
    """Fills visible (n,): which of the first n markers (k, 3) [m] are there and not lost. Returns how many."""
    count = 0
    for i in range(len(visible)):
        visible[i] = (
            i < len(markers)
            and abs(markers[i, 0]) < gates.marker_m
            and abs(markers[i, 1]) < gates.marker_m
            and abs(markers[i, 2]) < gates.marker_m
        )
        if visible[i]:
            count += 1
    return count


@compiled
def _leave_frozen(newest, markers, gates, used):
    """Remove frozen markers from used (n,) bool; returns how many. newest: (>= n, 4) of _Bodies."""
    count = 0
    for i in range(len(used)):
        if used[i] and _is_frozen(newest[i], markers[i], gates):
            used[i] = False
            count += 1
    return count


@compiled
def _is_frozen(newest, marker, gates):
    """Record the place (3,) [m] of a marker, labelled or not. True if it is frozen. newest: (4,) of _Bodies."""
    same = True
    for axis in range(3):
        same = same and newest[axis] == marker[axis]
        newest[axis] = marker[axis]
    newest[3] = newest[3] + 1.0 if same else 0.0
    return _stands_still(newest, gates)


@compiled
def _stands_still(newest, gates):
    return newest[3] + 1.0 >= gates.frozen_frames


# Arrays are reference-counted: passing all of them on for each body would take as long as its fit.
@compiled
def _locate(body, template, markers, newest, used, measured, paths, residuals_m, stamp_s, fixed):
    """Fit a body to all of its markers (k, 3); returns a doubt about it. Fills used; without a doubt the rest, too.

    body: BODY. After it: its rows of `_Bodies`; of measured the rows of all quantities.
    """
    fit = fixed.fit
    count = see_markers(markers, fixed.gates, used)
    frozen = _leave_frozen(newest, markers, fixed.gates, used)
    count, fixed.refusals.markers_frozen = count - frozen, fixed.refusals.markers_frozen + frozen
    body.known, body.elsewhere = is_known(paths, stamp_s, fit.reach), False
    if body.known:
        foresee(paths, stamp_s, fit.reach, fit.ahead, fit.near, fit.aside)
    if count < MIN_MARKERS:
        return UNSEEN
    doubt = fit_markers(template, markers, used, residuals_m, body.has_attitude, body.known, fit)
    if doubt == NONE:
        _believe(body, paths, measured, stamp_s, count, fit)
    return doubt


@compiled
def _recover(body, template, markers, loose_m, newest, used, measured, paths, scratch, stamp_s, fixed):
    """As `_locate`, for a body where that had a doubt: fit it to other markers, or to some of its own."""
    refusals, fit, residuals_m, count = fixed.refusals, fixed.fit, scratch.residuals_m, _count(used)
    if body.known:
        seen, found, found_m = scratch.seen[: body.markers], scratch.found, scratch.found_m
        seen[:] = used
        some, labelled = 0, min(len(markers), len(seen))
        find_markers(template, body.apart_m, markers, seen, loose_m, fixed.gates.marker_m, fit, found_m, used, found)
        for k in range(len(used)):
            if used[k] and found[k] >= labelled and _is_frozen(newest[k], found_m[k], fixed.gates):
                used[k] = False
                refusals.markers_frozen += 1
            some += used[k]
        if (
            some >= MIN_MARKERS
            and fit_some_markers(template, found_m, used, residuals_m, body.has_attitude, True, fit) == NONE
        ):
            own, swapped, filled = _own_of(found, used, labelled)
            if own == count or is_steady(fit.pose, body.has_attitude, fit.reach):
                refusals.markers_left_out += count - own
                refusals.swaps_mended += swapped
                refusals.filled_in += filled
                _believe(body, paths, measured, stamp_s, _count(used), fit)
                return NONE
        used[:] = seen
        if count > MIN_MARKERS:
            if fit_some_markers(template, markers, used, residuals_m, body.has_attitude, True, fit) == NONE:
                refusals.markers_left_out += count - _count(used)
                _believe(body, paths, measured, stamp_s, _count(used), fit)
                return NONE
            used[:] = seen
    if count < MIN_MARKERS:
        return UNSEEN
    doubt = fit_some_markers(template, markers, used, residuals_m, body.has_attitude, False, fit)
    if doubt != NONE:
        return doubt
    left = _count(used)
    if not body.known:
        _believe(body, paths, measured, stamp_s, left, fit)
    elif contradict(paths, stamp_s, fit.pose, left, body.has_attitude, fit.reach, fit.ahead):
        _keep(body, measured, stamp_s, fit.pose)
        body.elsewhere = True
    else:
        doubt = JUMP
        if fixed.gates.shows_jumps:
            _keep(body, measured, stamp_s, fit.pose)
    refusals.markers_left_out += count - left
    return doubt


@compiled
def _named(body, markers_m):
    """The markers of a frame that have the name of a body (BODY)."""
    return markers_m[body.first : body.first + body.count]


@compiled
def _count(used):
    count = 0
    for k in range(len(used)):
        if used[k]:
            count += 1
    return count


@compiled
def _own_of(found, used, labelled):
    """Of the used markers that `find_markers` has found: how many had a label; 1 if any label was wrong; 1 if any had
    none.
    """
    own, swapped, filled = 0, 0, 0
    for k in range(len(used)):
        if used[k]:
            if found[k] < labelled:
                own += 1
                if found[k] != k:
                    swapped = 1
            else:
                filled = 1
    return own, swapped, filled


@compiled
def _believe(body, paths, measured, stamp_s, count, fit):
    """Accept a pose, fitted to count markers, that does not contradict the track."""
    go_on(paths, stamp_s, fit.pose, count, body.has_attitude, fit.reach, fit.ahead)
    _keep(body, measured, stamp_s, fit.pose)


@compiled
def _keep(body, measured, stamp_s, pose):
    """Fill the rows of a body, in table and measured (2, 3), with a POSE."""
    body.stamp_s, body.residual_m = stamp_s, pose.residual_m
    body.rotation[:, :] = pose.rotation
    measured[0] = pose.position_m
    if body.has_attitude:
        phi, theta, psi = euler_of_body_in_cortex(pose.rotation)
        for axis in range(3):  # whole turns are added, so that it is nearest to the last one
            turned = (phi, theta, psi)[axis] - measured[1, axis]
            measured[1, axis] += turned - 2.0 * math.pi * round(turned * (0.5 / math.pi))


@compiled
def _take_back(bodies, i, stamp_s, reach):
    """Give a body that is not known the markers of its own name back, unless a known body uses them."""
    if is_known(bodies.paths[i], stamp_s, reach):
        return
    for j in range(len(bodies.table)):
        if bodies.table[j].place == i and not is_known(bodies.paths[j], stamp_s, reach):
            bodies.table[j].place, bodies.table[i].place = bodies.table[i].place, i
            return


@compiled
def _compare(bodies, stamp_s, markers_m, fixed, scratch):
    """Fill costs_m for each known body in doubt, with the markers of others that are in doubt or were not known.

    True if any fit.
    """
    fit, some = fixed.fit, False
    for i in range(len(bodies.table)):
        body, template = bodies.table[i], bodies.templates_m[i]
        scratch.costs_m[i, :] = math.inf
        if body.doubt == NONE or not body.known:
            continue
        foresee(bodies.paths[i], stamp_s, fit.reach, fit.ahead, fit.near, fit.aside)
        near_m, ahead = _extent_m(template, body.markers), fit.ahead
        near_m += ahead.off_m + 2.0 * marker_noise_m(ahead, fit.reach)
        tried, seen = scratch.tried[: body.markers], scratch.seen[: body.markers]
        for j in range(len(bodies.table)):
            if j == i or bodies.table[j].doubt == NONE and bodies.table[j].known:
                continue
            markers = _named(bodies.table[bodies.table[j].place], markers_m)
            see_markers(markers, fixed.gates, seen)
            for k in range(min(len(seen), bodies.table[j].markers)):
                if _stands_still(bodies.newest[j][k], fixed.gates):  # frozen: no measurement of this frame
                    seen[k] = False
            # a possible pose has its markers this near; fitting all pairs of a large fleet would take too long
            if _count_near(markers, seen, ahead.position_m, near_m) < MIN_MARKERS:
                continue
            tried[:] = seen
            doubt = fit_some_markers(template, markers, tried, scratch.residuals_m, body.has_attitude, True, fit)
            if doubt == NONE:
                scratch.costs_m[i, j], some = apart_m(template, body.markers, fit.pose, fit.ahead), True
    return some


@compiled
def _extent_m(template, count):
    """Distance of the farthest of the first count markers from the origin of a template [m]."""
    square = 0.0
    for k in range(count):
        square = max(square, template[k, 0] ** 2 + template[k, 1] ** 2 + template[k, 2] ** 2)
    return math.sqrt(square)


@compiled
def _count_near(markers, seen, place_m, near_m):
    """Number of seen markers within near_m of a place (3,) [m]."""
    count = 0
    for k in range(len(seen)):
        if seen[k]:
            square = 0.0
            for axis in range(3):
                square += (markers[k, axis] - place_m[axis]) ** 2
            if square <= near_m * near_m:
                count += 1
    return count


@compiled
def _covariances(table, templates_m, used, present, noise_m, out):
    """Fill out (bodies, 6, 6), see `Poses.covariances`: computed in template axes, where R is 1, then rotated."""
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
    """Gauss-Jordan elimination: A (n, m) = (S | B) becomes (1 | S^-1 B). S: symmetric, positive definite."""
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
def _find_landmarks(landmarks, markers_m, gates, limits, marker_visible):
    """Fills positions and rows of the landmarks that are seen in this frame; returns how many."""
    count = 0
    for i in range(len(landmarks.table)):
        landmark = landmarks.table[i]
        measured = markers_m[landmark.first : landmark.first + landmark.count]
        seen = marker_visible[: landmark.markers]
        see_markers(measured, gates, seen)
        offsets, position_m = landmarks.offsets_m[i], landmarks.positions_m[count]
        if locate_landmark(landmark, offsets, measured, seen, limits.residual_max_m, position_m):
            landmarks.rows[count] = i
            count += 1
    return count
