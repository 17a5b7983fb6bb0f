"""Poses between frames: straight lines, shortest arcs, no guesses."""

import numpy as np
import pytest

from risc_estimation.pose_track import PoseTrack
from risc_lab.frames import euler_from_body_to_ned, rotation_body_to_cortex


def yaw_of(R_body_to_cortex):
    return euler_from_body_to_ned((np.swapaxes(R_body_to_cortex, -1, -2) * (1.0, -1.0, -1.0)).swapaxes(-1, -2))[2]


def track_of(times_s, positions_m, angles_rad, **options):
    track = PoseTrack(**options)
    for row in zip(times_s, positions_m, angles_rad):
        track.append(*row)
    return track


def test_samples_are_found_again_and_midway_is_the_mean():
    track = track_of([1.0, 1.01, 1.02], [(0, 0, 1), (0.1, -0.2, 1), (0.2, -0.4, 1.5)], np.radians([(0, 0, 0)] * 3))
    poses = track.at([1.0, 1.005, 1.01, 1.015, 1.02])
    assert poses.known.all()
    np.testing.assert_allclose(poses.positions_m[:, 0], [0.0, 0.05, 0.1, 0.15, 0.2], atol=1e-12)
    np.testing.assert_allclose(poses.positions_m[:, 2], [1.0, 1.0, 1.0, 1.25, 1.5], atol=1e-12)
    np.testing.assert_allclose(poses.R_body_to_cortex, np.broadcast_to(rotation_body_to_cortex(0, 0, 0), (5, 3, 3)))


@pytest.mark.parametrize(("first", "second", "middle"), [(179.0, -179.0, 180.0), (-178.0, 176.0, 179.0), (10, 20, 15)])
def test_yaw_takes_the_short_way_across_the_seam(first, second, middle):
    track = track_of([0.0, 0.01], np.zeros((2, 3)), np.radians([(0, 0, first), (0, 0, second)]))
    yaw = yaw_of(track.at([0.005]).R_body_to_cortex)[0]
    assert np.cos(yaw - np.radians(middle)) == pytest.approx(1.0, abs=1e-12)


def test_attitude_between_samples_is_that_of_a_steady_turn():
    rate = np.radians(40.0)
    times = np.arange(0.0, 1.0, 0.02)
    track = track_of(times, np.zeros((len(times), 3)), [(0.1, -0.05, rate * t) for t in times])
    wanted = np.arange(0.003, 0.97, 0.007)
    exact = rotation_body_to_cortex(0.1, -0.05, rate * wanted)
    np.testing.assert_allclose(track.at(wanted).R_body_to_cortex, exact, atol=1e-12)


def test_outside_and_in_gaps_nothing_is_known():
    track = track_of([0.0, 0.05, 0.5, 0.55], [(k, 0, 0) for k in range(4)], np.zeros((4, 3)), max_gap_s=0.1)
    poses = track.at([-0.01, 0.0, 0.03, 0.05, 0.06, 0.3, 0.5, 0.52, 0.55, 0.56])
    assert poses.known.tolist() == [False, True, True, True, False, False, True, True, True, False]
    assert np.isnan(poses.positions_m[~poses.known]).all() and np.isnan(poses.R_body_to_cortex[~poses.known]).all()
    assert np.isfinite(poses.positions_m[poses.known]).all()
    assert not PoseTrack().at([1.0]).known.any()


def test_what_is_no_new_sample_is_passed_over():
    track = track_of([1.0, 1.0, 0.9, 1.01], [(0, 0, 0), (9, 9, 9), (8, 8, 8), (1, 0, 0)], np.zeros((4, 3)))
    track.append(1.02, (np.nan, 0, 0), (0, 0, 0))
    assert len(track) == 2 and track.last_stamp_s == 1.01
    for k in range(3):
        assert len(track) == 2
        track.append(-5.0 + 0.1 * k, (k, 3, 3), (0, 0, 0))  # the bag starts again
    assert len(track) == 1 and track.at([-4.8]).positions_m.tolist() == [[2.0, 3.0, 3.0]]


def test_a_limited_track_forgets_but_keeps_its_span():
    track = PoseTrack(span_s=0.2)
    for k in range(2000):
        track.append(0.005 * k, (k, 0, 0), (0, 0, 0))
    assert len(track) < 100
    newest_s = 0.005 * 1999
    assert track.at([newest_s - 0.2, newest_s]).known.all()
    assert not track.at([newest_s - 0.5]).known.any()
