"""The frames of a vehicle and of its camera, under the names that they have in tf (thesis 6.1.2, 4.4.4).

Parent of all vehicle frames is `cortex`; that of a camera is its vehicle's body. Quaternions are x, y, z, w.
"""

import math
from typing import NamedTuple

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
    """Name of a vehicle's body frame. name: its mocap template."""
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
    place, angles = tuple(float(value) for value in position_m), [(math.pi + p, -t, -y) for _, (p, t, y) in turns]
    quaternions = map(tuple, Rotation.from_euler("xyz", angles).as_quat().tolist())
    return [FrameTransform(WORLD, name + turn[0], place, its) for turn, its in zip(turns, quaternions)]


def camera_transform(name, mount):
    """FrameTransform from a vehicle's body to its camera. mount: lab.calibration.CameraMount."""
    quaternion = Rotation.from_matrix(rotation_camera_to_body(mount)).as_quat().tolist()
    return FrameTransform(body_frame(name), camera_frame(name), tuple(mount.position_m), tuple(quaternion))
