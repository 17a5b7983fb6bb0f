"""Rigid fits: exact, against scipy, with missing and wrong markers, on degenerate geometry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from risc_estimation.body_fit import NONE, fit_some_markers
from risc_estimation.pose_fit import PoseFitParams
from risc_estimation.rigid_fit import POSE, WORK, fit_pose

SQUARE = np.array([[0.2, 0.2, 0.0], [0.2, -0.2, 0.0], [-0.2, 0.2, 0.0]])
HULL = np.vstack([SQUARE, [-0.12, -0.2, -0.08]])
IRIS = np.array([[0.18, 0.18, 0.0], [-0.18, -0.18, 0.0], [-0.18, 0.18, 0.0], [0.14, -0.2, 0.0], [0.0, 0.0, -0.05]])


def fit_rigid(template, measured, visible=None):
    """The POSE of a fit."""
    visible, poses = np.ones(len(template), dtype=bool) if visible is None else visible, np.zeros(1, dtype=POSE)
    fit_pose(np.array(template), np.array(measured), visible, np.zeros(1, dtype=WORK)[0], poses[0])
    return poses[0]


def random_rotation(seed):
    return Rotation.random(random_state=seed).as_matrix()


@settings(max_examples=100, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_exact_for_any_pose(seed):
    R, p = random_rotation(seed), np.random.default_rng(seed).uniform(-3.0, 3.0, 3)
    for template in (SQUARE, HULL, IRIS):
        fit = fit_rigid(template, template @ R.T + p)
        assert fit.rotation == pytest.approx(R, abs=1e-9)
        assert fit.position_m == pytest.approx(p, abs=1e-12)
        assert fit.residual_m == pytest.approx(0.0, abs=1e-12)
        assert fit.spread_m > 0.1


@settings(max_examples=200, derandomize=True)
@given(seed=st.integers(0, 10**6), noise_m=st.sampled_from([1e-9, 0.002, 0.1, 3.0]), flat=st.booleans())
def test_equals_kabsch_by_numpys_decomposition(seed, noise_m, flat):
    """Any noise, mirror images too. Residual: rms distance; spread: root of the second singular value."""
    rng = np.random.default_rng(seed)
    template = rng.normal(size=(rng.integers(3, 8), 3)) * [1.0, 1.0, 0.0 if flat else 1.0]
    measured = template @ random_rotation(seed).T + rng.normal(0.0, noise_m, template.shape) + rng.normal(size=3)
    if seed % 3 == 0:
        measured *= [1.0, 1.0, -1.0]
    arms, measured_arms = template - template.mean(axis=0), measured - measured.mean(axis=0)
    u, singular, vt = np.linalg.svd(arms.T @ measured_arms)
    R = (u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt).T
    fit = fit_rigid(template, measured)
    assert fit.rotation @ fit.rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(fit.rotation) == pytest.approx(1.0)
    assert fit.spread_m == pytest.approx(np.sqrt(singular[1]), abs=1e-9)
    errors = measured_arms - arms @ R.T
    assert fit.residual_m == pytest.approx(np.sqrt((errors**2).sum(axis=1).mean()), rel=1e-9, abs=1e-12)
    if singular[1] - singular[2] > 1e-3:  # else the best rotation is not unique
        assert fit.rotation == pytest.approx(R, abs=1e-9)


def test_noisy_fit_equals_scipy():
    rng = np.random.default_rng(2)
    for template in (SQUARE, HULL, IRIS):
        measured = template @ random_rotation(5).T + [1.0, -2.0, 0.5]
        measured = measured + rng.normal(0.0, 0.002, template.shape)
        fit = fit_rigid(template, measured)
        reference, _ = Rotation.align_vectors(measured - measured.mean(axis=0), template - template.mean(axis=0))
        assert fit.rotation == pytest.approx(reference.as_matrix(), abs=1e-9)


@pytest.mark.parametrize("hidden", [[2], [0, 3], [1, 4]])
def test_hidden_markers_do_not_count(hidden):
    measured = IRIS @ random_rotation(3).T - 1.0
    measured[hidden] = np.nan
    fit = fit_rigid(IRIS, measured, np.isfinite(measured[:, 0]))
    assert fit.position_m == pytest.approx([-1.0] * 3, abs=1e-12)
    assert fit.rotation == pytest.approx(random_rotation(3), abs=1e-12)
    assert fit.residual_m == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    "cloud",
    [
        np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.3, 0.0, 0.0]]),  # on one line
        np.array([[0.0, 0.0, 0.1], [0.1, 0.2, 0.3], [0.2, 0.4, 0.5]]),
        np.zeros((3, 3)),  # all in one place
    ],
)
def test_collinear_markers_have_no_spread(cloud):
    for template, measured in ((cloud, cloud + 1.0), (SQUARE, cloud), (cloud, SQUARE)):
        fit = fit_rigid(template, measured)
        assert fit.spread_m < 1e-6
        assert fit.rotation @ fit.rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert fit_rigid(cloud, cloud + 1.0).residual_m == pytest.approx(0.0, abs=1e-12)


def test_hull_minus_any_marker_still_has_spread():
    for hidden in range(4):
        assert fit_rigid(HULL, HULL, np.arange(4) != hidden).spread_m > 0.1


@pytest.mark.parametrize("wrong", range(4))
def test_ghost_marker_is_found_and_left_out(wrong):
    measured = HULL + [0.5, 0.5, 1.0]
    measured[wrong] += [0.0, 0.1, 0.15]
    assert fit_rigid(HULL, measured).residual_m > 0.015
    visible, params = np.ones(4, dtype=bool), PoseFitParams()
    fit = params.fixed()["fit"][0]
    assert fit_some_markers(HULL, measured, visible, params.residuals_m(4), False, False, fit) == NONE
    assert visible.tolist() == [marker != wrong for marker in range(4)]
    assert fit.pose.residual_m == pytest.approx(0.0, abs=1e-9)
    assert fit.pose.position_m == pytest.approx([0.5, 0.5, 1.0], abs=1e-9)
