"""Calibration from the corners of a checkerboard, with known truth."""

import functools

import cv2
import numpy as np
import pytest

from risc_lab.camera import Camera
from risc_lab.lab.calibration import load_calibration
from risc_visual.vision.checkerboard import (
    Checkerboard,
    View,
    calibrate,
    choose_views,
    find_board,
    shown_board,
)

BOARD = Checkerboard()
SIZE_PX = (640, 360)
SEEDS = range(4)


@functools.cache
def seeded_views(name, count, seed, noise_px=0.05, max_tilt_deg=55.0):
    """Views of the board at random postures, whole and inside the picture, and the true Camera."""
    camera = Camera(load_calibration(name))
    rng = np.random.default_rng(seed)
    points = BOARD.points_m().astype(float)
    points -= points.mean(axis=0)
    views = []
    while len(views) < count:
        tilt = np.radians(max_tilt_deg) * np.sqrt(rng.uniform())
        about = rng.uniform(0.0, 2.0 * np.pi)
        roll = np.radians(rng.normal(0.0, 15.0))
        turn = cv2.Rodrigues(tilt * np.array([np.cos(about), np.sin(about), 0.0]))[0]
        turn = turn @ cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
        ray = camera.rays(rng.uniform((0.0, 0.0), SIZE_PX))[[1, 2, 0]]  # camera axes to OpenCV's
        at_m = ray * camera.K[0, 0] * 0.225 / (640.0 * rng.uniform(0.3, 0.9))
        pixels = camera.project((points @ turn.T + at_m)[:, [2, 0, 1]])
        if camera.in_picture(pixels).all():
            views.append(View("view %d" % len(views), pixels + rng.normal(0.0, noise_px, pixels.shape)))
    return tuple(views), camera


def views_of(*arguments, **options):
    """As `seeded_views`, with a new list of the views for each caller."""
    views, camera = seeded_views(*arguments, **options)
    return list(views), camera


def errors(result, camera):
    """Relative errors of fx, fy, cx, cy."""
    found = np.array(result.calibration.K)[[0, 4, 2, 5]]
    true = camera.K[[0, 1, 0, 1], [0, 1, 2, 2]]
    return np.abs(found - true) / true


def test_recovers_the_camera_and_says_how_well():
    views, camera = views_of("risc2.yaml", 40, 1)
    result = calibrate(views, BOARD, SIZE_PX, "ardrone_front")
    assert errors(result, camera).max() < 0.01
    assert result.calibration.name == "ardrone_front" and result.calibration.D[4] == 0.0
    assert result.rms_px == pytest.approx(0.05 * np.sqrt(2.0), rel=0.1)
    assert len(result.used) == 40 and result.dropped == ()
    found = np.array(result.calibration.K)[[0, 4, 2, 5]]
    sigma = np.array([result.sigma[key] for key in ("fx", "fy", "cx", "cy")])
    assert (np.abs(found - camera.K[[0, 1, 0, 1], [0, 1, 2, 2]]) < 4.0 * sigma).all()
    assert (sigma < 2.0).all()


def test_the_projection_is_that_of_camera_calibration():
    result = calibrate(views_of("risc2.yaml", 20, 2)[0], BOARD, SIZE_PX)
    K, D = np.reshape(result.calibration.K, (3, 3)), np.array(result.calibration.D)
    expected, _ = cv2.getOptimalNewCameraMatrix(K, D, SIZE_PX, 0.0)
    assert np.allclose(np.reshape(result.calibration.P, (3, 4)), np.column_stack((expected, np.zeros(3))))


@pytest.mark.parametrize("seed", range(4))
def test_a_strongly_distorting_lens_does_not_trap_the_solver(seed):
    """OpenCV alone ends with errors of pixels here, for at least one of the seeds: see the next test."""
    views, camera = views_of("risc1.yaml", 40, seed)
    result = calibrate(views, BOARD, SIZE_PX)
    assert result.rms_px < 0.1 and result.dropped == ()
    assert errors(result, camera).max() < 0.02


def test_one_start_of_opencv_is_not_enough():
    """Why calibrate() starts more than once. If this fails, OpenCV has become better and one start is enough."""

    def found_px(seed):
        views, _ = views_of("risc1.yaml", 40, seed)
        corners = [view.corners_px.astype(np.float32) for view in views]
        points = [BOARD.points_m()] * len(views)
        return cv2.calibrateCamera(points, corners, SIZE_PX, None, None, flags=cv2.CALIB_FIX_K3)[0]

    assert any(found_px(seed) > 0.5 for seed in SEEDS)


def test_a_bad_view_is_dropped_and_named():
    views, camera = views_of("risc2.yaml", 30, 3)
    bad = views[7].corners_px.copy()
    bad[20:] += (3.0, -2.0)
    views[7] = View("the bad one", bad)
    result = calibrate(views, BOARD, SIZE_PX)
    assert [view.name for view in result.dropped] == ["the bad one"]
    assert result.dropped[0].rms_px > 0.3
    assert errors(result, camera).max() < 0.01


def test_weak_pictures_are_reported_with_the_cure():
    few = calibrate(views_of("risc2.yaml", 8, 4)[0], BOARD, SIZE_PX)
    assert any("only 8 views" in warning for warning in few.warnings)
    flat = calibrate(views_of("risc2.yaml", 20, 5, max_tilt_deg=3.0)[0], BOARD, SIZE_PX)
    assert any("tilt the board" in warning for warning in flat.warnings)
    views, _ = views_of("risc2.yaml", 200, 6)
    left = [view for view in views if view.corners_px[:, 0].max() < 450.0][:20]
    one_sided = calibrate(left, BOARD, SIZE_PX)
    assert any("top right" in warning and "bottom right" in warning for warning in one_sided.warnings)


def test_good_pictures_give_no_warnings():
    assert calibrate(views_of("ardrone_bottom.yaml", 60, 7)[0], BOARD, SIZE_PX).warnings == ()


def test_too_few_views_are_refused():
    with pytest.raises(ValueError, match=" 3 picture.* 4"):
        calibrate(views_of("risc2.yaml", 3, 8)[0], BOARD, SIZE_PX)


def test_the_same_view_again_and_again_is_no_calibration():
    view = views_of("risc2.yaml", 1, 9, max_tilt_deg=0.0)[0][0]
    try:
        warnings = calibrate([view] * 10, BOARD, SIZE_PX).warnings
    except ValueError as error:
        warnings = (str(error),)
    assert any("tilt the board" in warning for warning in warnings)


def test_views_are_chosen_for_variety():
    views, _ = views_of("risc2.yaml", 30, 10)
    crowd = [View("crowd", views[0].corners_px + 0.1 * k) for k in range(100)]
    chosen = choose_views(crowd + views, BOARD, SIZE_PX, 20)
    assert len(chosen) == 20
    assert sum(view.name == "crowd" for view in chosen) <= 2
    assert choose_views(views, BOARD, SIZE_PX, 99) == views


def flat_board(columns, rows, square_px=30, margin_px=40):
    """Picture of a board seen squarely, and its corners [px]: pixel centres at whole numbers, so corners at halves."""
    colours = np.indices((rows + 1, columns + 1)).sum(axis=0) % 2 * 200 + 20
    picture = np.kron(colours, np.ones((square_px, square_px))).astype(np.uint8)
    picture = cv2.copyMakeBorder(picture, *[margin_px] * 4, cv2.BORDER_CONSTANT, value=220)
    grid = np.mgrid[1 : columns + 1, 1 : rows + 1].T.reshape(-1, 2) * square_px + margin_px - 0.5
    return picture, grid


def test_corners_are_found_in_rows_to_a_tenth_of_a_pixel():
    picture, grid = flat_board(8, 6)
    noisy = np.clip(picture + np.random.default_rng(0).normal(0.0, 4.0, picture.shape), 0, 255).astype(np.uint8)
    corners = find_board(cv2.GaussianBlur(noisy, (0, 0), 0.8), BOARD)
    corners = corners if np.linalg.norm(corners[0] - grid[0]) < 1.0 else corners[::-1]  # either end may be the first
    assert np.abs(corners - grid).max() < 0.1


def test_only_the_right_board_is_found():
    assert find_board(flat_board(7, 5)[0], BOARD) is None
    assert find_board(np.full((360, 640), 128, np.uint8), BOARD) is None
    assert shown_board(flat_board(7, 5)[0]) == (7, 5)
    assert shown_board(np.full((360, 640), 128, np.uint8)) is None


@pytest.mark.parametrize("size", ["8", "8x", "x6", "8x6x4", "eight x six", "8.5x6", "-8x6", ""])
def test_a_bad_size_is_refused(size):
    with pytest.raises(ValueError, match="8x6"):
        Checkerboard.from_text(size, 0.025)


@pytest.mark.parametrize("square_m", [0.0, -0.025, float("nan"), float("inf")])
def test_a_bad_square_is_refused(square_m):
    with pytest.raises(ValueError, match="square"):
        Checkerboard.from_text("8x6", square_m)
