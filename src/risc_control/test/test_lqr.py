"""LQR gains: known solutions, stability, and errors that say what is wrong."""

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from risc_control.lqr import lqi_gain, lqr_gain

DOUBLE = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])


def test_double_integrator_has_its_closed_form():
    """kp = sqrt(q_pos), kd = sqrt(q_vel + 2 kp): the gains of the original's LQR_DF node."""
    K = lqr_gain(*DOUBLE, [17.22, 1.62], [1.0])
    assert K[0] == pytest.approx([np.sqrt(17.22), np.sqrt(1.62 + 2.0 * np.sqrt(17.22))], rel=1e-9)
    assert K[0] == pytest.approx([4.15, 3.15], abs=0.01)


def test_gain_is_optimal_and_stable():
    rng = np.random.default_rng(3)
    A, B = rng.standard_normal((5, 5)), rng.standard_normal((5, 2))
    Q, R = np.diag(rng.uniform(0.5, 2.0, 5)), np.diag([1.0, 3.0])
    K = lqr_gain(A, B, Q, R)

    def cost(gain):
        closed = A - B @ gain
        assert np.linalg.eigvals(closed).real.max() < 0.0
        return np.trace(solve_continuous_lyapunov(closed.T, -(Q + gain.T @ R @ gain)))

    best = cost(K)
    for _ in range(5):
        assert cost(K + 0.02 * rng.standard_normal(K.shape)) > best


def test_integral_removes_a_constant_disturbance():
    A, B = np.array([[0, 1, 0], [0, 0, 1], [0, 0, 0]]), np.array([[0], [0], [1]])
    K = lqi_gain(*DOUBLE, 1.0, [2.0, 1.0], [1.0])
    assert np.array_equal(K, lqr_gain(A, B, [1.0, 2.0, 1.0], [1.0]))
    assert lqi_gain(*DOUBLE, 0.0, [2.0, 1.0], [1.0]).tolist() == [[0.0, *lqr_gain(*DOUBLE, [2.0, 1.0], [1.0])[0]]]
    at_rest = np.linalg.solve(A - B @ K, -np.array([0.0, 0.0, 0.7]))  # disturbance on the acceleration
    assert at_rest[1] == pytest.approx(0.0, abs=1e-12) and abs(at_rest[0]) > 0.1


@pytest.mark.parametrize(
    ("A", "B", "Q", "R", "message"),
    [
        (np.diag([1.0, -1.0]), [[0.0], [1.0]], [1.0, 1.0], [1.0], "no input .* eigenvalue 1"),
        (*DOUBLE, [0.0, 1.0], [1.0], "no weight in Q .* eigenvalue 0"),
        (*DOUBLE, [1.0, -1.0], [1.0], "Q .* negative"),
        (*DOUBLE, [1.0, 1.0], [0.0], "R must be positive"),
        (*DOUBLE, [1.0, np.nan], [1.0], ".+"),
        (*DOUBLE, [[1.0, 0.5], [0.0, 1.0]], [1.0], "symmetric"),
        (np.eye(3), [[0.0], [1.0]], [1.0, 1.0], [1.0], ".+"),
    ],
)
def test_what_has_no_solution_says_why(A, B, Q, R, message):
    with pytest.raises(ValueError, match=message):
        lqr_gain(A, B, Q, R)
