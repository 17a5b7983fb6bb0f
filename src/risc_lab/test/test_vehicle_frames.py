"""Frames of vehicles and cameras in tf: each axis pushed once, against risc_lab.frames."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from risc_lab.camera import cortex_to_camera
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.calibration import FRONT_MOUNT, CameraMount
from risc_lab.vehicle_frames import camera_transform, vehicle_frames

ANGLES = [(0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (0.0, -0.3, 0.0), (0.0, 0.0, 2.1), (-0.25, 0.4, -2.9)]


def matrix(transform):
    return Rotation.from_quat(transform.quaternion_xyzw).as_matrix()


@pytest.mark.parametrize("angles_rad", ANGLES)
def test_frames_add_yaw_then_pitch_then_roll(angles_rad):
    phi, theta, psi = angles_rad
    frames = vehicle_frames("Raven", (1.0, 2.0, 3.0), phi, theta, psi)
    assert [frame.child for frame in frames] == [
        "Raven_vehicle_frame",
        "Raven_vehicle1_frame",
        "Raven_vehicle2_frame",
        "Raven_body_frame",
    ]
    expected = [(0.0, 0.0, 0.0), (0.0, 0.0, psi), (0.0, theta, psi), (phi, theta, psi)]
    for frame, turn in zip(frames, expected):
        assert frame.parent == "cortex" and frame.position_m == (1.0, 2.0, 3.0)
        np.testing.assert_allclose(matrix(frame), rotation_body_to_cortex(*turn), atol=1e-12)


def test_signs_of_the_body_axes():
    """Nose along cortex x at yaw 0; right wing along -y; + yaw turns the nose to -y, + pitch lifts it."""
    body = matrix(vehicle_frames("Raven", (0.0, 0.0, 0.0), 0.0, 0.0, 0.0)[3])
    np.testing.assert_allclose(body, np.diag([1.0, -1.0, -1.0]), atol=1e-12)
    turned = matrix(vehicle_frames("Raven", (0.0, 0.0, 0.0), 0.0, 0.0, math.radians(90.0))[3])
    np.testing.assert_allclose(turned[:, 0], (0.0, -1.0, 0.0), atol=1e-12)
    lifted = matrix(vehicle_frames("Raven", (0.0, 0.0, 0.0), 0.0, math.radians(30.0), 0.0)[3])
    assert lifted[2, 0] == pytest.approx(0.5)
    rolled = matrix(vehicle_frames("Raven", (0.0, 0.0, 0.0), math.radians(30.0), 0.0, 0.0)[3])
    assert rolled[2, 1] == pytest.approx(-0.5), "the right wing goes down"


@pytest.mark.parametrize("angles_rad", ANGLES)
def test_a_point_goes_through_both_transforms_into_the_camera(angles_rad):
    mount = CameraMount(position_m=(0.2, -0.03, 0.05), roll_rad=0.04, pitch_rad=0.24, yaw_rad=-0.09)
    place, point = np.array([0.4, -1.0, 1.2]), np.array([2.3, 0.8, 1.0])
    body = vehicle_frames("Raven", place, *angles_rad)[3]
    camera = camera_transform("Raven", mount)
    assert (camera.parent, camera.child) == ("Raven_body_frame", "Raven/camera")
    in_body = matrix(body).T @ (point - place)
    in_camera = matrix(camera).T @ (in_body - np.array(camera.position_m))
    expected = cortex_to_camera(point, place, rotation_body_to_cortex(*angles_rad), mount)
    np.testing.assert_allclose(in_camera, expected, atol=1e-12)


def test_the_nominal_camera_is_where_the_original_had_it():
    """0.21 m in front, not turned: the original's default of 6.09 degrees of yaw belonged to one vehicle."""
    camera = camera_transform("condor", FRONT_MOUNT)
    assert camera.position_m == (0.21, 0.0, 0.0)
    assert camera.quaternion_xyzw == (0.0, 0.0, 0.0, 1.0)


def test_a_camera_turns_as_the_original_s_sliders_said():
    """albatross, sliders 407, 1580, 1260, 1504: x 0.214 m, fixed-axis roll, pitch, yaw -2.40, 0.80, -4.839 degrees."""
    a, e, r, t = 407, 1580, 1260, 1504
    roll, pitch, yaw = np.radians([0.01 * (r - 1500), 0.01 * (e - 1500), 6.09093311 + 0.01 * (a - 1500)])
    assert np.degrees((roll, pitch, yaw)) == pytest.approx((-2.40, 0.80, -4.839), abs=1e-3)
    camera = camera_transform("albatross", CameraMount((0.21 + 0.001 * (t - 1500), 0.0, 0.0), roll, pitch, yaw))
    assert camera.position_m == pytest.approx((0.214, 0.0, 0.0))
    np.testing.assert_allclose(
        matrix(camera), Rotation.from_euler("xyz", (roll, pitch, yaw)).as_matrix(), atol=1e-12
    )  # tf's setRPY: about fixed axes
