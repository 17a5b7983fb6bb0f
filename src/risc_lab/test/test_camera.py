"""Pixels, rays and bearings: signs axis by axis, round trips, and the lenses that the laboratory had."""

import math

import numpy as np
import pytest

from risc_lab.camera import (
    Camera,
    bearings_of_rays,
    cortex_to_camera,
    rays_of_bearings,
    rotation_camera_to_body,
)
from risc_lab.lab.calibration import BOTTOM_MOUNT, CameraCalibration, CameraMount

LENSES = {  # focal lengths, principal point, k1 k2 p1 p2 k3 (legacy calibrations)
    "risc1": ((977.994066, 975.285107), (357.362844, 160.919363), (-1.455445, 1.626447, 0.014496, -0.02879, 0.0)),
    "risc2": ((587.4757313, 584.4748517), (332.1513064, 198.1363555), (-0.629084, 0.388896, -0.00218, 0.001088, 0.0)),
    "risc3": ((663.931413, 670.01213), (385.105531, 182.633137), (-0.684161, 0.288271, 0.008015, -0.04444, 0.0)),
}


@pytest.fixture(params=sorted(LENSES))
def camera(request):
    focal_px, centre_px, distortion = LENSES[request.param]
    return Camera(CameraCalibration.from_intrinsics(request.param, (640, 360), focal_px, centre_px, distortion))


def plain_camera():
    return Camera(CameraCalibration.from_intrinsics("plain", (640, 360), (500.0, 500.0), (320.0, 180.0)))


def test_each_axis_moves_its_own_pixel_coordinate():
    camera = plain_camera()
    np.testing.assert_allclose(camera.project((2.0, 0.0, 0.0)), (320.0, 180.0))
    np.testing.assert_allclose(camera.project((2.0, 1.0, 0.0)), (570.0, 180.0), err_msg="right is to the right")
    np.testing.assert_allclose(camera.project((2.0, 0.0, 0.5)), (320.0, 305.0), err_msg="down is downwards")
    assert np.isnan(camera.project((-2.0, 0.1, 0.1))).all(), "behind the camera"


def test_signs_and_size_of_bearings():
    camera = plain_camera()
    azimuth, elevation = camera.bearings((570.0, 180.0))
    assert azimuth == pytest.approx(math.atan2(1.0, 2.0)) and elevation == pytest.approx(0.0)
    azimuth, elevation = camera.bearings((320.0, 55.0))
    assert azimuth == pytest.approx(0.0) and elevation == pytest.approx(math.atan2(0.5, 2.0)), "up is positive"


def test_pixels_survive_the_way_to_rays_and_back(camera):
    pixels = np.random.default_rng(1).uniform((0.0, 0.0), (640.0, 360.0), (500, 2))
    rays = camera.rays(pixels)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(camera.project(3.0 * rays), pixels, atol=1e-6)
    np.testing.assert_allclose(camera.pixels_of_bearings(*camera.bearings(pixels)), pixels, atol=1e-6)


def test_projection_is_the_thesis_distortion(camera):
    """Equations of 4.4.3, written out."""
    k1, k2, p1, p2, k3 = camera.D
    x, y = 0.21, -0.13
    r2 = x * x + y * y
    radial = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    expected = (camera.K[0, 0] * xd + camera.K[0, 2], camera.K[1, 1] * yd + camera.K[1, 2])
    np.testing.assert_allclose(camera.project((1.0, x, y)), expected, rtol=1e-9)


def test_points_that_the_polynomial_would_fold_back_are_not_seen():
    barrel = Camera(
        CameraCalibration.from_intrinsics("b", (640, 360), (500.0, 500.0), (320.0, 180.0), (-0.4, 0, 0, 0, 0))
    )
    assert barrel.radius_limit == pytest.approx(math.sqrt(1.0 / 1.2))
    assert np.isfinite(barrel.project((1.0, 0.9, 0.0))).all()
    assert np.isnan(barrel.project((1.0, 1.0, 0.0))).all()


def test_bearings_and_rays_are_inverse():
    azimuth, elevation = np.meshgrid(np.radians([-170, -60, 0, 20, 90]), np.radians([-80, -10, 0, 45]))
    back = bearings_of_rays(7.0 * rays_of_bearings(azimuth, elevation))
    np.testing.assert_allclose(back, (azimuth, elevation), atol=1e-12)


def test_edges_of_the_picture():
    camera = plain_camera()
    inside = camera.in_picture([(-0.5, 0.0), (639.4, 359.4), (639.5, 10.0), (5.0, -0.6), (np.nan, 3.0)])
    assert inside.tolist() == [True, True, False, False, False]
    assert camera.undistort(np.empty((0, 2))).shape == (0, 2)


@pytest.mark.parametrize(
    ("mount", "axis_body"),
    [
        (CameraMount(), (1.0, 0.0, 0.0)),
        (CameraMount(yaw_rad=math.pi / 2), (0.0, 1.0, 0.0)),
        (CameraMount(pitch_rad=math.pi / 6), (math.cos(math.pi / 6), 0.0, -0.5)),
        (BOTTOM_MOUNT, (0.0, 0.0, 1.0)),
    ],
)
def test_optical_axis_of_a_mount(mount, axis_body):
    np.testing.assert_allclose(rotation_camera_to_body(mount)[:, 0], axis_body, atol=1e-12)


def test_a_landmark_ahead_and_to_the_left_of_a_vehicle():
    """Vehicle at (1, 0, 1) looking along cortex x; the camera sits 0.21 m ahead of its centre."""
    point = cortex_to_camera((3.21, 0.5, 1.3), (1.0, 0.0, 1.0), np.diag([1.0, -1.0, -1.0]), CameraMount())
    np.testing.assert_allclose(point, (2.0, -0.5, -0.3), atol=1e-12)
