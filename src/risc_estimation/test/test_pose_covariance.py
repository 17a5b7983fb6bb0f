"""Raw poses: what leaves the first stage, and its covariance against Monte Carlo and against the printed formula."""

import numpy as np
import pytest
from mocap_frames import pack_bodies
from scipy.spatial.transform import Rotation

from risc_estimation.filters import make_filter
from risc_estimation.pose_fit import PoseFit, PoseFitParams
from risc_estimation.state_estimator import StatesEstimator
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.templates import load_templates

TEMPLATES = load_templates()
NOISE_M = 0.002
ANGLES_RAD = (0.3, -0.2, 2.0)
PLACE_M = np.array([0.4, -0.3, 1.2])


def seen(name, rng=None, hidden=()):
    """Markers of a body at PLACE_M, as dict, with noise if there is a generator."""
    hull = TEMPLATES[name].markers_m
    markers = PLACE_M + hull @ rotation_body_to_cortex(*ANGLES_RAD).T
    if rng is not None:
        markers = markers + rng.normal(0.0, NOISE_M, hull.shape)
    markers[list(hidden)] = np.nan
    return {name: markers}


def fit(bodies, params=None):
    stage = PoseFit(TEMPLATES, params)
    stage.update(1.0, *pack_bodies(bodies))
    return stage.poses


@pytest.mark.parametrize(
    ("name", "hidden"), [("fluffy_II", ()), ("fluffy_II", (3,)), ("IRIS", ()), ("IRIS", (0, 4)), ("Pendulum_tip", ())]
)
def test_covariance_is_that_of_many_fits(name, hidden):
    """4000 fits. Standard deviations within 5 %, correlations within 0.06; three standard errors are 3.4 % and 0.05."""
    rng, errors = np.random.default_rng(3), []
    R, stage = rotation_body_to_cortex(*ANGLES_RAD), PoseFit(TEMPLATES)
    for k in range(4000):
        stage.update(k, *pack_bodies(seen(name, rng, hidden)))
        turn = Rotation.from_matrix(stage.poses.rotation[0] @ R.T).as_rotvec()
        errors.append(np.concatenate([stage.poses.position_m[0] - PLACE_M, turn]))
    sampled = np.cov(np.array(errors).T)
    expected = fit(seen(name, hidden=hidden)).covariances()[0]
    deviation = np.sqrt(np.diag(expected))
    assert np.sqrt(np.diag(sampled)) == pytest.approx(deviation, rel=0.05)
    assert sampled / np.outer(deviation, deviation) == pytest.approx(
        expected / np.outer(deviation, deviation), abs=0.06
    )
    assert np.array_equal(expected, expected.T) and np.linalg.eigvalsh(expected).min() > 0.0


def test_covariance_is_the_inverse_of_the_information():
    expected = np.zeros((6, 6))
    for arm in TEMPLATES["IRIS"].markers_m @ rotation_body_to_cortex(*ANGLES_RAD).T:
        x, y, z = arm
        J = np.hstack([np.eye(3), -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])])
        expected += J.T @ J / NOISE_M**2
    np.testing.assert_allclose(fit(seen("IRIS")).covariances()[0] @ expected, np.eye(6), atol=1e-9)


def test_noise_may_come_from_the_residual():
    """Its mean square over 3n - 6 degrees of freedom is that of the markers: 600 fits of 9 each, 5 % is two sigma."""
    rng, params = np.random.default_rng(4), PoseFitParams(marker_noise_m=0.0)
    found = np.mean([fit(seen("IRIS", rng), params).covariances()[0] for _ in range(600)], axis=0)
    assert np.trace(found) == pytest.approx(np.trace(fit(seen("IRIS")).covariances()[0]), rel=0.05)


def test_a_marker_that_was_left_out_is_not_counted():
    ghost = seen("IRIS")
    ghost["IRIS"][2] += [0.2, 0.1, 0.0]
    np.testing.assert_allclose(fit(ghost).covariances(), fit(seen("IRIS", hidden=(2,))).covariances(), rtol=1e-9)


def test_raw_poses_do_not_depend_on_the_filter_and_keep_their_stamp():
    """`smooth_position` is what the controller gets; the raw pose is there beside it, either way."""
    rng = np.random.default_rng(5)
    smoothed, raw = (
        StatesEstimator(
            TEMPLATES, velocity_filter=make_filter(given={"smooth_position": smooth, "smooth_angles": smooth})
        )
        for smooth in (True, False)
    )
    for k in range(40):
        bodies = pack_bodies(seen("fluffy_II", rng))
        a, b = smoothed.update(0.005 * k, *bodies), raw.update(0.005 * k, *bodies)
        assert np.array_equal(smoothed.poses.position_m, raw.poses.position_m)
        assert np.array_equal(smoothed.poses.angles_rad, raw.poses.angles_rad)
        assert smoothed.poses.residual_m[0] > 0.0 and smoothed.poses.stamps_s[0] == smoothed.poses.stamp_s == a.stamp_s
    assert np.array_equal(b.states[0, :3], raw.poses.position_m[0])
    assert not np.array_equal(a.states[0, :3], smoothed.poses.position_m[0])
    kept = smoothed.poses.position_m.copy()
    smoothed.update(1.0, (), np.zeros((0, 3)))
    poses = smoothed.poses
    assert (poses.stamp_s, poses.stamps_s[0], poses.present[0], poses.inside[0]) == (1.0, 0.005 * 39, False, False)
    assert np.array_equal(poses.position_m, kept) and np.isnan(poses.covariances()).all()
