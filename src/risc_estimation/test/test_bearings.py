"""Regions to angles: signs, every calibration of the original laboratory, raw against rectified, what has no angle."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from risc_estimation.bearings import (
    ImageSource,
    RectifiedCamera,
    Region,
    bearings_of_regions,
    calibration_from_info,
    make_camera,
)
from risc_lab.camera import Camera
from risc_lab.lab.calibration import CameraCalibration, load_calibration

LEGACY = ("risc1.yaml", "risc2.yaml", "risc3.yaml", "albatross_ardrone_front.yaml")
T0_NS = 1_700_000_000_123_456_789
PLAIN = CameraCalibration.from_intrinsics("plain", (640, 360), (600.0, 610.0), (320.0, 180.0))


def grid(calibration, margin_px=20):
    """Pixels all over the picture."""
    x = np.linspace(margin_px, calibration.width_px - 1 - margin_px, 9)
    y = np.linspace(margin_px, calibration.height_px - 1 - margin_px, 7)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def one(camera, x_px, y_px):
    bearing = bearings_of_regions(camera, [Region("green", True, x_px, y_px)])[0]
    assert (bearing.name, bearing.visible) == ("green", True)
    return bearing.azimuth_rad, bearing.elevation_rad


@pytest.mark.parametrize("rectified", [False, True])
def test_right_is_plus_and_up_is_plus(rectified):
    camera = make_camera(PLAIN, rectified)
    assert one(camera, 320, 180) == pytest.approx((0.0, 0.0), abs=1e-12)
    right = one(camera, 320 + 60, 180)
    assert right == pytest.approx((np.arctan(0.1), 0.0), abs=1e-9)
    up = one(camera, 320, 180 - 61)
    assert up == pytest.approx((0.0, np.arctan(0.1)), abs=1e-9)
    azimuth, elevation = one(camera, 320 - 60, 180 + 61)
    assert azimuth == pytest.approx(-np.arctan(0.1))
    assert elevation == pytest.approx(-np.arctan2(0.1, np.hypot(1.0, 0.1))), "measured from the level plane"


@pytest.mark.parametrize("name", LEGACY)
@pytest.mark.parametrize("rectified", [False, True])
def test_pixel_to_angle_to_pixel_with_every_calibration(name, rectified):
    calibration = load_calibration(name)
    camera = make_camera(calibration, rectified)
    pixels = grid(calibration)
    bearings = bearings_of_regions(camera, [Region(str(k), True, *pixel) for k, pixel in enumerate(pixels)])
    seen = np.array([bearing.visible for bearing in bearings])
    assert seen.mean() > (0.9 if rectified else 0.999)  # a rectified picture may show more than the lens sees
    angles = np.array([(bearing.azimuth_rad, bearing.elevation_rad) for bearing in bearings])
    again = camera.pixels_of_bearings(angles[seen, 0], angles[seen, 1])
    np.testing.assert_allclose(again, pixels[seen], atol=0.1)
    right, down = pixels[seen, 0] - camera.K[0, 2], pixels[seen, 1] - camera.K[1, 2]
    far = 40  # [px] near the axis the tangential distortion decides the sign
    assert np.all(np.sign(right) == np.sign(angles[seen, 0]), where=np.abs(right) > far)
    assert np.all(np.sign(down) == -np.sign(angles[seen, 1]), where=np.abs(down) > far)


@pytest.mark.parametrize("name", LEGACY)
def test_raw_and_rectified_pixels_of_one_ray_have_the_same_bearing(name):
    calibration = load_calibration(name)
    raw_pixels = grid(calibration, 40)
    K, D = np.array(calibration.K).reshape(3, 3), np.array(calibration.D)
    R, P = np.array(calibration.R).reshape(3, 3), np.array(calibration.P).reshape(3, 4)
    # what image_proc does to a picture, done to points by OpenCV
    rectified_pixels = cv2.undistortPointsIter(
        raw_pixels.reshape(-1, 1, 2), K, D, R, P, (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    )[:, 0]
    raw = np.array(make_camera(calibration, False).bearings(raw_pixels))
    rectified = np.array(make_camera(calibration, True).bearings(rectified_pixels))
    np.testing.assert_allclose(rectified, raw, atol=1e-6)
    confused = np.array(make_camera(calibration, False).bearings(rectified_pixels))
    assert np.degrees(np.abs(confused - raw).max()) > 1.0, "the two cameras must not be interchangeable"


def test_a_turned_rectification_keeps_the_axes_of_the_real_camera():
    turn = cv2.Rodrigues(np.array([0.02, -0.05, 0.03]))[0]
    calibration = replace(load_calibration("risc2.yaml"), R=tuple(turn.ravel()))
    camera = RectifiedCamera(calibration)
    rays = np.array([[1.0, 0.2, 0.1], [1.0, -0.3, 0.05], [1.0, 0.0, -0.15]])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    pixels = camera.project(rays)
    expected = cv2.undistortPointsIter(
        Camera(calibration).project(rays).reshape(-1, 1, 2), camera.raw.K, camera.raw.D, turn,
        np.array(calibration.P).reshape(3, 4), (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12),
    )[:, 0]  # fmt: skip
    np.testing.assert_allclose(pixels, expected, atol=1e-4)
    np.testing.assert_allclose(camera.rays(pixels), rays, atol=1e-9)


def test_what_is_not_visible_has_no_angle():
    regions = [
        Region("green", False, 0.0, 0.0),
        Region("pink", True, 320.0, 180.0),
        Region("Orange", False, 100.0, 100.0),
    ]
    bearings = bearings_of_regions(Camera(PLAIN), regions)
    assert [bearing.name for bearing in bearings] == ["green", "pink", "Orange"]
    assert [bearing.visible for bearing in bearings] == [False, True, False]
    assert np.isnan([bearings[0].azimuth_rad, bearings[0].elevation_rad]).all()
    assert np.isnan([bearings[2].azimuth_rad, bearings[2].elevation_rad]).all()
    assert bearings_of_regions(Camera(PLAIN), []) == []


def test_without_a_camera_nothing_is_visible():
    bearings = bearings_of_regions(None, [Region("green", True, 320.0, 180.0)])
    assert (bearings[0].name, bearings[0].visible) == ("green", False)
    assert np.isnan(bearings[0].azimuth_rad)


def test_where_the_lens_model_folds_there_is_no_angle():
    # 1 - r^2 has its greatest radius of 0.385 at r = 0.577: pixels farther out belong to no direction
    folding = CameraCalibration.from_intrinsics("f", (640, 360), (300.0, 300.0), (320.0, 180.0), (-1.0, 0, 0, 0, 0))
    inside, outside = bearings_of_regions(
        Camera(folding), [Region("in", True, 320.0 + 100.0, 180.0), Region("out", True, 320.0 + 200.0, 180.0)]
    )
    assert inside.visible and not outside.visible
    assert np.isnan(outside.azimuth_rad)


def test_a_calibration_without_projection_has_no_rectified_picture():
    with pytest.raises(ValueError, match="plain: projection_matrix .*calibrate"):
        make_camera(replace(PLAIN, P=(0.0,) * 12), True)


def camera_info(**changes):
    calibration = load_calibration("risc1.yaml")
    roi = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0)
    info = SimpleNamespace(
        width=640, height=360, distortion_model="plumb_bob", K=calibration.K, D=list(calibration.D), R=calibration.R,
        P=calibration.P, binning_x=0, binning_y=0, roi=roi,
    )  # fmt: skip
    vars(info).update(changes)
    return info


def test_camera_info_is_the_calibration_file():
    assert calibration_from_info(camera_info(), "x") == replace(load_calibration("risc1.yaml"), name="x")
    short = calibration_from_info(camera_info(D=[-0.1, 0.2, 0.0, 0.0]), "x")
    assert short.D == (-0.1, 0.2, 0.0, 0.0, 0.0)
    assert calibration_from_info(camera_info(K=[0.0] * 9), "x") is None, "not calibrated"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"distortion_model": "equidistant"}, "distortion_model .*plumb_bob"),
        ({"D": [0.0] * 8}, "5 coefficients"),
        ({"binning_x": 2}, "binning"),
        ({"roi": SimpleNamespace(x_offset=10, y_offset=0, width=100, height=100)}, "region of interest"),
    ],
)
def test_camera_info_that_we_do_not_do_is_refused(changes, reason):
    with pytest.raises(ValueError, match="camera risc1: .*" + reason):
        calibration_from_info(camera_info(**changes), "risc1")


def answered(messages):
    """Messages (observer, image number, exact) that are accepted, at 15 images a second."""
    source = ImageSource()
    return [m for m in messages if source.take(m[0], T0_NS + int(m[1] * 1e9 / 15), m[2])]


def test_an_old_bag_has_only_regions_and_all_are_used():
    assert len(answered([("risc1", k, False) for k in range(100)])) == 100


@pytest.mark.parametrize("first", [True, False])
def test_exact_detections_win_and_no_image_is_answered_twice(first):
    messages = [("risc1", k, exact) for k in range(100) for exact in (first, not first)]
    taken = answered(messages)
    assert [k for _, k, _ in taken] == list(range(100))
    assert [exact for _, _, exact in taken].count(False) == (0 if first else 1), "until the first came"


def test_regions_of_images_that_were_answered_come_late():
    messages = [("risc1", k, True) for k in range(10)] + [("risc1", k, False) for k in range(10)]
    assert [exact for _, _, exact in answered(messages)] == [True] * 10


def test_observers_are_apart_and_regions_serve_again_when_no_more_detections_come():
    messages = [m for k in range(30) for m in (("risc1", k, True), ("risc1", k, False), ("risc2", k, False))]
    taken = answered(messages + [("risc1", k, False) for k in range(30, 90)])
    assert [exact for name, _, exact in taken if name == "risc2"] == [False] * 30
    later = [k for name, k, exact in taken if name == "risc1" and not exact]
    assert later == list(range(45, 90)), "a second after the last"


def test_a_bag_is_played_again():
    messages = [("risc1", k, exact) for k in range(40) for exact in (True, False)]
    assert [exact for _, _, exact in answered(messages + messages)] == [True] * 80
