"""frames.py: each axis of each conversion, and the relations between them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from risc_lab import frames

ONE_TWO_THREE = np.array([1.0, 2.0, 3.0])
angles = st.floats(-np.pi, np.pi)
pitches = st.floats(-1.5, 1.5)


def test_each_axis_of_the_flip():
    assert frames.frd_to_flu(ONE_TWO_THREE).tolist() == [1.0, -2.0, -3.0]
    assert frames.frd_to_flu(np.tile(ONE_TWO_THREE, (4, 2, 1))).shape == (4, 2, 3)


@pytest.mark.parametrize(
    ("phi", "theta", "psi", "body", "ned"),
    [
        (0.0, 0.0, np.pi / 2, [1, 0, 0], [0, 1, 0]),  # yawed clockwise by 90 degrees the nose points East
        (0.0, np.pi / 6, 0.0, [1, 0, 0], [np.cos(np.pi / 6), 0, -0.5]),  # nose up: North and up
        (np.pi / 6, 0.0, 0.0, [0, 1, 0], [0, np.cos(np.pi / 6), 0.5]),  # right wing down: East and down
    ],
)
def test_signs_of_the_angles(phi, theta, psi, body, ned):
    np.testing.assert_allclose(frames.rotation_body_to_ned(phi, theta, psi) @ body, ned, atol=1e-15)


def test_nose_and_wing_in_cortex_axes_as_the_legacy_reference_says():
    psi = 0.7
    R = frames.rotation_body_to_cortex(0.0, 0.0, psi)
    np.testing.assert_allclose(R @ [1, 0, 0], [np.cos(psi), -np.sin(psi), 0], atol=1e-15)
    np.testing.assert_allclose(R @ [0, -1, 0], [np.sin(psi), np.cos(psi), 0], atol=1e-15)


@given(angles, pitches, angles)
def test_rotation_matches_scipy_and_inverts(phi, theta, psi):
    R = frames.rotation_body_to_ned(phi, theta, psi)
    np.testing.assert_allclose(R, Rotation.from_euler("ZYX", [psi, theta, phi]).as_matrix(), atol=1e-12)
    back = frames.rotation_body_to_ned(*frames.euler_from_body_to_ned(R))
    np.testing.assert_allclose(back, R, atol=1e-12)


@pytest.mark.parametrize("theta", [np.pi / 2, -np.pi / 2])
def test_nose_straight_up_or_down_gives_finite_angles_of_the_same_rotation(theta):
    exact = np.round(frames.rotation_body_to_ned(0.0, theta, 0.0))
    for R in (
        exact,
        frames.rotation_body_to_ned(0.3, theta, -0.8),
        exact @ Rotation.from_rotvec([0.4, 0, 0]).as_matrix(),
    ):
        angles_rad = frames.euler_from_body_to_ned(R)
        assert np.all(np.isfinite(angles_rad))
        np.testing.assert_allclose(frames.rotation_body_to_ned(*angles_rad), R, atol=1e-12)


@given(angles, pitches, st.floats(-5, 5), st.floats(-5, 5), st.floats(-5, 5))
def test_euler_rates_and_body_rates_invert_each_other(phi, theta, p, q, r):
    euler = frames.euler_rates_from_body_rates(phi, theta, p, q, r)
    np.testing.assert_allclose(frames.body_rates_from_euler_rates(phi, theta, *euler), [p, q, r], atol=1e-9)


def test_euler_rates_are_the_derivative_of_the_angles():
    phi, theta, psi, rates, dt = 0.3, -0.4, 1.2, np.array([0.5, -0.7, 0.9]), 1e-6
    R = Rotation.from_matrix(frames.rotation_body_to_ned(phi, theta, psi))
    moved = frames.euler_from_body_to_ned((R * Rotation.from_rotvec(rates * dt)).as_matrix())
    numeric = (np.array(moved) - [phi, theta, psi]) / dt
    np.testing.assert_allclose(frames.euler_rates_from_body_rates(phi, theta, *rates), numeric, atol=1e-5)


def test_euler_rates_do_not_exist_with_the_nose_straight_up():
    with pytest.raises(ValueError, match="90 degrees"):
        frames.euler_rates_from_body_rates(0.0, np.pi / 2, 0.0, 0.0, 1.0)


@given(st.floats(-100, 100))
def test_wrap_angle_keeps_the_direction_and_the_range(angle):
    wrapped = frames.wrap_angle(angle)
    assert -np.pi < wrapped <= np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-9)


def test_wrap_angle_at_the_seam():
    assert frames.wrap_angle(np.pi) == np.pi
    assert frames.wrap_angle(-np.pi) == np.pi
    assert frames.wrap_angle(0.0) == 0.0
