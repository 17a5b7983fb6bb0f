"""The moving checkerboard: fully in the picture, smooth, and suitable for a calibration."""

import pathlib
import sys

import numpy as np
import pytest

from risc_lab.camera import Camera
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.calibration import CameraCalibration, load_calibration
from risc_simulator.video.checkerboard_motion import CheckerboardMotion
from risc_simulator.video.scene import CameraPose

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[3] / "tests/benchmarks"))
from picture_truth import corners_of, corners_px, held_s  # noqa: E402

CAMERAS = ("risc1.yaml", "risc3.yaml", "ardrone_front.yaml", "ardrone_bottom.yaml")


@pytest.fixture(scope="module", params=CAMERAS)
def moved(request):
    camera = Camera(load_calibration(request.param))
    return camera, CheckerboardMotion(camera)


def held_corners(camera, motion):
    return np.array([corners_px(motion, camera, time_s) for time_s in held_s()])


def test_the_board_is_whole_in_the_picture_whenever_it_is_held(moved):
    camera, motion = moved
    assert len(held_s()) == 60
    assert camera.in_picture(held_corners(camera, motion)).all()


def test_it_goes_everywhere_near_and_far_and_tilted(moved):
    camera, motion = moved
    corners = held_corners(camera, motion)
    for end in ((0, 0), (639, 0), (0, 359), (639, 359)):
        assert np.linalg.norm(corners - end, axis=-1).min() < 0.12 * np.hypot(640, 360)
    widths = np.ptp(corners[..., 0], axis=1)
    assert widths.max() > 1.5 * widths.min() and widths.max() > 320
    tilts = np.array([np.degrees(np.arccos(motion.posture(time_s)[1][0, 2])) for time_s in held_s()])
    assert np.count_nonzero(tilts > 30.0) > 10


def test_it_moves_smoothly_and_is_held_still(inputs):
    """Held still in every posture; smooth in the last moves of a round and into the next one (--all: in all moves)."""
    motion = CheckerboardMotion(Camera(load_calibration("risc2.yaml")))
    for at_s in held_s():
        before, after = motion.posture(at_s - 0.25), motion.posture(at_s + 0.25)
        assert np.allclose(before[0], after[0]) and np.allclose(before[1], after[1])
    times_s = np.arange(inputs(0.8, 0.0) * motion.period_s, 1.05 * motion.period_s, 0.005)
    centres = np.array([motion.posture(time_s)[0] for time_s in times_s])
    turns = np.array([motion.posture(time_s)[1] for time_s in times_s])
    assert np.linalg.norm(np.diff(centres, axis=0), axis=1).max() < 0.02  # 4 m/s
    cosines = 0.5 * (np.einsum("nij,nij->n", turns[1:], turns[:-1]) - 1.0)
    assert np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0))).max() < 2.0
    assert np.allclose(turns @ np.swapaxes(turns, 1, 2), np.eye(3)) and np.allclose(np.linalg.det(turns), 1.0)


def test_it_repeats():
    motion = CheckerboardMotion(Camera(load_calibration("risc2.yaml")))
    for time_s in (0.0, 1.23, 17.0, motion.period_s - 0.01):
        assert np.allclose(motion.posture(time_s)[0], motion.posture(time_s + motion.period_s)[0])


def test_the_board_is_where_its_corners_are_seen_from_any_camera_pose():
    camera = Camera(load_calibration("risc1.yaml"))
    motion = CheckerboardMotion(camera)
    pose = CameraPose(np.array([0.3, -1.2, 0.8]), rotation_body_to_cortex(0.1, -0.2, 2.0), np.zeros(3), np.zeros(3))
    for time_s in (0.1, 1.0, 20.0):
        board = motion.board(time_s, pose)
        assert (board.columns, board.rows, board.square_m) == (8, 6, 0.025)
        seen = camera.project((corners_of(board) - pose.position_m) @ pose.R_camera_to_cortex)
        assert np.allclose(seen, corners_px(motion, camera, time_s), atol=1e-6)


def test_it_shows_its_face():
    camera = Camera(load_calibration("risc2.yaml"))
    corners = corners_px(CheckerboardMotion(camera), camera, 0.1).reshape(6, 8, 2)
    along, down = corners[0, -1] - corners[0, 0], corners[-1, 0] - corners[0, 0]
    assert along[0] * down[1] - along[1] * down[0] > 0.0, "x right and y down, as seen from the front"


def test_a_board_that_cannot_be_shown_is_refused():
    # its distortion leaves only a spot of the picture
    blind = CameraCalibration.from_intrinsics("keyhole", (16, 12), (20.0, 20.0), (-300.0, 6.0))
    with pytest.raises(ValueError, match="keyhole"):
        CheckerboardMotion(Camera(blind))
