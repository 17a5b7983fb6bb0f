"""The frames of a vehicle and of its camera, under the names that they have in tf (thesis 6.1.2, 4.4.4).

Parent of all vehicle frames is `cortex`; that of a camera is its vehicle's body. Quaternions are x, y, z, w.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from risc_lab.camera import rotation_camera_to_body

WORLD = "cortex"


class FrameTransform(NamedTuple):
    """Pose of a child frame in its parent's axes."""

    parent: str
    child: str
    position_m: tuple[float, float, float]
    quaternion_xyzw: tuple[float, float, float, float]


def body_frame(name):
    """Name of a vehicle's body frame. name: of its mocap template."""
    return name + "_body_frame"


def camera_frame(name):
    """Name of the frame of a vehicle's camera: x along the optical axis, y right, z down."""
    return name + "/camera"


def vehicle_frames(name, position_m, phi_rad, theta_rad, psi_rad):
    """FrameTransforms from cortex to the vehicle, vehicle-1, vehicle-2 and body frame.

    position_m: (3,) cortex frame. Angles as States, in rad. Each frame adds one turn: ned axes at the vehicle, yaw,
    pitch, roll; in tf's fixed-axis roll, pitch, yaw they are (pi, 0, 0) ... (pi + phi, -theta, -psi).
    """
    turns = (
        ("_vehicle_frame", (0.0, 0.0, 0.0)),
        ("_vehicle1_frame", (0.0, 0.0, psi_rad)),
        ("_vehicle2_frame", (0.0, theta_rad, psi_rad)),
        ("_body_frame", (phi_rad, theta_rad, psi_rad)),
    )
    place = tuple(float(value) for value in position_m)
    return [
        FrameTransform(WORLD, name + suffix, place, _quaternion(math.pi + phi, -theta, -psi))
        for suffix, (phi, theta, psi) in turns
    ]


def camera_transform(name, mount):
    """FrameTransform from a vehicle's body to its camera. mount: lab.calibration.CameraMount."""
    quaternion = Rotation.from_matrix(rotation_camera_to_body(mount)).as_quat()
    return FrameTransform(
        body_frame(name), camera_frame(name), tuple(mount.position_m), tuple(float(value) for value in quaternion)
    )


def _quaternion(roll_rad, pitch_rad, yaw_rad):
    """Of fixed-axis roll, pitch, yaw (tf's setRPY)."""
    return tuple(np.asarray(Rotation.from_euler("xyz", (roll_rad, pitch_rad, yaw_rad)).as_quat()).tolist())
