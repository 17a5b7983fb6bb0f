"""Prediction ahead: against the exact loops, against the nonlinear equations of motion, and the tilt observer."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from risc_control.frames import GRAVITY_M_S2 as G
from risc_control.frames import rotation_body_to_cortex
from risc_control.lab import load_vehicle_type
from risc_control.prediction import (
    MAX_HORIZON_S,
    Channel,
    CommandHistory,
    Motion,
    NominalModel,
    Predictor,
    TiltObserver,
    discretised,
    effective_delay_s,
)

ARDRONE = load_vehicle_type("ardrone")
OTHER = replace(ARDRONE, roll=replace(ARDRONE.roll, natural_frequency_rad_s=9.0), drag_n_s_m=0.0)
MODEL = NominalModel.of([ARDRONE, OTHER])


def random_motion(rng, n=2):
    return Motion(
        rng.uniform(-1, 1, n) + 1j * rng.uniform(-1, 1, n),
        rng.uniform(-0.7, 0.7, n) + 1j * rng.uniform(-0.7, 0.7, n),
        rng.uniform(0.5, 1.5, n),
        rng.uniform(-0.3, 0.3, n),
        *rng.uniform(-0.15, 0.15, (2, n)),
        rng.uniform(-3, 3, n),
        *rng.uniform(-0.5, 0.5, (2, n)),
        rng.uniform(-0.3, 0.3, n),
    )


def random_history(rng, start_s, end_s, n=2, step_s=1.0 / 30.0):
    history, commands = CommandHistory(n), []
    for time_s in np.arange(start_s, end_s, step_s):
        command = rng.uniform(-1.0, 1.0, (n, 4)) * (0.2, 0.2, 0.5, 0.3)
        history.append(time_s, command)
        commands.append((time_s, command))
    return history, commands


def integrate(motion, i, model, time_s, horizon_s, delay_s, commands):
    """One vehicle by the full equations: thrust along the body axis from the climb loop, rotation matrix, drag."""
    wn, zeta = model.natural_frequency_rad_s[i], model.damping_ratio[i]
    tau_climb, tau_yaw, drag = model.climb_time_constant_s[i], model.yaw_time_constant_s[i], model.drag_1_s[i]

    def command_at(t):
        held = [command for sent_s, command in commands if sent_s <= t - delay_s]
        return held[-1][i] if held else np.zeros(4)

    def slope(t, x, command):
        v, phi, phi_rate, theta, theta_rate, psi, psi_rate = x[3:6], *x[6:]
        up = rotation_body_to_cortex(phi, theta, psi) @ [0.0, 0.0, -1.0]
        climb_acceleration = (command[Channel.CLIMB] - v[2]) / tau_climb
        specific_thrust = (G + climb_acceleration) / up[2]
        a = specific_thrust * up - [drag * v[0], drag * v[1], G]
        return [
            *v,
            *a,
            phi_rate,
            wn[0] ** 2 * (command[Channel.PHI] - phi) - 2.0 * zeta[0] * wn[0] * phi_rate,
            theta_rate,
            wn[1] ** 2 * (command[Channel.THETA] - theta) - 2.0 * zeta[1] * wn[1] * theta_rate,
            psi_rate,
            (command[Channel.YAW_RATE] - psi_rate) / tau_yaw,
        ]

    m = [part[i] for part in motion]
    x = [m[0].real, -m[0].imag, m[2], m[1].real, -m[1].imag, m[3], m[4], m[7], m[5], m[8], m[6], m[9]]
    switches = sorted({s + delay_s for s, _ in commands if time_s < s + delay_s < time_s + horizon_s})
    edges = [time_s] + switches + [time_s + horizon_s]
    for begin, end in zip(edges, edges[1:]):
        command = command_at(0.5 * (begin + end))
        x = solve_ivp(slope, (begin, end), x, args=(command,), rtol=1e-9, atol=1e-11).y[:, -1]
    return x


@pytest.mark.parametrize(("horizon_s", "tolerance_m"), [(0.137, 2e-3), (0.34, 8e-3)])
def test_predicts_what_the_nonlinear_model_does(horizon_s, tolerance_m):
    delay_s, now_s = horizon_s - 0.006, 100.0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        motion = random_motion(rng)
        history, commands = random_history(rng, now_s - 0.6, now_s)
        ahead, _ = Predictor(MODEL).ahead(motion, now_s, horizon_s, history, delay_s)
        for i in range(2):
            x = integrate(motion, i, MODEL, now_s, horizon_s, delay_s, commands)
            assert ahead.position_m[i] == pytest.approx(x[0] - 1j * x[1], abs=tolerance_m)
            assert ahead.height_m[i] == pytest.approx(x[2], abs=tolerance_m)
            assert ahead.velocity_m_s[i] == pytest.approx(x[3] - 1j * x[4], abs=10 * tolerance_m)
            assert ahead.climb_m_s[i] == pytest.approx(x[5], abs=10 * tolerance_m)
            # a command that acts up to half a grid step early or late is all that may be wrong with the angles
            assert (ahead.phi_rad[i], ahead.theta_rad[i]) == pytest.approx((x[6], x[8]), abs=5e-3)
            assert ahead.psi_rad[i] == pytest.approx(x[10], abs=5e-3)


def test_loops_are_exact_on_the_grid():
    """Step response of the attitude loop against its closed form, after any number of whole steps."""
    wn, zeta = ARDRONE.roll.natural_frequency_rad_s, ARDRONE.roll.damping_ratio
    history = CommandHistory(2)
    history.append(0.0, np.full((2, 4), 0.1))
    zero = np.zeros(2)
    rest = Motion(zero + 0j, zero + 0j, zero, *[zero] * 7)
    for horizon_s in (0.1, 0.35, 0.8):
        ahead, _ = Predictor(MODEL).ahead(rest, 0.2, horizon_s, history, 0.2)
        damped = wn * math.sqrt(1.0 - zeta**2)
        decay = math.exp(-zeta * wn * horizon_s)
        step = 1.0 - decay * (math.cos(damped * horizon_s) + zeta * wn / damped * math.sin(damped * horizon_s))
        assert ahead.phi_rad[0] == pytest.approx(0.1 * step, abs=1e-12)
        assert ahead.climb_m_s[0] == pytest.approx(0.1 * (1 - math.exp(-horizon_s / ARDRONE.climb_time_constant_s)))


@pytest.mark.parametrize(
    ("psi_deg", "channel", "north", "east"),
    [
        (0, Channel.THETA, -1, 0),
        (0, Channel.PHI, 0, 1),
        (90, Channel.THETA, 0, -1),
        (90, Channel.PHI, -1, 0),
        (180, Channel.PHI, 0, -1),
        (-135, Channel.THETA, math.sqrt(0.5), math.sqrt(0.5)),
    ],
)
def test_where_a_positive_angle_goes(psi_deg, channel, north, east):
    """Nose up goes backwards, right wing down goes right, at any yaw."""
    command = np.zeros((2, 4))
    command[:, channel] = 0.1
    history = CommandHistory(2)
    history.append(0.0, command)
    zero = np.zeros(2)
    rest = Motion(zero + 0j, zero + 0j, zero, zero, zero, zero, zero + math.radians(psi_deg), zero, zero, zero)
    ahead, _ = Predictor(MODEL).ahead(rest, 1.0, 0.3, history, 0.1)
    assert ahead.velocity_m_s[0] / abs(ahead.velocity_m_s[0]) == pytest.approx(north + 1j * east, abs=1e-9)


def test_hover_stays():
    zero = np.zeros(2)
    rest = Motion(zero + (0.3 - 0.2j), zero + 0j, zero + 1.0, *[zero] * 7)
    ahead, a_up = Predictor(MODEL).ahead(rest, 5.0, 0.2, CommandHistory(2), 0.13)
    for before, after in zip(rest, ahead):
        assert after == pytest.approx(before, abs=1e-15)
    assert a_up == pytest.approx([0.0, 0.0])


def test_commands_count_from_when_they_act():
    history = CommandHistory(2)
    history.append(1.0, np.full((2, 4), 0.1))
    zero = np.zeros(2)
    rest = Motion(zero + 0j, zero + 0j, zero, *[zero] * 7)
    before, _ = Predictor(MODEL).ahead(rest, 1.0, 0.1, history, 0.1)
    after, _ = Predictor(MODEL).ahead(rest, 1.0, 0.15, history, 0.1)
    assert before.phi_rad[0] == 0.0 < after.phi_rad[0]


def test_horizon_between_grid_points_is_smooth():
    rng = np.random.default_rng(5)
    motion, (history, _) = random_motion(rng), random_history(rng, 0.0, 1.0)
    predictor = Predictor(MODEL)
    positions = [predictor.ahead(motion, 1.0, h, history, 0.13)[0].position_m[0] for h in np.arange(0.1, 0.2, 0.0005)]
    assert np.abs(np.diff(positions, 2)).max() < 2e-5


@pytest.mark.parametrize("horizon_s", [-0.01, MAX_HORIZON_S + 0.1, math.nan])
def test_impossible_horizons(horizon_s):
    zero = np.zeros(2)
    with pytest.raises(ValueError, match="prediction horizon"):
        Predictor(MODEL).ahead(Motion(*[zero] * 10), 0.0, horizon_s, CommandHistory(2), 0.1)


def test_history_holds_replaces_and_never_grows():
    history = CommandHistory(1)
    assert history.at(np.array([-5.0]))[0].tolist() == [[0.0] * 4]
    for k in range(10000):
        history.append(0.005 * k, np.full((1, 4), float(k)))
    assert history.at(np.array([49.9951, 49.996, 49.9949, 60.0]))[:, 0, 0].tolist() == [9999, 9999, 9998, 9999]
    history.append(49.99, np.full((1, 4), -1.0))
    assert history.at(np.array([49.981, 49.999]))[:, 0, 0].tolist() == [9996, -1], "the clock was set back"
    history.clear()
    assert history.at(np.array([49.98]))[0, 0, 0] == 0.0


def test_observer_knows_the_rate_from_noisy_angles():
    """Better than the measured angles, without lag in the rate: 0.3 degree of noise, known commands."""
    model = NominalModel.of([ARDRONE])
    observer = TiltObserver(model, 0.005, 0.6)
    A, b = (part[:, :2] for part in model.loops())
    phi, gamma = discretised(A, b, 0.005)
    rng, truth = np.random.default_rng(0), np.zeros((1, 2, 2))
    angle_errors, rate_errors = [], []
    for k in range(1500):
        command = 0.1 * np.sin(2.0 * 0.005 * k + np.array([[0.0, 1.0]]))
        truth = np.matmul(phi, truth[..., None])[..., 0] + gamma * command[..., None]
        measured = truth[..., 0] + 0.005 * rng.standard_normal((1, 2))
        seen = np.array([k % 50 != 7])  # a frame is lost now and then
        angles, rates = observer.update(0.005 * k, measured, np.zeros((1, 2)), command, seen)
        if k > 300 and seen[0]:
            angle_errors.append(angles - truth[..., 0])
            rate_errors.append(rates - truth[..., 1])
    assert np.std(angle_errors) < 0.0025 and abs(np.mean(angle_errors)) < 5e-4
    assert np.std(rate_errors) < 0.06


def test_observer_starts_from_the_measurement_and_again_after_a_gap():
    observer = TiltObserver(NominalModel.of([ARDRONE]), 0.005, 0.6)
    seen, command = np.array([True]), np.zeros((1, 2))
    for time_s in (10.0, 10.5):
        angles, rates = observer.update(time_s, np.array([[0.1, -0.1]]), np.array([[0.3, 0.2]]), command, seen)
        assert angles.tolist() == [[0.1, -0.1]] and rates.tolist() == [[0.3, 0.2]]
        observer.update(time_s + 0.005, np.array([[0.0, 0.0]]), np.zeros((1, 2)), command, seen)


def test_effective_delay():
    assert effective_delay_s(ARDRONE) == pytest.approx(0.1 + 1.0 / 30.0)
    assert effective_delay_s(ARDRONE, 0.3) == pytest.approx(0.3 + 1.0 / 30.0)
    for wrong in (-0.1, 2.0, math.nan):
        with pytest.raises(ValueError, match="command delay must be from 0"):
            effective_delay_s(ARDRONE, wrong)
