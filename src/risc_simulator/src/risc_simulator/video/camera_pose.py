"""Where a vehicle's cameras are, and how they move, from the vehicle's state."""

import numpy as np

from risc_lab.camera import rotation_camera_to_body
from risc_lab.frames import body_rates_from_euler_rates, rotation_body_to_cortex
from risc_simulator.video.scene import CameraPose, VehiclePose


def camera_pose(row, mount):
    """CameraPose of a camera on a vehicle.

    row: (12,) of World.truth(): position [m], velocity [m/s] (cortex axes); roll, pitch, yaw [rad], their rates.
    mount: lab.calibration.CameraMount.
    """
    R_body_to_cortex = rotation_body_to_cortex(*row[6:9])
    R_camera_to_body = rotation_camera_to_body(mount)
    rate_body = np.array(body_rates_from_euler_rates(row[6], row[7], *row[9:12]))
    arm_m = np.asarray(mount.position_m)
    return CameraPose(
        position_m=row[:3] + R_body_to_cortex @ arm_m,
        R_camera_to_cortex=R_body_to_cortex @ R_camera_to_body,
        velocity_m_s=row[3:6] + R_body_to_cortex @ np.cross(rate_body, arm_m),
        rate_rad_s=rate_body @ R_camera_to_body,
    )


def vehicle_pose(row, name):
    """VehiclePose of a vehicle as others see it. row: as for camera_pose."""
    return VehiclePose(name=name, position_m=row[:3], R_body_to_cortex=rotation_body_to_cortex(*row[6:9]))
