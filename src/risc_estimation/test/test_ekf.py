"""The extended Kalman filter of a vehicle: its equations, and what it does with data that are lost, late or false."""

import math

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from mocap_frames import pack_bodies
from scipy.stats import chi2

from risc_estimation.ekf import DIM, TRACK, WORK, correct, innovate, jacobian, predict, slope
from risc_estimation.filters import COMMAND, Status, make_filter
from risc_estimation.filters.ekf import MEASURES, POSE, model_of
from risc_estimation.pose_fit import PoseFitParams
from risc_estimation.state_estimator import StatesEstimator
from risc_lab.command_history import CommandHistory
from risc_lab.frames import GRAVITY_M_S2, rotation_body_to_cortex
from risc_lab.lab import load_templates, load_vehicle_type
from risc_lab.states import S

TEMPLATES = load_templates()
TYPES = {"fluffy_II": load_vehicle_type("ardrone"), "IRIS": load_vehicle_type("iris")}
DT_S, NOISE_M = 0.005, 0.002
COMMANDS_S = 0.03  # between two commands


def model(name="fluffy_II", **given):
    return model_of(make_filter("ekf", given).params, TEMPLATES[name], TYPES.get(name))


def some_state(rng):
    x = rng.normal(0.0, 0.3, DIM)
    x[S.Z] += 1.5
    return x


@pytest.mark.parametrize("name", TYPES)
@pytest.mark.parametrize("free", [False, True])
def test_the_jacobian_is_that_of_the_model(name, free):
    rng, F, h = np.random.default_rng(1), np.zeros((DIM, DIM)), 1e-6
    for _ in range(20):
        x, command, columns = some_state(rng), rng.normal(0.0, 0.2, 4), []
        jacobian(x, model(name), command, free, F)
        for j in range(DIM):
            both = []
            for sign in (1.0, -1.0):
                moved, rate = x.copy(), np.zeros(DIM)
                moved[j] += sign * h
                slope(moved, model(name), command, free, rate)
                both.append(rate)
            columns.append((both[0] - both[1]) / (2.0 * h))
        np.testing.assert_allclose(F, np.transpose(columns), atol=1e-7)


def test_it_predicts_and_corrects_as_filterpy_does():
    """One step and one pose. Noise of a step: white accelerations, integrated exactly."""
    rng, its = np.random.default_rng(2), model()
    track, work = np.zeros(1, TRACK), np.zeros(1, WORK)[0]
    x, command = some_state(rng), np.array([0.1, -0.05, 0.2, 0.3])
    A = rng.normal(0.0, 0.1, (DIM, DIM))
    track["x"], track["P"] = x, A @ A.T + 1e-3 * np.eye(DIM)

    other = ExtendedKalmanFilter(dim_x=DIM, dim_z=6)
    other.P, rate, mid, F = track["P"][0].copy(), np.zeros(DIM), np.zeros(DIM), np.zeros((DIM, DIM))
    slope(x, its, command, False, rate)
    mid[:] = x + 0.5 * DT_S * rate
    slope(mid, its, command, False, rate)
    jacobian(mid, its, command, False, F)
    other.F = np.eye(DIM) + DT_S * F + 0.5 * DT_S**2 * F @ F
    other.Q = np.zeros((DIM, DIM))
    noises = (its["acceleration"],) * 2 + (
        its["climb_acceleration"],
        its["roll_noise"],
        its["pitch_noise"],
        its["yaw_noise"],
    )
    for value, density in zip((0, 1, 2, 6, 7, 8), noises):
        block = [[DT_S**3 / 3.0, DT_S**2 / 2.0], [DT_S**2 / 2.0, DT_S]]
        other.Q[np.ix_([value, value + 3], [value, value + 3])] = density**2 * np.array(block)
    other.Q[range(12, 15), range(12, 15)] = its["disturbance"] ** 2 * DT_S
    other.predict_x = lambda u=0: setattr(other, "x", (x + DT_S * rate)[:, None])
    other.predict()
    z, R = rng.normal(0.0, 0.3, 6), np.diag(rng.uniform(1e-6, 1e-4, 6))
    H = np.eye(DIM)[[0, 1, 2, 6, 7, 8]]
    other.update(z[:, None], lambda x: H, lambda x: H @ x, R)

    sent = CommandHistory(1)
    sent.append(0, -1e-9 - its["delay_s"], command)
    predict(track[0], DT_S, its, sent.vehicles[0], work)
    square = innovate(track[0], z, R, MEASURES[POSE], 0, 6, work)
    correct(track[0], MEASURES[POSE], 0, 6, work)
    np.testing.assert_allclose(track["x"][0], other.x[:, 0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(track["P"][0], other.P, rtol=1e-7, atol=1e-12)
    assert square == pytest.approx((other.y.T @ np.linalg.solve(other.S, other.y)).item(), rel=1e-9)


class Flown:
    """A vehicle that behaves as modelled, on random commands, seen by cameras with noise of NOISE_M."""

    def __init__(self, seed=1, name="fluffy_II", noise_m=NOISE_M, **given):
        self.name, self.rng, self.model = name, np.random.default_rng(seed), model(name, **given)
        kinds = {name: TYPES[name]} if name in TYPES else {}
        self.estimator = StatesEstimator(
            TEMPLATES, PoseFitParams(frozen_frames=0), [name], make_filter("ekf", given), kinds
        )
        self.x, self.time_s, self.noise_m = np.zeros(DIM), 0.0, noise_m
        self.x[S.Z] = 1.5
        self.sent = CommandHistory(1)
        self.sent_s = -math.inf

    def step(self):
        """The next frame's (stamp, layout, markers)."""
        self.time_s += DT_S
        if self.time_s - self.sent_s >= COMMANDS_S:
            self.sent_s = self.time_s
            back = -0.2 * self.x[[S.X, S.Y, S.Z]] - 0.3 * self.x[[S.U, S.V, S.W]]
            back[2] += 0.2 * 1.5
            tilt = np.clip([-back[1], -back[0]], -0.1, 0.1)
            command = np.array([*tilt, 0.3 * back[2], 0.0]) + self.rng.normal(0.0, [0.05, 0.05, 0.1, 0.2])
            self.sent.append(0, self.sent_s, command)
            self.estimator.on_board(self.name, self.sent_s, COMMAND, command)
        rate, command = np.zeros(DIM), self.sent.at(0, self.time_s - 0.5 * DT_S - self.model["delay_s"])
        slope(self.x, self.model, command, False, rate)
        middle = self.x + 0.5 * DT_S * rate
        slope(middle, self.model, command, False, rate)
        self.x = self.x + DT_S * rate
        for rates, name in ((S.U, "acceleration"), (S.V, "acceleration"), (S.W, "climb_acceleration"),
                            (S.P, "roll_noise"), (S.Q, "pitch_noise"), (S.R, "yaw_noise")):  # fmt: skip
            self.x[rates] += self.rng.normal(0.0, self.model[name] * math.sqrt(DT_S))
        self.x[12:] += self.rng.normal(0.0, self.model["disturbance"] * math.sqrt(DT_S), 3)
        return self.frame(self.x[:3], self.x[6:9])

    def frame(self, position_m, angles_rad):
        markers = TEMPLATES[self.name].markers_m @ rotation_body_to_cortex(*angles_rad).T + position_m
        markers = markers + self.rng.normal(0.0, self.noise_m, markers.shape)
        return self.time_s, *pack_bodies({self.name: markers})

    def fly(self, seconds):
        """Fly for that time, well seen; return the last FrameEstimate."""
        for _ in range(round(seconds / DT_S)):
            estimate = self.estimator.update(*self.step())
        return estimate

    def error_m(self, estimate):
        return np.linalg.norm(estimate.states[0, :3] - self.x[:3])


def beside(frame, by_m):
    """The same frame with the vehicle elsewhere."""
    stamp_s, layout, markers = frame
    return stamp_s, layout, markers + by_m


@pytest.mark.parametrize("name", TYPES)
def test_its_covariance_is_true(name, inputs):
    """Mean NEES of a vehicle that behaves as modelled, at one time of each flight: within its 95 % band."""
    squares = []
    for seed in range(inputs(20, 40)):
        flown = Flown(seed, name)
        estimate = flown.fly(1.5)
        error = flown.x[:12] - estimate.states[0]
        error[S.PHI : S.P] = (error[S.PHI : S.P] + math.pi) % (2.0 * math.pi) - math.pi
        squares.append(error @ np.linalg.solve(flown.estimator.covariances()[0], error))
    low, high = chi2.ppf([0.025, 0.975], 12 * len(squares)) / len(squares)
    assert low < np.mean(squares) < high


def test_its_innovations_are_those_that_the_gate_looks_at(inputs):
    """Mean NIS of many frames is within its 95 % band, and asking for the innovations changes nothing."""
    asked, other, found = Flown(11), Flown(11), []
    asked.fly(1.5), other.fly(1.5)
    for k in range(inputs(1000, 2000)):
        asked.fly(DT_S)
        innovations = asked.estimator.innovations()
        assert innovations.taken.all()
        found.append(innovations.squares[0])
        if k < 200:
            other.fly(DT_S)
            np.testing.assert_array_equal(asked.estimator.covariances(), other.estimator.covariances())
    for squares, freedom in zip(np.transpose(found), (3, 3, 6)):
        low, high = chi2.ppf([0.025, 0.975], freedom * len(found)) / len(found)
        assert low < squares.mean() < high
    gate = chi2.isf(1e-5, 3)
    asked.estimator.update(*beside(asked.step(), [0.5, 0.0, 0.0]))
    innovations = asked.estimator.innovations()
    assert innovations.squares[0, 0] > gate > innovations.squares[0, 1]
    assert innovations.taken.tolist() == [[False, True]]
    stamp_s, layout, markers_m = asked.step()
    asked.estimator.update(stamp_s, layout, np.full_like(markers_m, np.nan))
    innovations = asked.estimator.innovations()
    assert np.isnan(innovations.squares).all() and not innovations.taken.any()


def test_innovations_are_those_of_the_frame_whatever_is_measured_on_board_meanwhile():
    plain, busy = Flown(12), Flown(12)
    plain.fly(1.5), busy.fly(1.5)
    for flown in (plain, busy):
        later_s = flown.time_s + 1.5 * DT_S  # of the next frame
        if flown is busy:
            flown.estimator.on_board("fluffy_II", later_s, "velocity", np.array([0.1, 0.1, 0.0]))
        flown.fly(DT_S)
    np.testing.assert_array_equal(busy.estimator.innovations().squares, plain.estimator.innovations().squares)
    first = Flown(13)
    first.fly(DT_S)
    assert np.isnan(first.estimator.innovations().squares).all(), "there was nothing to predict it by"


def test_what_cannot_be_true_is_refused_at_once():
    """Markers half a metre off for 0.2 s: never shown there, and right again with the first good frame. Without the
    gate the state follows them.
    """
    worst_m = {}
    for gate in (1e-5, 0.0):
        flown = Flown(3, gate_probability=gate)
        flown.fly(1.5)
        errors = []
        for _ in range(40):
            estimate = flown.estimator.update(*beside(flown.step(), [0.5, 0.0, 0.0]))
            errors.append(flown.error_m(estimate))
            if gate:
                assert estimate.visible[0] and flown.estimator.status() == [Status.SUSPECT]
        worst_m[gate] = max(errors)
        if gate:
            assert flown.error_m(flown.fly(DT_S)) < 0.005 and flown.estimator.status() == [Status.REACQUIRED]
            flown.fly(0.1)
            assert flown.estimator.status() == [Status.REACQUIRED], "a tenth of a second, its last frame included"
            flown.fly(DT_S)
            assert flown.estimator.status() == [Status.TRACKED]
    assert worst_m[1e-5] < 0.01 and worst_m[0.0] > 0.3


def test_a_turned_vehicle_keeps_its_place():
    """A flip is refused as an attitude; its position is as good as before."""
    flown = Flown(4)
    flown.fly(1.5)
    for _ in range(40):
        flown.step()
        turned = flown.x[6:9] + [0.0, 0.0, math.pi]
        estimate = flown.estimator.update(*flown.frame(flown.x[:3], turned))
    assert estimate.visible[0] and flown.error_m(estimate) < 0.004
    assert abs(math.remainder(estimate.states[0, S.PSI] - flown.x[S.PSI], 2.0 * math.pi)) < 0.05


def test_who_is_not_seen_is_predicted_for_a_while():
    flown = Flown(5)
    flown.fly(1.5)
    lost = np.full_like(TEMPLATES[flown.name].markers_m, np.nan)
    shown = []
    for _ in range(200):
        stamp_s, layout, _ = flown.step()
        estimate = flown.estimator.update(stamp_s, layout, lost)
        shown.append(estimate.visible[0])
        if len(shown) == 100:  # 0.5 s
            assert flown.estimator.status() == [Status.PREDICTED] and flown.error_m(estimate) < 0.03
    assert 0.75 < DT_S * sum(shown) < 0.85 and not shown[-1]
    assert flown.fly(DT_S).visible[0], "the first good frame is believed"
    assert flown.estimator.status() == [Status.REACQUIRED]


@pytest.mark.parametrize(("gone_s", "status"), [(0.05, Status.TRACKED), (0.15, Status.REACQUIRED)])
def test_who_was_gone_for_a_few_frames_is_tracked_as_before(gone_s, status):
    flown = Flown(14)
    flown.fly(1.5)
    lost = np.full_like(TEMPLATES[flown.name].markers_m, np.nan)
    for _ in range(round(gone_s / DT_S)):
        stamp_s, layout, _ = flown.step()
        flown.estimator.update(stamp_s, layout, lost)
    flown.fly(DT_S)
    assert flown.estimator.status() == [status]


def test_what_agrees_for_long_is_believed_and_the_truth_at_once():
    """The same false place for longer than readmit_s; then the vehicle is where it was predicted to be."""
    flown = Flown(6)
    flown.fly(1.5)
    believed = []
    for _ in range(100):
        estimate = flown.estimator.update(*beside(flown.step(), [0.0, 0.5, 0.0]))
        believed.append(estimate.visible[0] and flown.error_m(estimate) > 0.4)
    assert DT_S * believed.index(True) == pytest.approx(0.3, abs=0.02)
    estimate = flown.fly(DT_S)
    assert estimate.visible[0] and flown.error_m(estimate) < 0.03
    assert flown.estimator.status() == [Status.REACQUIRED]


def test_the_acceleration_is_that_of_the_model_and_nobodys_without_commands():
    """Without gravity: none for a level vehicle, about g tan(pitch) for a pitched one. NaN for a pendulum tip."""
    flown, dull = Flown(12), "Pendulum_tip"
    assert np.isnan(flown.estimator.accelerations()).all()
    for _ in range(300):
        stamp_s, layout, markers_m = flown.step()
        tip_m = TEMPLATES[dull].markers_m + [1.0, 1.0, 1.0]
        estimate = flown.estimator.update(stamp_s, (*layout, (dull, 3)), np.concatenate([markers_m, tip_m]))
    assert estimate.names == (flown.name, dull)
    (found, of_tip), state, command = flown.estimator.accelerations(), estimate.states[0], np.zeros(4)
    assert np.isnan(of_tip).all()
    rate = np.zeros(DIM)
    command[:] = flown.sent.at(0, flown.time_s - flown.model["delay_s"])
    slope(flown.x, flown.model, command, False, rate)
    np.testing.assert_allclose(found, rate[3:6], atol=0.2)
    forward = math.cos(state[S.PSI]) * found[0] - math.sin(state[S.PSI]) * found[1]
    assert forward == pytest.approx(-GRAVITY_M_S2 * math.tan(state[S.THETA]), abs=0.4), "nose up: backwards"


def test_what_becomes_of_the_poses_is_counted_for_each_body():
    flown = Flown(11)
    flown.fly(1.0)
    (counts,) = flown.estimator.counters()
    assert (counts.poses, counts.late, counts.resets) == (200, 0, 0)
    assert counts.positions_refused + counts.attitudes_refused < 3
    before = counts.copy()
    for _ in range(20):
        flown.estimator.update(*beside(flown.step(), [0.5, 0.0, 0.0]))
    flown.fly(DT_S)
    (counts,) = flown.estimator.counters()
    assert (counts.poses - before.poses, counts.positions_refused - before.positions_refused) == (21, 20)
    assert counts.resets == 0
    lost = np.full_like(TEMPLATES[flown.name].markers_m, np.nan)
    for _ in range(2000):  # longer than a prediction is of use: the next pose resets the filter
        stamp_s, layout, _ = flown.step()
        flown.estimator.update(stamp_s, layout, lost)
    flown.fly(1.0)
    (counts,) = flown.estimator.counters()
    assert counts.resets == 1
    for _ in range(100):
        flown.estimator.update(*beside(flown.step(), [0.0, 0.5, 0.0]))
    flown.fly(DT_S)
    (counts,) = flown.estimator.counters()
    assert counts.resets == 3, "believed, and back again"


def test_late_poses_are_taken_at_their_own_time():
    """Frames out of order end in the same state as frames in order."""
    ends = []
    for late in (False, True):
        flown = Flown(7)
        estimate = flown.fly(1.0)
        frames = [flown.step() for _ in range(40)]
        if late:
            frames = [frames[k] for k in (*range(10), 30, *range(10, 30), *range(31, 40))]
        for frame in frames:
            estimate = flown.estimator.update(*frame) or estimate
        ends.append(estimate.states[0])
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-9)
    assert flown.estimator.counts.late_frames == flown.estimator.counters()["late"][0] == 20


def test_readings_that_stand_still_are_none():
    """A driver whose vehicle is gone repeats its last reading."""
    ends = []
    for repeats in (1, 50):
        flown = Flown(8)
        flown.fly(1.0)
        for k in range(50):
            if k < repeats:
                flown.estimator.on_board("fluffy_II", flown.time_s, "velocity", np.array([1.0, 1.0, 0.0]))
            estimate = flown.fly(DT_S)
        ends.append(estimate.states[0])
    np.testing.assert_array_equal(ends[0], ends[1])


def test_who_is_of_no_type_is_followed_all_the_same():
    """The tip of a pendulum, and a vehicle that is not in the fleet: accelerations are modelled as noise."""
    for name in "Pendulum_tip", "Raven":
        flown = Flown(9)
        flown.name = name
        flown.estimator = StatesEstimator(TEMPLATES, PoseFitParams(frozen_frames=0), [name], make_filter("ekf"))
        estimate = flown.fly(1.0)
        assert estimate.visible[0] and flown.error_m(estimate) < 0.006
        assert np.linalg.norm(estimate.states[0, 3:6] - flown.x[3:6]) < 0.2


def test_states_go_on_while_frames_are_late():
    """For half a second frames come 0.1 s late: meanwhile current states are predicted, each given once."""
    flown = Flown(10)
    last = flown.fly(1.5)
    on_their_way = []
    for k in range(100):
        on_their_way.append(flown.step())
        given = [flown.estimator.coast(flown.time_s)]
        if k >= 20:
            given.append(flown.estimator.update(*on_their_way.pop(0)))
        (estimate,) = filter(None, given)
        assert estimate.stamp_s == flown.time_s > last.stamp_s
        assert estimate.visible[0] and flown.error_m(estimate) < 0.01
        last = estimate
    for frame in on_their_way[:-1]:
        assert flown.estimator.update(*frame) is None
    assert flown.fly(DT_S).visible[0] and flown.estimator.counts.backward_stamps == 0
