"""The second stage alone, on raw poses: the same states as both stages together make of the markers."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_ekf import DT_S, TEMPLATES, TYPES, Flown

from risc_estimation.filters import COMMAND, make_filter
from risc_estimation.given_poses import GivenPoses, PoseFrame
from risc_estimation.state_estimator import PosesEstimator


def frame_of(poses, order=slice(None)):
    """PoseFrame from `Poses`, with the rows in another order."""
    names = tuple(np.array(poses.names)[order].tolist())
    turns = Rotation.from_matrix(poses.rotation[order]).as_quat()
    rows = (poses.present, poses.inside, poses.stamps_s, poses.position_m)
    return PoseFrame(names, *(row[order] for row in rows), turns, poses.covariances()[order], poses.residual_m[order])


def frame(names, present=True, psi=0.0, covariance=1e-6):
    """PoseFrame of bodies that stand level at a yaw."""
    n = len(names)
    turns = Rotation.from_euler("xyz", np.tile([np.pi, 0.0, -psi], (n, 1))).as_quat()
    known = np.full(n, present)
    covariances = np.tile(covariance * np.eye(6), (n, 1, 1))
    return PoseFrame(tuple(names), known, known, np.zeros(n), np.ones((n, 3)), turns, covariances, np.zeros(n))


@pytest.mark.parametrize("name", TYPES)
def test_the_states_are_those_of_both_stages_together(name):
    """Equal up to rounding, in a flight with false poses, gaps, commands and readings."""
    flown = Flown(21, name)
    second = PosesEstimator(TEMPLATES, [name], make_filter("ekf"), {name: TYPES[name]})
    told = flown.estimator.on_board
    flown.estimator.on_board = lambda *what: [told(*what), second.on_board(*what)]
    rng = np.random.default_rng(5)
    for k in range(400):
        stamp_s, layout, markers_m = flown.step()
        if k % 50 == 49:
            markers_m = markers_m + [0.4, 0.0, 0.0]
        if k % 30 > 25:
            markers_m = np.full_like(markers_m, np.nan)
        if k % 13 == 12:
            flown.estimator.on_board(name, stamp_s, "velocity", rng.normal(0.0, 0.1, 2))
        expected = flown.estimator.update(stamp_s, layout, markers_m)
        found = second.update(stamp_s, frame_of(flown.estimator.poses))
        assert found.stamp_s == expected.stamp_s and found.visible.tolist() == expected.visible.tolist()
        np.testing.assert_allclose(found.states, expected.states, atol=1e-9)
        assert second.status() == flown.estimator.status()
    np.testing.assert_allclose(second.covariances(), flown.estimator.covariances(), rtol=1e-6, atol=1e-12)
    assert second.counters().tolist() == flown.estimator.counters().tolist()
    assert second.counters()["positions_refused"][0] >= 5 and second.counts.frames == 400


def test_late_frames_are_taken_at_their_own_time():
    ends = []
    for late in (False, True):
        flown = Flown(7)
        second = PosesEstimator(TEMPLATES, [flown.name], make_filter("ekf"), {flown.name: TYPES[flown.name]})
        frames = []
        for _ in range(200):
            stamp_s, layout, markers_m = flown.step()
            second.on_board(flown.name, flown.sent_s, COMMAND, flown.sent.at(0, flown.sent_s))
            flown.estimator.update(stamp_s, layout, markers_m)
            frames.append((stamp_s, frame_of(flown.estimator.poses)))
        if late:
            frames = [frames[k] for k in (*range(150), 170, *range(150, 170), *range(171, 200))]
        estimate = None
        for each in frames:
            estimate = second.update(*each) or estimate
        ends.append(estimate.states[0])
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-9)
    assert second.counts.late_frames == 20


def test_bodies_are_found_by_name_and_those_without_a_template_are_counted():
    second = PosesEstimator(TEMPLATES, ["Raven"], make_filter("ekf"))
    for k in range(200):
        names = ["stranger", "fluffy_II", "Raven"]
        estimate = second.update(k * DT_S, frame(names[:: 1 if k % 2 else -1]))
    assert estimate.names == ("Raven", "fluffy_II") and estimate.visible.all()
    np.testing.assert_allclose(estimate.states[:, :3], 1.0, atol=1e-6)
    assert second.counts.unknown == {"stranger": 200}
    with pytest.raises(ValueError, match="'Green_pink' .*template"):
        PosesEstimator(TEMPLATES, ["Green_pink"], make_filter("ekf"))


def test_what_is_not_finite_or_not_there_is_no_pose():
    poses = GivenPoses()
    for name in ("a", "b", "c", "d"):
        poses.add(name, True)
    given = frame(["c", "b", "a"])
    given.positions_m[1, 2], given.quats_xyzw[2] = np.nan, 0.0
    poses.take(1.0, given)
    assert poses.present.tolist() == [False, False, True, False]
    assert np.isnan(poses.covariances()).all(axis=(1, 2)).tolist() == [True, True, False, True]
    poses.take(2.0, frame(["c"], present=False))
    assert not poses.present.any() and poses.position_m[2].tolist() == [1.0, 1.0, 1.0], "its last numbers stay"


def test_angles_do_not_jump_by_whole_turns():
    poses = GivenPoses()
    poses.add("a", True)
    for k in range(100):
        poses.take(k * DT_S, frame(["a"], psi=0.1 * k))
        assert poses.angles_rad[0] == pytest.approx([0.0, 0.0, 0.1 * k], abs=1e-9)


def test_what_is_attached_has_no_attitude():
    poses = GivenPoses()
    poses.add("tip", False)
    poses.add("vehicle", True)
    poses.take(1.0, frame(["vehicle", "tip"], psi=0.5))
    assert poses.present.all() and not poses.angles_rad[0].any()
    assert abs(poses.angles_rad[1, 2]) == pytest.approx(0.5)
