"""The disturbance observer: its estimates of tilt, rate, level, gain, lag and push; what it rejects."""

import math
from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from risc_control.controllers.differential_flatness import Params
from risc_control.delay_prediction import discretised, loops, plants
from risc_control.disturbance_observer import LAG_S, observe, observer, unseen
from risc_lab.command_history import CHANNELS, Channel
from risc_lab.frames import GRAVITY_M_S2 as G
from risc_lab.lab import load_vehicle_type

ARDRONE = load_vehicle_type("ardrone")
OTHER = replace(ARDRONE, roll=replace(ARDRONE.roll, natural_frequency_rad_s=9.0), drag_n_s_m=0.0)
TYPES = [ARDRONE, OTHER]
PLANT = plants([ARDRONE])[0]
PARAMS = Params()
UNLEARNT_DRAG = replace(PARAMS, drag_spread_1_s=0.0)
FRAME_S = 0.005
_STEP_S = 0.001  # of the simulated vehicle


class Flyer:
    """A vehicle whose loops are those of the model, with a level, gains, drag and a push of its own, heading north.

    later_s: extra delay of commands.  bandwidth: of its tilt loops, relative to the model's.
    """

    climb_gain, climb_level_m_s, drags = 1.0, 0.0, 1.0

    def __init__(
        self, params=PARAMS, level=(0.0, 0.0), gain=(1.0, 1.0), push=(0.0, 0.0), later_s=0.0, bandwidth=1.0, seed=0
    ):
        (self._steps,), (self.unknown,) = observer([ARDRONE], params)
        self.height, self.climb, self._climbs = 0.0, 0.0, deque([0.0] * 1001, 1001)
        self.observed = unseen(1)[0]
        A, b = (part[:2].copy() for part in loops(ARDRONE))
        A[:, 1] *= bandwidth**2, bandwidth
        b[:, 1] *= bandwidth**2
        self._loops = [(*F.ravel().tolist(), *g.tolist()) for F, g in zip(*discretised(A, b, _STEP_S))]
        self.level, self.gain, self.push = np.array(level), np.array(gain), np.array(push)
        self.tilt, self.place, self.velocity = np.zeros((2, 2)), np.zeros(2), np.zeros(2)
        self._commands, self._later = deque([(0.0, 0.0)] * 1001, 1001), round(later_s / _STEP_S)
        self.time_s, self._rng = 100.0, np.random.default_rng(seed)

    def step(self, command, interval_s=FRAME_S, seen=True, angle_noise_rad=0.0, shown_m=(0.0, 0.0), climb_m_s=0.0):
        """Fly on under a command (roll, pitch; climb) and observe the vehicle, at a position off by shown_m."""
        for _ in range(round(interval_s / _STEP_S)):
            self._commands.append(tuple(command))
            self._climbs.append(climb_m_s)
            wanted_m_s = self.climb_gain * self._climbs[-1 - self._later] + self.climb_level_m_s
            self.climb += _STEP_S * (wanted_m_s - self.climb) / ARDRONE.climb_time_constant_s
            self.height += _STEP_S * self.climb
        self._move(round(interval_s / _STEP_S))
        self.time_s += interval_s
        if seen:
            angles = self.tilt[:, 0] + angle_noise_rad * self._rng.standard_normal(2)
            way = (*(self.place + shown_m), self.height, *self.velocity, self.climb)
            told, earlier = np.zeros((2, CHANNELS))
            late = -1 - round(LAG_S / _STEP_S)
            told[: Channel.CLIMB], earlier[: Channel.CLIMB] = command, self._commands[late]
            told[Channel.CLIMB], earlier[Channel.CLIMB] = climb_m_s, self._climbs[late]
            tilt = (*angles, *self.tilt[:, 1])
            observe(self.observed, self.time_s, tilt, way, told, earlier, 0.0, PLANT, self._steps, self.unknown)

    def _move(self, steps):
        """Advance tilt, velocity and place by `steps`: in plain numbers, which are ten times as fast as arrays of 2."""
        tilts, gains, levels = self.tilt.tolist(), self.gain.tolist(), self.level.tolist()
        (x, y), (u, v), pushes = self.place.tolist(), self.velocity.tolist(), self.push.tolist()
        drag_1_s, h = self.drags * float(PLANT.drag_1_s), _STEP_S

        def accelerations():
            (phi, _), (theta, _) = tilts
            north = -G * math.tan(theta) - drag_1_s * u + pushes[0]
            return north, G * math.tan(phi) / math.cos(theta) - drag_1_s * v + pushes[1]

        for k in range(-steps, 0):
            before = accelerations()
            for i, command in enumerate(self._commands[k - self._later]):
                f11, f12, f21, f22, g1, g2 = self._loops[i]
                (angle, rate), driven = tilts[i], gains[i] * command + levels[i]
                tilts[i] = f11 * angle + f12 * rate + g1 * driven, f21 * angle + f22 * rate + g2 * driven
            north, east = (0.5 * (one + other) for one, other in zip(before, accelerations()))
            x, y = x + h * u + 0.5 * h**2 * north, y + h * v + 0.5 * h**2 * east
            u, v = u + h * north, v + h * east
        self.tilt, self.place, self.velocity = np.array(tilts), np.array([x, y]), np.array([u, v])

    @property
    def angles(self):
        return np.array([self.observed.phi.value, self.observed.theta.value])

    @property
    def rates(self):
        return np.array([self.observed.phi.rate, self.observed.theta.rate])

    @property
    def learnt(self):
        """(level, gain, push, lag), of two axes each."""
        o = self.observed
        return np.array([(o.phi.level, o.theta.level), (o.phi.gain, o.theta.gain),
                         (o.north.push_m_s2, o.east.push_m_s2), (o.phi.lag, o.theta.lag)])  # fmt: skip


def waving(k, size_rad=0.1):
    return size_rad * np.sin(2.0 * FRAME_S * k + np.array([0.0, 1.0]))


def test_it_knows_the_rate_from_noisy_angles():
    """Better than the measured angles, without lag in the rate: 0.6 degrees of noise, known commands."""
    flyer, errors = Flyer(), []
    for k in range(1500):
        flyer.step(waving(k), seen=k % 50 != 7, angle_noise_rad=0.01)
        if k > 300:
            errors.append((flyer.angles - flyer.tilt[:, 0], flyer.rates - flyer.tilt[:, 1]))
    angle_errors, rate_errors = np.array([e for e, k in zip(errors, range(301, 1500)) if k % 50 != 7]).transpose(
        1, 0, 2
    )
    assert np.std(angle_errors) < 0.004 and abs(np.mean(angle_errors)) < 5e-4
    assert np.std(rate_errors) < 0.06


@pytest.mark.parametrize("interval_s", [0.005, 0.01, 0.02])
def test_it_learns_level_gain_and_push_at_any_rate(interval_s):
    """On both axes, with their signs; it learns nothing that is not there."""
    flyer = Flyer(level=(0.01, -0.02), gain=(0.85, 1.1), push=(0.3, 0.0))
    for k in range(round(40.0 / interval_s)):
        flyer.step(waving(k * interval_s / FRAME_S), interval_s)
    level, gain, push, lag = flyer.learnt
    assert level == pytest.approx((0.01, -0.02), abs=0.002)
    assert gain == pytest.approx((-0.15, 0.1), abs=0.03)
    assert push == pytest.approx((0.3, 0.0), abs=0.02)
    assert lag == pytest.approx((0.0, 0.0), abs=0.05)


@pytest.mark.parametrize("later_s", [0.02, 0.06])
def test_it_learns_how_late_the_link_is(later_s):
    flyer = Flyer(later_s=later_s)
    for k in range(6000):
        flyer.step(waving(k))
    assert LAG_S * flyer.learnt[3] == pytest.approx((later_s, later_s), rel=0.25)
    assert abs(flyer.learnt[1]).max() < 0.03


def test_it_learns_of_the_climb_loop_too():
    flyer = Flyer(later_s=0.03)
    flyer.climb_gain, flyer.climb_level_m_s = 0.9, 0.02
    for k in range(6000):
        flyer.step(np.zeros(2), climb_m_s=0.3 * math.sin(0.8 * FRAME_S * k))
    height = flyer.observed.height
    assert height.gain == pytest.approx(-0.1, abs=0.03) and height.level == pytest.approx(0.02, abs=0.01)
    assert 0.005 < LAG_S * height.lag < 0.045
    assert height.rate == pytest.approx(flyer.climb, abs=0.005)


def test_of_a_type_that_is_told_its_thrust_it_learns_nothing_of_the_climb():
    _, unknown = observer([ARDRONE, load_vehicle_type("iris")], PARAMS)
    assert all(unknown[0, 1][name] > 0.0 for name in ("level_per_s", "gain", "lag"))
    assert not any(unknown[1, 1][name] for name in ("level_per_s", "gain", "lag")) and unknown[1, 0]["gain"] > 0.0


@pytest.mark.parametrize("bandwidth", [0.8, 1.25])
def test_it_learns_how_late_another_loop_is(bandwidth):
    """Tilt loops of another bandwidth than the model's: a loop lags by 2 zeta / wn."""
    flyer = Flyer(bandwidth=bandwidth)
    lag_s = [2.0 * loop.damping_ratio / loop.natural_frequency_rad_s for loop in (ARDRONE.roll, ARDRONE.pitch)]
    for k in range(4000):
        flyer.step(waving(k))
    assert LAG_S * flyer.learnt[3] == pytest.approx(np.array(lag_s) * (1.0 / bandwidth - 1.0), rel=0.3)


def test_a_push_is_known_within_a_second():
    flyer = Flyer()
    for k in range(400):
        flyer.step(waving(k))
    flyer.push = np.array([0.0, 0.5])
    for k in range(400, 600):
        flyer.step(waving(k))
    assert flyer.learnt[2] == pytest.approx((0.0, 0.5), abs=0.1)


@pytest.mark.parametrize(("drags", "params"), [(3.0, PARAMS), (0.5, PARAMS), (3.0, UNLEARNT_DRAG)])
def test_it_learns_the_drag_on_a_circle(drags, params):
    """Drag turns with the velocity, faster than a push is learnt; the rest stays a push. UNLEARNT_DRAG: no drag."""
    flyer = Flyer(params, push=(0.0, 0.2))
    flyer.drags = drags
    for k in range(4000):
        flyer.step(0.06 * np.array([math.sin(1.0 * FRAME_S * k), math.cos(1.0 * FRAME_S * k)]), angle_noise_rad=0.01)
    learnt_1_s = flyer.observed.drag_1_s
    if params is PARAMS:
        assert learnt_1_s == pytest.approx((drags - 1.0) * PLANT.drag_1_s, rel=0.2)
        assert flyer.learnt[2] == pytest.approx((0.0, 0.2), abs=0.05)
    else:
        assert learnt_1_s == 0.0


def test_what_is_not_to_be_learnt_is_not():
    flyer = Flyer(
        replace(PARAMS, level_rad_s=0.0, gain_spread=0.0, lag_spread_s=0.0, push_m_s3=0.0, drag_spread_1_s=0.0),
        (0.01, 0.0),
        (0.9, 1.0),
        (0.3, 0.0),
    )
    for k in range(600):
        flyer.step(waving(k))
    assert not flyer.learnt.any() and flyer.observed.drag_1_s == 0.0
    unlearnt, unknown = flyer._steps, flyer.unknown
    (flyer._steps,), (flyer.unknown,) = observer([ARDRONE], PARAMS)
    for k in range(600, 2000):
        flyer.step(waving(k))
    assert flyer.learnt[0, 0] > 1e-4 and flyer.learnt[1, 0] < -0.02 and flyer.learnt[2, 0] > 0.1
    flyer._steps, flyer.unknown = unlearnt, unknown
    flyer.step(waving(2000))
    assert not flyer.learnt.any(), "what is not to be learnt any more is forgotten"


def test_without_commands_gain_and_lag_are_not_guessed():
    """Its variance stays bounded, however long it hovers."""
    flyer = Flyer(level=(0.01, 0.0))
    for _ in range(4000):
        flyer.step(np.zeros(2), angle_noise_rad=0.01)
    assert abs(flyer.learnt[1]).max() < 1e-9 and abs(flyer.learnt[3]).max() < 1e-9
    assert flyer.observed.phi.P[3, 3] <= PARAMS.gain_spread**2 * (1.0 + 1e-9)
    P = flyer.observed.phi.P
    assert np.array_equal(P, P.T) and np.linalg.eigvalsh(P).min() > 0.0


def test_it_starts_from_the_measurement_and_again_after_a_gap():
    flyer = Flyer(push=(0.3, 0.0))
    for k in range(400):
        flyer.step(waving(k))
    before = flyer.learnt
    flyer.step(waving(400), 0.5)
    assert (flyer.angles == flyer.tilt[:, 0]).all() and (flyer.rates == flyer.tilt[:, 1]).all()
    assert (flyer.observed.north.m, flyer.observed.north.m_s) == (flyer.place[0], flyer.velocity[0])
    assert (flyer.observed.height.value, flyer.observed.height.rate) == (flyer.height, flyer.climb)
    assert flyer.learnt == pytest.approx(before, abs=1e-12), "what it has learnt stays"


def test_false_places_teach_it_nothing_and_are_believed_when_they_stay():
    flyer = Flyer()
    for k in range(400):
        flyer.step(waving(k))
    before = flyer.learnt
    for k in range(400, 430):
        flyer.step(waving(k), shown_m=(1.0, 0.0))
        assert flyer.learnt == pytest.approx(before, abs=1e-12)
        assert flyer.observed.north.m == pytest.approx(flyer.place[0], abs=0.01)
    for k in range(430, 445):
        flyer.step(waving(k), shown_m=(1.0, 0.0))
    assert flyer.observed.north.m == pytest.approx(flyer.place[0] + 1.0, abs=0.01)
    assert flyer.learnt == pytest.approx(before, abs=0.02)


def test_what_is_not_finite_is_not_measured():
    """One number that is not finite must not stay in the filters, nor in what was learnt."""
    flyer, wrong = Flyer(level=(0.01, -0.02)), Flyer(level=(0.01, -0.02))
    for k in range(400):
        flyer.step(waving(k), seen=k != 300)
        wrong.step(waving(k), shown_m=(math.nan, 0.0) if k == 300 else (0.0, 0.0))
    assert np.array_equal(flyer.learnt, wrong.learnt) and np.isfinite(wrong.learnt).all()


def test_steps_of_any_length_are_those_of_the_exponential():
    steps, _ = observer(TYPES, PARAMS)
    A, b = (np.stack(part)[:, :2] for part in zip(*map(loops, TYPES)))
    for j in (1, 10, 137, 200):
        Phi, Gamma = discretised(A, b, 0.0005 * j)
        for axis, name in enumerate(("phi", "theta")):
            step = steps[name][:, j - 1]
            assert np.stack([step[f] for f in ("f11", "f12", "f21", "f22")], axis=1) == pytest.approx(
                Phi[:, axis].reshape(2, 4), abs=1e-13
            )
            assert np.stack([step["g1"], step["g2"]], axis=1) == pytest.approx(Gamma[:, axis], abs=1e-13)
