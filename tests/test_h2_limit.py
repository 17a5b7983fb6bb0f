"""The least error in gusts: against closed forms, against a simulation of the optimal loop, and its trends."""

import math
from dataclasses import replace

import h2_limit
import numpy as np
import pytest
from h2_limit import Axis, axes_of, gust_limit_m, optimal_gain, rms, sampled_loop, trade
from scipy.linalg import expm

from risc_lab.lab import load_vehicle_type

DRONE = replace(load_vehicle_type("ardrone"), command_delay_s=0.1)
POSE = np.diag([0.001**2] * 3 + [0.008**2] * 3)  # about what 2 mm markers give
GUST_M_S2, GUST_S = 0.1, 0.5


def limit_m(kind=DRONE, pose=POSE, gust_m_s2=GUST_M_S2, gust_s=GUST_S, **rest):
    return gust_limit_m(kind, pose, gust_m_s2, gust_s, **rest)


def integrator(order, density, noise):
    """`order` integrators behind a force with white noise; the position is measured, or all when noise is 0."""
    H = np.eye(order) if noise == 0.0 else np.eye(1, order)
    R = np.eye(len(H)) * (noise**2 or 1e-16)
    return Axis(math.inf, np.eye(order, k=1), np.eye(order)[-1], density * np.eye(order)[-1], H, R)


def least(axis, delay_s, hold_s, frame_s):
    return rms(axis, optimal_gain(axis, hold_s), delay_s, hold_s, frame_s)[0]


@pytest.mark.parametrize("delay_s, hold_s", [(0.0, 0.1), (0.3, 0.1), (0.05, 1.0)])
def test_of_an_integrator_whose_state_is_known(delay_s, hold_s):
    """The Riccati equation of the sampled integrator has the solution T/sqrt(12): q^2 (delay + T/2 + T/sqrt(12))."""
    exact = 0.2 * math.sqrt(delay_s + hold_s / 2.0 + hold_s / math.sqrt(12.0))
    assert least(integrator(1, 0.2, 0.0), delay_s, hold_s, 0.01) == pytest.approx(exact, rel=2e-3)


def test_of_a_double_integrator_whose_state_is_known():
    """Without weight and hold the variance is that of what happens in the delay: q^2 delay^3 / 3."""
    exact = 0.2 * math.sqrt(0.3**3 / 3.0)
    assert least(integrator(2, 0.2, 0.0), 0.3, 1e-3, 1e-3) == pytest.approx(exact, rel=0.02)


def test_of_a_double_integrator_without_delay():
    """Without weight and hold the error is that of the filter: variance sqrt(2) q^(1/2) r^(3/4), r: noise density."""
    density, noise, frame_s = 0.2, 0.01, 1e-4
    exact = math.sqrt(math.sqrt(2.0) * math.sqrt(density) * (noise**2 * frame_s) ** 0.75)
    assert least(integrator(2, density, noise), 0.0, frame_s, frame_s) == pytest.approx(exact, rel=0.03)


def simulated_rms(axis, K, delay_frames, hold_frames, frame_s, seconds=400.0, seed=1, doubt=0.0):
    """RMS error of the simulated loop; its filter knows which commands are on their way, and predicts with them."""
    _, A, b, g, H, R = axis
    n, rng = len(b), np.random.default_rng(seed)
    both = expm(frame_s * np.block([[A, b[:, None]], [np.zeros((1, n + 1))]]))
    Phi, Gamma = both[:n, :n], both[:n, n]
    times = np.linspace(0.0, frame_s, 201)[:-1] + frame_s / 400.0
    W = sum(np.outer(v, v) for v in (expm(t * A) @ g for t in times)) * frame_s / len(times)
    W_root = np.linalg.cholesky(W + 1e-24 * np.eye(n))
    P = np.eye(n)
    for _ in range(20000):
        before, P = P, Phi @ P @ Phi.T + W + doubt**2 * frame_s * np.outer(b, b)
        L = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        P = P - L @ H @ P
        if np.abs(P - before).max() < 1e-12 * np.abs(P).max():  # it has settled
            break
    powers = [np.linalg.matrix_power(Phi, k) for k in range(delay_frames + 1)]
    to_come = np.array([power @ Gamma for power in powers[-2::-1]]).reshape(delay_frames, n).T  # effect of each command
    x, known, squares, commands = np.zeros(n), np.zeros(n), 0.0, 0.0
    on_their_way = [0.0] * delay_frames  # the command of each of the next frames
    frames = int(seconds / frame_s)
    noises, errors = rng.standard_normal((frames, n)) @ W_root.T, rng.multivariate_normal(np.zeros(len(R)), R, frames)
    for k in range(frames):
        known = known + L @ (H @ x + errors[k] - H @ known)
        if k % hold_frames == 0:
            ahead = powers[delay_frames] @ known + to_come @ on_their_way
            on_their_way += [-K @ ahead] * hold_frames
        u = on_their_way.pop(0)
        x, known = Phi @ x + Gamma * u + noises[k], Phi @ known + Gamma * u
        squares, commands = squares + x[0] ** 2, commands + u**2
    return math.sqrt(squares / frames), math.sqrt(commands / frames)


def test_of_the_optimal_loop_of_an_ardrone():
    """Simulated for minutes with a queue of commands; another gain is worse."""
    forward, frame_s, hold_frames, delay_frames = axes_of(DRONE, POSE, GUST_M_S2, GUST_S)[0], 0.005, 7, 21
    hold_s, delay_s = hold_frames * frame_s, delay_frames * frame_s
    K = optimal_gain(forward, hold_s)
    for gain in (K, optimal_gain(forward, hold_s, 1e-4)):
        found = rms(forward, gain, delay_s, hold_s, frame_s)
        assert simulated_rms(forward, gain, delay_frames, hold_frames, frame_s) == pytest.approx(found, rel=0.06)
    for other in (0.998 * K, 1.002 * K, optimal_gain(forward, hold_s, 1e-11), optimal_gain(forward, hold_s, 1e-4)):
        assert rms(forward, other, delay_s, hold_s, frame_s)[0] > rms(forward, K, delay_s, hold_s, frame_s)[0]
    with pytest.raises(ValueError, match="not stable"):
        rms(forward, -K, delay_s, hold_s, frame_s)


def test_with_commands_that_a_vehicle_obeys_it_is_larger():
    any_size, thirds, tenths = (limit_m(sigmas=sigmas) for sigmas in (0.0, 3.0, 10.0))
    assert any_size < thirds < tenths
    assert limit_m(sigmas=1e-3) == any_size, "as large as it takes"
    timid = replace(DRONE, tilt_max_rad=0.3 * DRONE.tilt_max_rad, climb_max_m_s=0.3 * DRONE.climb_max_m_s)
    assert limit_m(timid, sigmas=3.0) == pytest.approx(tenths, rel=1e-3)
    forward = axes_of(DRONE, POSE, GUST_M_S2, GUST_S)[0]
    assert forward.full_scale_m_s2 == pytest.approx(9.81 * 1.10714 * 0.349066, rel=1e-3)


@pytest.mark.parametrize("holds_late", [0, 1, 3])
def test_the_sensitivity_of_a_sampled_integrator(holds_late):
    """u = -K x of the predicted state: c = -K (x + T (sum of the commands on their way)), x = T/(z - 1) (c + d)."""
    K, T = 4.0, 0.1
    z = np.exp(1j * T * np.geomspace(0.1, math.pi / T, 1000))
    on_their_way = sum(z**-k for k in range(1, holds_late + 1)) if holds_late else 0.0
    L = K * T * z**-holds_late / (z - 1.0) / (1.0 + K * T * on_their_way)
    error, found = sampled_loop(integrator(1, 0.2, 0.0), np.array([K]), 0.0, holds_late * T, T, T / 4)
    assert found == pytest.approx(np.abs(1.0 / (1.0 + L)).max(), rel=1e-3)
    assert error == pytest.approx(rms(integrator(1, 0.2, 0.0), np.array([K]), holds_late * T, T, T / 4)[0], rel=0.05)


def test_a_doubting_filter_makes_a_loop_robust_and_less_accurate():
    """Without doubt it is the optimal one; the same loop step by step, with other noise, has the same error."""
    forward, frame_s, hold_frames, delay_frames = axes_of(DRONE, POSE, GUST_M_S2, GUST_S)[0], 0.005, 7, 21
    times, K = (delay_frames * frame_s, hold_frames * frame_s, frame_s), optimal_gain(forward, 7 * frame_s, 2e-3)
    found = [sampled_loop(forward, K, doubt, *times) for doubt in (0.0, 0.1, 0.3)]
    assert found[0][0] == pytest.approx(rms(forward, K, *times)[0], rel=0.02)
    errors_m, sensitivities = zip(*found)
    assert (np.diff(errors_m) > 0.0).all() and (np.diff(sensitivities) < 0.0).all()
    assert simulated_rms(forward, K, delay_frames, hold_frames, frame_s, 300.0, doubt=0.3)[0] == pytest.approx(
        errors_m[-1], rel=0.08
    )
    with pytest.raises(ValueError, match="not stable"):
        sampled_loop(forward, -K, 0.1, *times)


def test_margins_cost_accuracy():
    curve = trade(DRONE, POSE, GUST_M_S2, GUST_S, 0.006)
    most, errors_m = zip(*curve)
    assert (np.diff(most) > 0.0).all() and (np.diff(errors_m) < 0.0).all()
    assert limit_m(latency_s=0.006) < errors_m[-1] < 0.5 * errors_m[0] < math.inf


def test_it_hardly_depends_on_what_is_chosen_small(monkeypatch):
    found = limit_m()
    for name, other in ("_LEAST_WEIGHT", 1e-18), ("_LEAST_WEIGHT", 1e-14), ("_INSTANTS", 40):
        with monkeypatch.context() as changed:
            changed.setattr(h2_limit, name, other)
            assert limit_m() == pytest.approx(found, rel=5e-3)


def test_more_of_anything_bad_is_worse():
    for worse in (
        [limit_m(replace(DRONE, command_delay_s=delay_s)) for delay_s in (0.0, 0.02, 0.1, 0.3)],
        [limit_m(latency_s=latency_s) for latency_s in (0.0, 0.006, 0.05)],
        [limit_m(replace(DRONE, command_rate_hz=rate_hz)) for rate_hz in (200.0, 60.0, 30.0, 10.0)],
        [limit_m(frame_s=frame_s) for frame_s in (0.001, 0.005, 0.02)],
        [limit_m(pose=factor**2 * POSE) for factor in (0.3, 1.0, 3.0)],
        [limit_m(gust_m_s2=gust_m_s2) for gust_m_s2 in (0.0, 0.05, 0.1, 0.4)],
    ):
        assert (np.diff(worse) > 0.0).all(), worse


def test_of_small_noise_it_grows_with_the_gust_and_without_gusts_it_is_nothing():
    assert limit_m(gust_m_s2=0.0) == 0.0
    one, two = (limit_m(pose=1e-6 * POSE, gust_m_s2=gust_m_s2) for gust_m_s2 in (0.1, 0.2))
    assert two == pytest.approx(2.0 * one, rel=0.05)


def test_how_position_and_angle_err_together_matters_with_its_sense():
    """Errors of position that are correlated with those of the tilt, each axis with the right sign."""
    pitch, roll = POSE.copy(), POSE.copy()
    pitch[0, 4] = pitch[4, 0] = roll[1, 3] = roll[3, 1] = 0.9 * 0.001 * 0.008
    (_, left, up), (ahead, _, _), (_, turned, _) = (axes_of(DRONE, C, 0.1, 0.5) for C in (POSE, pitch, roll))
    assert ahead.R[0, 1] == pitch[0, 4] and ahead.H[1, 2] == 1.0
    assert turned.R[0, 1] == roll[1, 3] and turned.H[1, 2] == left.H[1, 2] == -1.0
    assert up.H.shape == (1, 3)


def test_an_iris_is_held_better_than_an_ardrone():
    """It takes commands sooner, more often, and tilts faster."""
    assert 0.0 < limit_m(load_vehicle_type("iris")) < limit_m()


@pytest.mark.parametrize(
    "wrong", [{"gust_m_s2": -1.0}, {"sigmas": -1.0}, {"gust_s": 0.0}, {"frame_s": 0.0}, {"latency_s": -1e-3}]
)
def test_what_cannot_be_is_refused(wrong):
    with pytest.raises(ValueError, match="must be"):
        limit_m(**wrong)
