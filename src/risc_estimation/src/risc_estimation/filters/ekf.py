"""Extended Kalman filter on the raw poses, with vehicle models and the commands that were sent (thesis 7.6 to 7.8).

Every frame is an event for each body: the filter predicts to its stamp, and takes a pose if it is plausible. Position
and attitude are refused each for itself, when the innovation exceeds what a good pose exceeds with gate_probability. A
late pose is inserted at its own time, and what came after it is filtered again.

A sudden unmodelled force (a load, wind) makes innovations grow to one side over several poses, where a false pose makes
one large at once. When the mean innovation of position is too large, the uncertainty of a push of `push_m_s2` is added
to the state before the next pose is judged.

A body has a track, which is visible, and up to two others. The candidate starts with a pose that the track refuses:
when poses have agreed with it, and not with the track, for `readmit_s`, it becomes the track. The former track is the
one that was replaced. It becomes the track again with the first pose that agrees with it, and is forgotten after
`remember_s`: false poses may last longer than `readmit_s`, and after them a vehicle is where it was predicted to be.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from risc_estimation.ekf import MODEL, TRACK, WORK, acceleration, copy_track, correct, innovate, predict, push
from risc_estimation.filters import COMMAND, COUNTS, Innovations, Status, VelocityFilter
from risc_lab.command_history import CommandHistory, append_command
from risc_lab.compiled import compiled, record, with_row
from risc_lab.frames import GRAVITY_M_S2, wrap_one_angle
from risc_lab.lab import templates as kinds
from risc_lab.settings import NotNegative, Positive, Settings, between
from risc_lab.states import S

_SLOTS = 192  # events kept per body: late_s at twice the usual frame rate, on-board measurements included
_TIME, POSE, _VELOCITY, _ATTITUDE = range(4)  # kinds of events
# by kind: the state that each entry of a measurement measures
MEASURES = np.array([[0] * 6, [0, 1, 2, 6, 7, 8], [3, 4, 0, 0, 0, 0], [6, 7, 0, 0, 0, 0]])
_UNKNOWN_M_S, _UNKNOWN_RAD_S, _UNKNOWN_M_S2 = 2.0, 2.0, 0.5  # 1 sigma where nothing was measured yet
_CANDIDATE, _FORMER = 0, 1  # the other tracks
_SMOOTHS = 0.2  # weight of the newest innovation in their mean
_TOO_LARGE = 30.0 * _SMOOTHS / (2.0 - _SMOOTHS)  # square of that mean above which a push is assumed
_PUSHED_S = 0.05  # assumed duration of the push so far
_LOST_M2 = 1.0  # variance of the position above which a track is given up
_GONE_S = 0.1  # a body that had no pose for longer is REACQUIRED for as long


@dataclass(frozen=True)
class Params(Settings):
    """Settings; config/filters/ekf.yaml explains and holds them."""

    gate_probability: between(0.0, 0.1)
    acceleration: Positive
    climb_acceleration: Positive
    tilt_command: Positive
    yaw_rate_command: Positive
    disturbance: NotNegative
    disturbance_time_s: Positive
    free_acceleration: Positive
    free_angular: Positive
    push_m_s2: NotNegative
    velocity_noise_m_s: Positive
    attitude_noise_rad: Positive
    settled_m_s: Positive
    coast_s: Positive
    coast_m: Positive
    readmit_s: Positive
    remember_s: Positive
    late_s: between(0.0, 0.5)


SETTINGS = record("gate push_m_s2 settled_m2_s2 coast_s coast_m2 readmit_s remember_s")
BODY = record(("count", int), ("newest", int), ("status", int), "taken_s again_s")
SLOT = record(("track", TRACK), ("kind", int), ("z", float, (6,)), ("R", float, (6, 6)), ("taken", int, (2,)))
OTHER = record(("track", TRACK), ("lives", bool), "since_s taken_s")


class Filter(VelocityFilter):
    """See the module. Rows of arrays are bodies."""

    PARAMS = Params
    COASTS = True
    GATES = True
    ON_BOARD = (COMMAND, "velocity", "attitude")

    def __init__(self, params):
        super().__init__(params)
        self.late_s = params.late_s
        # a probability of 0 switches the gate off
        gate = chdtri(3, params.gate_probability) if params.gate_probability > 0.0 else math.inf
        settings = gate, params.push_m_s2, params.settled_m_s**2, params.coast_s, params.coast_m**2
        self._settings = np.array([(*settings, params.readmit_s, params.remember_s)], SETTINGS)
        self._work, self._counts = np.zeros(1, WORK), np.zeros(0, COUNTS)
        self._models, self._bodies = np.zeros(0, MODEL), np.zeros(0, BODY)
        self._slots, self._others = np.zeros((0, _SLOTS), SLOT), np.zeros((0, 2), OTHER)
        self._sent = CommandHistory(0).vehicles
        self._last = []  # {kind: newest reading} of each body, to ignore repeated ones
        self._collect()
        # without and with a body: loads the compiled code
        self.coast(0.0)
        tables = (np.zeros(1, MODEL), np.zeros(1, BODY), np.zeros((1, _SLOTS), SLOT), np.zeros((1, 2), OTHER))
        tables += CommandHistory(1).vehicles, self._work, np.zeros(1, COUNTS)
        _on_board(0.0, 0, _VELOCITY, np.zeros(2), 1.0, self._settings, *tables)
        self.accelerations()

    def add_body(self, template, vehicle_type=None):
        super().add_body(template)
        self._models, self._bodies, self._others = map(with_row, (self._models, self._bodies, self._others))
        self._slots, self._counts = map(with_row, (self._slots, self._counts))
        self._sent = np.concatenate([self._sent, CommandHistory(1).vehicles])
        self._last.append({})
        self._models[-1] = model_of(self.params, template, vehicle_type)
        self._bodies["taken_s"][-1] = -math.inf
        self._collect()

    def _collect(self):
        self._arguments = (
            self._settings, self._models, self._bodies, self._slots, self._others, self._sent, self._work, self._counts,
        )  # fmt: skip

    def reset(self):
        self._bodies["count"] = 0
        self._bodies["taken_s"] = -math.inf
        self._others["lives"] = False
        for row in range(len(self._sent)):
            self._sent[row : row + 1] = CommandHistory(1).vehicles

    def update(self, poses):
        _update(
            poses.stamp_s, poses.flags, poses.measured, poses.covariances(), self.visible, self.states, *self._arguments
        )

    def coast(self, stamp_s):
        n = len(self.visible)
        nothing = np.zeros((2, n), dtype=bool), np.zeros((2, n, 3)), np.zeros((n, 6, 6))
        _update(stamp_s, *nothing, self.visible, self.states, *self._arguments)
        return bool(self.visible.any())

    def on_board(self, row, stamp_s, what, values):
        if what == COMMAND:
            append_command(self._sent[row], stamp_s, values)
            return
        reading = values.tolist()
        if reading == self._last[row].get(what) or not self._models["follows"][row]:
            return  # repeated: not a new measurement
        self._last[row][what] = reading
        kind, noise = {
            "velocity": (_VELOCITY, self.params.velocity_noise_m_s),
            "attitude": (_ATTITUDE, self.params.attitude_noise_rad),
        }[what]
        _on_board(stamp_s, row, kind, np.array(reading[:2]), noise * noise, *self._arguments)

    def status(self, poses):
        return [Status(status) for status in self._bodies["status"].tolist()]

    def covariances(self):
        newest = zip(self._slots["track"]["P"], (self._bodies["newest"] % _SLOTS).tolist())
        return np.array([P[k, : len(S), : len(S)] for P, k in newest]).reshape(-1, len(S), len(S))

    def counters(self):
        return self._counts.copy()

    def accelerations(self):
        found = np.full((len(self.visible), 3), np.nan)
        _accelerations(self._models, self._bodies, self._slots, self._sent, self._work, found)
        return found

    def innovations(self, poses):
        n = len(self.visible)
        squares, taken = np.full((n, 3), np.nan), np.zeros((n, 2), dtype=bool)
        bodies = self._models, self._bodies, self._slots, self._sent
        _innovations(poses.stamp_s, squares, taken, *bodies, np.zeros(1, TRACK), self._work)
        return Innovations(squares, taken)


def model_of(params, template, vehicle_type):
    """MODEL of a body, as a record."""
    model = np.zeros(1, MODEL)[0]
    for name in "acceleration", "climb_acceleration", "disturbance", "free_acceleration", "free_angular":
        model[name] = getattr(params, name)
    model["disturbance_1_s"] = 1.0 / params.disturbance_time_s
    if vehicle_type is None or template.kind != kinds.VEHICLE:
        return model
    model["follows"] = True
    for name, loop in ("roll", vehicle_type.roll), ("pitch", vehicle_type.pitch):
        wn = loop.natural_frequency_rad_s
        model[name + "_1_s2"], model[name + "_1_s"] = wn * wn, 2.0 * loop.damping_ratio * wn
    model["roll_noise"], model["pitch_noise"] = (
        params.tilt_command * model[name] for name in ("roll_1_s2", "pitch_1_s2")
    )
    model["yaw_noise"] = params.yaw_rate_command / vehicle_type.yaw_rate_time_constant_s
    model["yaw_1_s"] = 1.0 / vehicle_type.yaw_rate_time_constant_s
    model["drag_1_s"] = vehicle_type.drag_n_s_m / vehicle_type.mass_kg
    if vehicle_type.takes_thrust:
        model["climb_gain"], model["climb_1_s"] = GRAVITY_M_S2, model["drag_1_s"]
    else:
        model["climb_gain"] = model["climb_1_s"] = 1.0 / vehicle_type.climb_time_constant_s
    model["delay_s"] = vehicle_type.command_delay_s + 0.5 / vehicle_type.command_rate_hz
    return model


@compiled
def _update(
    stamp_s, flags, measured, covariances, visible, states,
    settings, models, bodies, slots, others, sent, work, counts,
):  # fmt: skip
    """One frame: fills visible and states."""
    z, R = np.empty(6), np.empty((6, 6))
    for i in range(len(bodies)):
        body = bodies[i]
        _covariance_of_angles(covariances[i], measured[1, i], R)
        present, inside = flags[0, i], flags[1, i]
        for k in range(3):
            z[k], z[3 + k] = measured[0, i, k], measured[1, i, k]
        kind = POSE if present else _TIME
        _take(stamp_s, kind, z, R, settings[0], models[i], body, slots[i], others[i], sent[i], work[0], counts[i])
        visible[i] = False
        if body.count == 0:
            body.status = Status.LOST
            continue
        track = slots[i, body.newest % _SLOTS].track
        unseen_s, variance_m2 = track.stamp_s - body.taken_s, max(track.P[0, 0], track.P[1, 1], track.P[2, 2])
        if variance_m2 > _LOST_M2:
            body.count = 0  # the next pose starts a new track
        if unseen_s > settings[0].coast_s or variance_m2 > settings[0].coast_m2:
            body.status = Status.LOST
        elif unseen_s <= 0.0 and not inside:
            body.status = Status.OUTSIDE
        elif max(track.P[3, 3], track.P[4, 4], track.P[5, 5]) > settings[0].settled_m2_s2:
            body.status = Status.SETTLING
        else:
            visible[i] = True
            if unseen_s > 0.0:
                body.status = Status.SUSPECT if present else Status.PREDICTED
            else:
                body.status = Status.TRACKED if stamp_s - body.again_s > _GONE_S else Status.REACQUIRED
            for k in range(12):
                states[i, k] = wrap_one_angle(track.x[k]) if 6 <= k < 9 else track.x[k]


@compiled
def _accelerations(models, bodies, slots, sent, work, found):
    """Fill found (bodies, 3)."""
    for i in range(len(bodies)):
        if bodies[i].count > 0:
            acceleration(slots[i, bodies[i].newest % _SLOTS].track, models[i], sent[i], work[0], found[i])


@compiled
def _covariance_of_angles(covariance, angles_rad, R):
    """Fill R (6, 6), covariance of position and phi, theta, psi, from that of position and a small rotation.

    A rotation about cortex x, y, z, as in covariance, is one about north, west and up.
    """
    sin_psi, cos_psi = math.sin(angles_rad[2]), math.cos(angles_rad[2])
    tan_theta, T = math.tan(angles_rad[1]), np.zeros((3, 3))
    T[0, 0], T[0, 1] = cos_psi / math.cos(angles_rad[1]), -sin_psi / math.cos(angles_rad[1])
    T[1, 0], T[1, 1] = -sin_psi, -cos_psi
    T[2, 0], T[2, 1], T[2, 2] = tan_theta * cos_psi, -tan_theta * sin_psi, -1.0
    for i in range(3):
        for j in range(3):
            R[i, j] = covariance[i, j]
            across = turned = 0.0
            for k in range(3):
                across += covariance[i, 3 + k] * T[j, k]
                for m in range(3):
                    turned += T[i, k] * covariance[3 + k, 3 + m] * T[j, m]
            R[i, 3 + j] = R[3 + j, i] = across
            R[3 + i, 3 + j] = turned


@compiled
def _on_board(stamp_s, row, kind, values, variance, settings, models, bodies, slots, others, sent, work, counts):
    """Take an on-board measurement of a body."""
    z, R = np.zeros(6), np.zeros((6, 6))
    z[0], z[1], R[0, 0], R[1, 1] = values[0], values[1], variance, variance
    _take(
        stamp_s,
        kind,
        z,
        R,
        settings[0],
        models[row],
        bodies[row],
        slots[row],
        others[row],
        sent[row],
        work[0],
        counts[row],
    )


@compiled
def _take(stamp_s, kind, z, R, settings, model, body, slots, others, sent, work, counts):
    """Take an event of a body: a pose, an on-board measurement, or a frame without a pose."""
    if body.count == 0:
        if kind == POSE:
            counts.resets += counts.poses > 0  # there was another track before
            counts.poses += 1
            body.count, body.newest, body.taken_s, body.again_s = 1, 0, stamp_s, stamp_s
            _begin(slots[0].track, stamp_s, z, R)
            others[_CANDIDATE].lives = others[_FORMER].lives = False
        return
    n = len(slots)
    newest_s = slots[body.newest % n].track.stamp_s
    place = body.newest + 1  # running number of the event
    if stamp_s < newest_s:
        counts.late += 1
        oldest = body.newest - body.count + 1
        while place - 1 >= oldest and slots[(place - 1) % n].track.stamp_s > stamp_s:
            place -= 1
        if place == oldest:
            return  # older than all events that are kept
    for k in range(body.newest, place - 1, -1):
        slots[(k + 1) % n] = slots[k % n]
    slot = slots[place % n]
    slot.kind = kind
    slot.z[:], slot.R[:, :] = z, R
    stamps_s = stamp_s
    for k in range(place, body.newest + 2):
        before, slot = slots[(k - 1) % n], slots[k % n]
        if k > place:
            stamps_s = slot.track.stamp_s
        copy_track(slot.track, before.track)
        predict(slot.track, stamps_s, model, sent, work)
        _measure(slot, settings, work)
    is_newest = place == body.newest + 1
    body.newest += 1
    body.count = min(body.count + 1, n - 1)
    slot = slots[place % n]
    if kind != POSE:
        return
    counts.poses += 1
    counts.positions_refused += 1 - slot.taken[0]
    counts.attitudes_refused += 1 - slot.taken[1]
    if slot.taken[0]:
        if stamp_s - body.taken_s > _GONE_S:
            body.again_s = stamp_s
        body.taken_s = max(body.taken_s, stamp_s)
    if slot.taken[0] and slot.taken[1]:
        others[_CANDIDATE].lives = False
        return
    if is_newest:
        _go_elsewhere(stamp_s, z, R, settings, model, body, slots, others, sent, work, counts)


@compiled
def _begin(track, stamp_s, z, R):
    """Start a track from a single pose."""
    track.stamp_s, track.surprise[:], track.x[:], track.P[:, :] = stamp_s, 0.0, 0.0, 0.0
    for i in range(6):
        track.x[MEASURES[POSE, i]] = z[i]
        for j in range(6):
            track.P[MEASURES[POSE, i], MEASURES[POSE, j]] = R[i, j]
    for k in range(3):
        track.P[3 + k, 3 + k], track.P[9 + k, 9 + k] = _UNKNOWN_M_S**2, _UNKNOWN_RAD_S**2
        track.P[12 + k, 12 + k] = _UNKNOWN_M_S2**2


@compiled
def _measure(slot, settings, work):
    """Take the measurement of a slot, as far as it passes the gate."""
    slot.taken[0] = slot.taken[1] = 0
    if slot.kind == POSE:
        _take_pose(slot.track, slot.z, slot.R, slot.taken, settings, work)
    elif slot.kind != _TIME:
        rows = MEASURES[slot.kind]
        if slot.kind == _VELOCITY:  # in level axes: forward, right
            forward, right = slot.z[0], slot.z[1]
            cos_psi, sin_psi = math.cos(slot.track.x[8]), math.sin(slot.track.x[8])
            z = np.zeros(6)
            z[0], z[1] = cos_psi * forward - sin_psi * right, -(sin_psi * forward + cos_psi * right)
            if innovate(slot.track, z, slot.R, rows, 0, 2, work) <= settings.gate:
                correct(slot.track, rows, 0, 2, work)
        elif innovate(slot.track, slot.z, slot.R, rows, 0, 2, work) <= settings.gate:
            correct(slot.track, rows, 0, 2, work)


@compiled
def _take_pose(track, z, R, taken, settings, work):
    """Take position and attitude, each if it passes the gate."""
    rows = MEASURES[POSE]
    mean = track.surprise
    if mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2] > _TOO_LARGE and settings.push_m_s2 > 0.0:
        push(track, settings.push_m_s2, _PUSHED_S)
        mean[:] = 0.0
    taken[1] = innovate(track, z, R, rows, 3, 3, work) <= settings.gate
    taken[0] = innovate(track, z, R, rows, 0, 3, work) <= settings.gate
    if taken[0]:
        for k in range(3):
            mean[k] += _SMOOTHS * (work.y[k] - mean[k])
    if taken[0] and taken[1]:
        innovate(track, z, R, rows, 0, 6, work)
        correct(track, rows, 0, 6, work)
    elif taken[0]:
        correct(track, rows, 0, 3, work)
    elif taken[1]:
        innovate(track, z, R, rows, 3, 3, work)
        correct(track, rows, 3, 3, work)


@compiled
def _innovations(stamp_s, squares, taken, models, bodies, slots, sent, spare, work):
    """Fill squares and taken for the poses of a frame, predicted once more from the event before."""
    rows, track = MEASURES[POSE], spare[0]
    for i in range(len(bodies)):
        n, oldest = slots.shape[1], bodies[i].newest - bodies[i].count + 1
        for k in range(bodies[i].newest, oldest, -1):
            slot, before = slots[i, k % n], slots[i, (k - 1) % n]
            if slot.track.stamp_s < stamp_s:
                break
            if slot.kind != POSE or slot.track.stamp_s > stamp_s:
                continue
            copy_track(track, before.track)
            predict(track, stamp_s, models[i], sent[i], work[0])
            for j in range(3):
                squares[i, j] = innovate(track, slot.z, slot.R, rows, 3 * (j % 2), 6 if j == 2 else 3, work[0])
            taken[i, 0], taken[i, 1] = slot.taken[0], slot.taken[1]
            break


@compiled
def _go_elsewhere(stamp_s, z, R, settings, model, body, slots, others, sent, work, counts):
    """Try a pose that the track has refused on the other tracks; one of them may replace the track."""
    taken = np.zeros(2, dtype=np.int64)
    for k in range(2):
        other = others[k]
        if k == _FORMER and other.lives and stamp_s - other.taken_s > settings.remember_s:
            other.lives = False
        if not other.lives:
            continue
        predict(other.track, stamp_s, model, sent, work)
        _take_pose(other.track, z, R, taken, settings, work)
        if not (taken[0] and taken[1]):
            if k == _CANDIDATE:
                other.lives = False
            continue
        other.taken_s = stamp_s
        if k == _FORMER or stamp_s - other.since_s >= settings.readmit_s:
            _change_to(stamp_s, other, others[_FORMER], body, slots)
            others[_CANDIDATE].lives = False
            counts.resets += 1
            return
    candidate = others[_CANDIDATE]
    if not candidate.lives:
        candidate.lives, candidate.since_s, candidate.taken_s = True, stamp_s, stamp_s
        _begin(candidate.track, stamp_s, z, R)


@compiled
def _change_to(stamp_s, other, former, body, slots):
    """Make the other track that of the body, and keep the replaced one as the former track."""
    slot = slots[body.newest % len(slots)]
    x, P, taken_s = slot.track.x.copy(), slot.track.P.copy(), body.taken_s
    slot.track.surprise[:], slot.track.x[:], slot.track.P[:, :] = other.track.surprise, other.track.x, other.track.P
    body.taken_s, body.again_s, body.count = stamp_s, stamp_s, 1
    former.track.x[:], former.track.P[:, :], former.track.stamp_s = x, P, stamp_s
    former.track.surprise[:] = 0.0
    former.lives, former.taken_s = True, taken_s
