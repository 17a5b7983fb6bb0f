"""The calibrations and mounts that ship with the workspace: all load, in every reader, with the lab's numbers."""

import pathlib

import camera_calibration_parsers
import cv2
import numpy as np
import pytest

from risc_lab.camera import Camera, cortex_to_camera, rotation_camera_to_body
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.calibration import load_calibration, load_mount, resolve_url

FOLDER = pathlib.Path(__file__).resolve().parents[2] / "risc_lab" / "config" / "cameras"
MOUNTS = sorted(path.name for path in FOLDER.glob("*_mount.yaml"))
CALIBRATIONS = sorted(path.name for path in FOLDER.glob("*.yaml") if path.name not in MOUNTS)

# The original's table: fx, fy, cx, cy; k1, k2, p1, p2, k3; fx', fy', cx', cy'
LAB = {
    "risc1.yaml": (
        (977.994066, 975.285107, 357.362844, 160.919363),
        (-1.455445, 1.626447, 0.014496, -0.028790, 0.0),
        (792.300659, 921.526917, 356.921090, 160.038265),
    ),
    "risc2.yaml": (
        (587.4757313, 584.4748517, 332.1513064, 198.1363555),
        (-0.629084, 0.388896, -0.002180, 0.001088, 0.0),
        (512.198853, 593.455444, 351.289336, 196.332091),
    ),
    "risc3.yaml": (
        (663.931413, 670.012130, 385.105531, 182.633137),
        (-0.684161, 0.288271, 0.008015, -0.044440, 0.0),
        (538.507324, 634.199646, 377.919170, 183.942123),
    ),
    "albatross_ardrone_front.yaml": (
        (587.4757313, 584.4748517, 332.1513064, 198.1363555),
        (-0.5338055, 0.2820190, -0.0013371, 0.0071128, 0.0),
        (477.8070679, 550.4728394, 344.8198961, 199.4393165),
    ),
    "ardrone_front.yaml": ((569.883, 568.007, 331.403, 135.879), (-0.526629, 0.274357, 0.021143, -0.006394, 0.0), None),
    "ardrone_bottom.yaml": ((700.491, 701.654, 319.509, 218.740), (0.018239, 0.052028, 0.006511, 0.000183, 0.0), None),
}


def test_every_file_of_the_table_is_there():
    assert set(CALIBRATIONS) == set(LAB)
    assert MOUNTS == ["risc1_mount.yaml", "risc2_mount.yaml", "risc3_mount.yaml"]


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_all_readers_agree_with_the_table(name):
    calibration = load_calibration(name)
    camera_name, info = camera_calibration_parsers.readCalibration(str(FOLDER / name))
    assert camera_name == calibration.name == ("ardrone_bottom" if "bottom" in name else "ardrone_front")
    assert (info.width, info.height) == (calibration.width_px, calibration.height_px) == (640, 360)
    assert info.distortion_model == "plumb_bob"
    for read, expected in ((info.K, calibration.K), (info.D, calibration.D), (info.R, calibration.R)):
        assert tuple(read) == expected
    assert tuple(info.P) == calibration.P
    (fx, fy, cx, cy), D, projection = LAB[name]
    assert np.array_equal(calibration.K, (fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0))
    assert np.array_equal(calibration.D, D)
    assert np.array_equal(np.reshape(calibration.R, (3, 3)), np.eye(3))
    if projection is not None:
        fx, fy, cx, cy = projection
    else:
        P, _ = cv2.getOptimalNewCameraMatrix(np.reshape(calibration.K, (3, 3)), np.array(D), (640, 360), 0.0)
        fx, fy, cx, cy = P[0, 0], P[1, 1], P[0, 2], P[1, 2]
    assert np.allclose(calibration.P, (fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0), atol=1e-6, rtol=0.0)


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_pixels_have_one_direction_all_over_the_picture(name):
    camera = Camera(load_calibration(name))
    pixels = np.stack(np.meshgrid(np.linspace(0.0, 639.0, 33), np.linspace(0.0, 359.0, 19)), axis=-1)
    assert np.abs(camera.project(camera.rays(pixels)) - pixels).max() < 0.01


# Sliders a, e, r, t of the original's table
SLIDERS = {"risc1": (375, 2869, 1462, 1277), "risc2": (493, 1580, 1266, 1257), "risc3": (982, 2006, 1779, 1257)}


def tf_matrix(roll, pitch, yaw):
    """Rotation of tf's fixed-axis roll, pitch, yaw, written out."""
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    return (
        np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
        @ np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
        @ np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    )


@pytest.mark.parametrize("namespace", sorted(SLIDERS))
def test_mounts_put_the_camera_where_the_original_tf_did(namespace):
    a, e, r, t = SLIDERS[namespace]
    mount = load_mount("%s_mount.yaml" % namespace)
    origin_m = np.array([0.21 + 0.001 * (t - 1500), 0.0, 0.0])
    R_camera_to_body = tf_matrix(*np.radians([0.01 * (r - 1500), 0.01 * (e - 1500), 6.09093311 + 0.01 * (a - 1500)]))
    assert np.allclose(mount.position_m, origin_m, atol=1e-9)
    assert np.allclose(rotation_camera_to_body(mount), R_camera_to_body, atol=1e-6)
    # the whole chain cortex -> <name>_body_frame -> <name>/camera of the original, at some attitude
    phi, theta, psi = np.radians([5.0, -7.0, 100.0])
    R_body_to_cortex = tf_matrix(np.pi + phi, -theta, -psi)
    position_m, point_m = np.array([0.3, -0.4, 1.1]), np.array([2.3, 0.8, 1.0])
    expected = R_camera_to_body.T @ (R_body_to_cortex.T @ (point_m - position_m) - origin_m)
    ours = cortex_to_camera(point_m, position_m, rotation_body_to_cortex(phi, theta, psi), mount)
    assert np.allclose(ours, expected, atol=1e-6)


def test_a_bare_name_is_a_file_of_risc_lab():
    assert resolve_url("risc1.yaml") == FOLDER / "risc1.yaml"
