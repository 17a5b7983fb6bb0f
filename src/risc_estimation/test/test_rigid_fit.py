"""Rigid fits: exact, against scipy, with missing and wrong markers, on degenerate geometry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from risc_estimation.rigid_fit import TemplateStack, fit_rigid, fit_without_worst

SQUARE = np.array([[0.2, 0.2, 0.0], [0.2, -0.2, 0.0], [-0.2, 0.2, 0.0]])
HULL = np.vstack([SQUARE, [-0.12, -0.2, -0.08]])
IRIS = np.array([[0.18, 0.18, 0.0], [-0.18, -0.18, 0.0], [-0.18, 0.18, 0.0], [0.14, -0.2, 0.0], [0.0, 0.0, -0.05]])


def padded(stack, clouds):
    """(bodies, markers, 3) array for a stack."""
    frame = np.zeros(stack.shape + (3,))
    for row, cloud in enumerate(clouds):
        frame[row, : len(cloud)] = cloud
    return frame


@settings(max_examples=100, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_exact_for_any_pose_and_mixed_marker_counts(seed):
    rng = np.random.default_rng(seed)
    templates = [SQUARE, HULL, IRIS]
    stack = TemplateStack(templates)
    rotations = Rotation.random(3, random_state=seed).as_matrix()
    positions = rng.uniform(-3.0, 3.0, (3, 3))
    fit = fit_rigid(stack, padded(stack, [t @ R.T + p for t, R, p in zip(templates, rotations, positions)]))
    assert fit.rotations == pytest.approx(rotations, abs=1e-9)
    assert fit.positions == pytest.approx(positions, abs=1e-12)
    assert fit.residuals_m == pytest.approx(np.zeros(3), abs=1e-12)
    assert (fit.spreads_m > 0.1).all()
    assert np.linalg.det(fit.rotations) == pytest.approx(np.ones(3))


def test_noisy_fit_equals_scipy_and_the_residual_is_the_rms_distance():
    rng = np.random.default_rng(2)
    for template in (SQUARE, HULL, IRIS):
        stack = TemplateStack([template])
        measured = template @ Rotation.random(random_state=5).as_matrix().T + [1.0, -2.0, 0.5]
        measured = measured + rng.normal(0.0, 0.002, template.shape)
        fit = fit_rigid(stack, measured[None])
        reference, _ = Rotation.align_vectors(measured - measured.mean(axis=0), template - template.mean(axis=0))
        assert fit.rotations[0] == pytest.approx(reference.as_matrix(), abs=1e-9)
        errors = measured - (template @ fit.rotations[0].T + fit.positions[0])
        assert fit.residuals_m[0] == pytest.approx(np.sqrt((errors**2).sum(axis=1).mean()))


def test_hidden_markers_do_not_count():
    stack = TemplateStack([HULL, IRIS])
    frame = padded(stack, [HULL + 1.0, IRIS - 1.0])
    visible = stack.defined.copy()
    visible[0, 2] = visible[1, 0] = visible[1, 3] = False
    frame[~visible] = 0.0
    fit = fit_rigid(stack, frame, visible)
    assert fit.positions == pytest.approx(np.array([[1.0] * 3, [-1.0] * 3]), abs=1e-12)
    assert fit.rotations == pytest.approx(np.tile(np.eye(3), (2, 1, 1)), abs=1e-12)
    assert fit.residuals_m == pytest.approx([0.0, 0.0], abs=1e-12)
    rows = fit_rigid(stack, frame[[1]], visible[[1]], np.array([1]))
    assert rows.positions == pytest.approx(fit.positions[[1]], abs=1e-12)


@pytest.mark.parametrize(
    "cloud",
    [
        np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.3, 0.0, 0.0]]),  # on one line
        np.zeros((3, 3)),  # all in one place
    ],
)
def test_collinear_markers_have_no_spread(cloud):
    fit = fit_rigid(TemplateStack([cloud]), cloud[None] + 1.0)
    assert fit.spreads_m[0] < 1e-6
    assert np.isfinite(fit.rotations).all()
    measured_on_a_line = fit_rigid(TemplateStack([SQUARE]), cloud[None])
    assert measured_on_a_line.spreads_m[0] < 1e-6


def test_hull_minus_any_marker_still_has_spread():
    stack = TemplateStack([HULL])
    for hidden in range(4):
        visible = np.ones((1, 4), dtype=bool)
        visible[0, hidden] = False
        assert fit_rigid(stack, HULL[None] * visible[:, :, None], visible).spreads_m[0] > 0.1


@pytest.mark.parametrize("wrong", range(4))
def test_ghost_marker_is_found_and_left_out(wrong):
    measured = HULL + [0.5, 0.5, 1.0]
    measured[wrong] += [0.0, 0.1, 0.15]
    stack = TemplateStack([SQUARE, HULL])
    assert fit_rigid(TemplateStack([HULL]), measured[None]).residuals_m[0] > 0.015
    fit, left_out = fit_without_worst(stack, 1, measured, np.ones(4, dtype=bool))
    assert left_out == wrong
    assert fit.residuals_m[0] == pytest.approx(0.0, abs=1e-9)
    assert fit.positions[0] == pytest.approx([0.5, 0.5, 1.0], abs=1e-9)


def test_leaving_out_needs_four():
    with pytest.raises(ValueError, match="needs 4 visible markers"):
        fit_without_worst(TemplateStack([SQUARE]), 0, SQUARE, np.ones(3, dtype=bool))


def test_no_bodies_is_fine():
    stack = TemplateStack([HULL])
    fit = fit_rigid(stack, np.zeros((0, 4, 3)), np.zeros((0, 4), dtype=bool), np.zeros(0, dtype=int))
    assert fit.positions.shape == (0, 3)
