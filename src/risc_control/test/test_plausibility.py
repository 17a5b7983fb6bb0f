"""risc_control.plausibility: what a vehicle can do is believed, what it cannot do is not, and what is true again is."""

import dataclasses
import math

import numpy as np
import pytest

from risc_control.plausibility import Doubt, Plausibility, reach_of
from risc_control.safety import SafetyLimits
from risc_lab.clock_guard import AGREEING
from risc_lab.lab import load_vehicle_type
from risc_lab.states import S

LIMITS = SafetyLimits()
OFF = dataclasses.replace(LIMITS, ladder=False)
LOOK_S = 1.0 / 60.0
NOISE_M, NOISE_M_S, NOISE_RAD = 0.001, 0.01, 0.003


class Fleet:
    """Vehicles that fly ahead at 0.5 m/s, side by side 1 m apart, seen with noise; `lie` changes what is seen."""

    def __init__(self, count=2, limits=LIMITS, kind="ardrone", step_s=LOOK_S):
        self.names = tuple("v%d" % k for k in range(count))
        self.judge = Plausibility(dict.fromkeys(self.names, load_vehicle_type(kind)), limits)
        self.time_s, self.step_s, self._rng = 100.0, step_s, np.random.default_rng(3)
        self.lie = lambda states: None
        self.run(1.0)

    def look(self):
        """(n,) bool of one look."""
        self.time_s += self.step_s
        noise = np.repeat((NOISE_M, NOISE_M_S, NOISE_RAD, 0.0), 3)
        states = noise * self._rng.standard_normal((len(self.names), len(S)))
        states[:, S.X] += 0.5 * (self.time_s - 100.0)
        states[:, S.U] += 0.5
        states[:, S.Y] += np.arange(len(self.names))
        states[:, S.Z] += 1.0
        self.lie(states)
        return self.judge.look(self.names, np.ones(len(self.names), bool), states, self.time_s)

    def run(self, duration_s):
        """[(n,) bool] of the looks within a time."""
        return [self.look() for _ in range(round(duration_s / self.step_s))]


def jump(states):
    states[0, S.X] += 0.3


def slow_jump(states):
    states[0, S.U] += 0.9


def flip(states):
    states[0, S.PSI] += math.pi


def tip(states):
    states[0, S.PHI] += 0.4


def exchange(states):
    states[[0, 1]] = states[[1, 0]]


def freeze():
    seen = []

    def lie(states):
        seen.append(states[0].copy())
        states[0] = seen[0]

    return lie


LIES = [
    (jump, Doubt.POSITION, "0.3"),
    (slow_jump, Doubt.VELOCITY, "0.9 m/s"),
    (flip, Doubt.YAW, "180 deg"),
    (tip, Doubt.TILT, "23 deg"),
    (freeze(), Doubt.FROZEN, "repeats"),
]


@pytest.mark.parametrize(("lie", "doubt", "words"), LIES, ids=[doubt.name for _, doubt, _ in LIES])
def test_what_cannot_be_is_suspect(lie, doubt, words):
    fleet = Fleet()
    fleet.lie = lie
    if doubt is Doubt.FROZEN:
        fleet.look()  # the first is a measurement
    for believed in fleet.run(0.1):
        assert believed.tolist() == [False, True], "from the first look on, and of no other vehicle"
    assert fleet.judge.doubt("v0") is doubt and words in fleet.judge.reason("v0")
    assert fleet.judge.doubt("v1") is Doubt.NONE and fleet.judge.reason("v1") == ""
    # the control arm
    fleet = Fleet(limits=OFF)
    fleet.lie = lie
    assert all(believed.all() for believed in fleet.run(0.1))


def test_exchanged_names_are_named():
    fleet = Fleet(3)
    fleet.lie = exchange
    assert fleet.look().tolist() == [False, False, True]
    assert fleet.judge.doubt("v0") is fleet.judge.doubt("v1") is Doubt.EXCHANGED
    assert "v1" in fleet.judge.reason("v0") and "v0" in fleet.judge.reason("v1")
    # one that jumps to the place of another one has not exchanged its name
    fleet = Fleet(3)
    fleet.lie = lambda states: states.__setitem__(0, states[1])
    assert fleet.look().tolist() == [False, True, True]
    assert fleet.judge.doubt("v0") is Doubt.POSITION


@pytest.mark.parametrize("lasts_s", [1.5 * LOOK_S, 0.1, 0.3, 0.45])
@pytest.mark.parametrize("lie", [jump, slow_jump, flip, tip, exchange])
def test_what_is_true_again_is_believed_within_100_ms(lie, lasts_s):
    fleet = Fleet()
    fleet.lie = lie
    fleet.run(lasts_s)
    fleet.lie = lambda states: None
    looks = [believed[0] for believed in fleet.run(0.2)]
    assert not looks[0] and 0 < looks.index(True) * LOOK_S < 0.1 and all(looks[looks.index(True) :])


@pytest.mark.parametrize("lasts_s", [0.1, 0.5, 3.0])
def test_after_a_freeze_the_first_new_state_is_believed(lasts_s):
    fleet = Fleet()
    fleet.lie = freeze()
    assert not fleet.run(lasts_s)[-1][0]
    fleet.lie = lambda states: None
    assert all(believed.all() for believed in fleet.run(0.2))


@pytest.mark.parametrize("lie", [jump, flip, exchange])
def test_a_false_place_is_not_believed_before_the_vehicle_has_landed(lie):
    fleet = Fleet()
    fleet.lie = lie
    looks = [believed[0] for believed in fleet.run(15.0)]
    assert looks.index(True) * LOOK_S == pytest.approx(LIMITS.separation_forget_s, abs=0.1)
    assert all(looks[looks.index(True) :]), "or it could not be flown any more"


@pytest.mark.parametrize(("step_m", "believed"), [(1.5, False), (0.2, True)])
@pytest.mark.parametrize("kind", ["ardrone", "iris"])
def test_a_false_place_that_jumps_is_no_nearer_to_the_truth(kind, step_m, believed):
    """However long ago the vehicle was seen: one that is not flown on has not gone far."""
    fleet = Fleet(kind=kind)
    for away_m in (2.0 * step_m, step_m):

        def lie(states, away_m=away_m):
            states[0, S.Z] -= 0.1 * away_m
            states[0, S.Y] += away_m

        fleet.lie = lie
        looks = [looked[0] for looked in fleet.run(3.0)]
    assert any(looks) == believed


@pytest.mark.parametrize("gap_s", [0.1, 0.3, 1.0, 100.0])
def test_after_a_gap_the_first_state_is_believed(gap_s):
    fleet = Fleet()
    fleet.time_s += gap_s
    assert all(believed.all() for believed in fleet.run(0.2))


@pytest.mark.parametrize(("tilt_deg", "believed"), [(60.0, True), (80.0, False)])
def test_none_is_seen_at_a_tilt_that_none_can_fly_however_long_it_was_not_seen(tilt_deg, believed):
    """A pose with y and z swapped, which an estimator accepts once it has nothing to compare it to."""
    fleet = Fleet(kind="iris")
    fleet.time_s += 2.0

    def tilt(states):
        states[0, S.PHI] += math.radians(tilt_deg)

    fleet.lie = tilt
    seen = fleet.run(12.0)
    assert [look[0] for look in seen] == [believed] * len(seen) and seen[-1][1]
    if not believed:
        assert fleet.judge.doubt("v0") == Doubt.STEEP
        fleet.lie = lambda states: None
        assert fleet.run(0.3)[-1][0]


def test_stamps_that_stand_or_go_back():
    fleet = Fleet()
    fleet.step_s = 0.0
    assert fleet.look().all(), "the same message once more"
    fleet.step_s = LOOK_S
    fleet.time_s -= 0.1
    assert fleet.look() is None, "overtaken"
    fleet.time_s += 0.1
    assert all(believed.all() for believed in fleet.run(0.2))


BELIEVED, SUSPECT, NOT_JUDGED = True, False, None


def looks(judge, *stamped):
    """Verdicts on one vehicle that is seen hovering at each (stamp [s], x [m])."""
    state, verdicts = np.zeros((1, len(S))), []
    for stamp_s, x_m in stamped:
        state[0, S.X] = x_m
        believed = judge.look(("v0",), np.ones(1, bool), state, stamp_s)
        verdicts.append(NOT_JUDGED if believed is None else bool(believed[0]))
    return verdicts


def after(start_s, x_m, count):
    """(stamp [s], x [m]) of a vehicle that is seen to move a little."""
    return [(start_s + LOOK_S * k, x_m + 1e-3 * (k % 2)) for k in range(1, count + 1)]


@pytest.mark.parametrize("back_s", [0.1, 1.0, 100.0])
def test_a_clock_that_was_set_back_ends_no_flight_and_hides_no_jump(back_s):
    judge = Fleet().judge
    assert all(looks(judge, *after(500.0, 0.0, 10)))
    newest_s = 500.0 + 10 * LOOK_S
    new = [NOT_JUDGED] * (AGREEING - 1)
    assert looks(judge, *after(newest_s - back_s, 0.0, 8)) == new + [BELIEVED] * (9 - AGREEING)
    newest_s += 8 * LOOK_S - back_s
    assert set(looks(judge, *after(newest_s - back_s, 2.0, 12))) == {NOT_JUDGED, SUSPECT}


def test_a_straggler_is_not_judged_and_nothing_is_learnt_from_it():
    judge = Fleet().judge
    looks(judge, *after(500.0, 0.0, 10))
    newest_s = 500.0 + 10 * LOOK_S
    assert looks(judge, (newest_s - 0.101, 2.0)) == [NOT_JUDGED]
    assert looks(judge, *after(newest_s, 2.0, 3)) == [SUSPECT] * 3
    assert looks(judge, *after(newest_s + 3 * LOOK_S, 0.0, 20))[-1] is BELIEVED


def test_who_is_not_known_or_not_seen_or_no_number():
    fleet = Fleet()
    states = np.full((3, len(S)), 7.0)
    states[1] = np.nan
    visible = np.array([True, True, False])
    for stamp_s in (200.0, 200.01):
        states[0] += 1.0
        looked = fleet.judge.look(("stranger", "v0", "v1"), visible, states, stamp_s)
        assert looked.tolist() == visible.tolist()


@pytest.mark.parametrize("kind", ["ardrone", "iris"])
@pytest.mark.parametrize("step_s", [0.005, LOOK_S, 0.05, 0.2])
def test_what_the_type_can_do_is_believed(kind, step_s):
    """Flown at full acceleration one way, then the other, turning at full rate, with the noise of measurements."""
    level_m_s2, up_m_s2, tilt_rad_s, yaw_rad_s = reach_of(load_vehicle_type(kind))
    rng = np.random.default_rng(1)
    for _ in range(8):
        judge = Plausibility({"v": load_vehicle_type(kind)}, LIMITS)
        state, way = np.zeros(len(S)), rng.standard_normal(2)
        way /= np.linalg.norm(way)
        for k in range(round(1.6 / step_s)):
            for part_s in np.full(10, step_s / 10.0):
                sign = 1.0 if (k * step_s) % 0.8 < 0.4 else -1.0
                accel = np.array([*(sign * level_m_s2 * way), sign * up_m_s2])
                state[:3] += part_s * state[3:6] + 0.5 * part_s**2 * accel
                state[3:6] += part_s * accel
                state[S.PHI] += sign * part_s * min(tilt_rad_s, 2.0)
                state[S.PSI] += part_s * yaw_rad_s
            seen = state + np.repeat((NOISE_M, NOISE_M_S, NOISE_RAD, 0.0), 3) * rng.standard_normal(len(S))
            assert judge.look(("v",), np.ones(1, bool), seen[None], k * step_s).all(), judge.reason("v")


def test_a_hover_without_noise_is_frozen_but_where_somebody_says_so():
    still = np.zeros((1, len(S)))
    for limits, believes in ((LIMITS, False), (dataclasses.replace(LIMITS, state_least_step_m=0.0), True)):
        judge = Plausibility({"v": load_vehicle_type("ardrone")}, limits)
        judge.look(("v",), np.ones(1, bool), still, 1.0)
        assert judge.look(("v",), np.ones(1, bool), still, 1.02).all() == believes
