"""Pixels, rays and bearing angles of one camera (thesis 4.4.3, 4.4.4), by OpenCV's plumb-bob model.

Camera axes are body-like: x along the optical axis, y right, z down in the picture (OpenCV and ROS' optical frames
have z along the axis; the change is made here and nowhere else). Pixels: x right, y down, (0, 0) is the middle of the
top left pixel. Bearings: azimuth + right, elevation + up, as fields of risc_msgs/Angle but in radians.
"""

import cv2
import numpy as np

from risc_lab.frames import rotation_body_to_ned

_UNDISTORT = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-10)


class Camera:
    """The optics of one calibrated camera."""

    def __init__(self, calibration):
        """calibration: lab.calibration.CameraCalibration."""
        self.calibration = calibration
        self.width_px, self.height_px = calibration.width_px, calibration.height_px
        self.K = np.array(calibration.K).reshape(3, 3)
        self.D = np.array(calibration.D)
        self.radius_limit = _monotonic_radius(self.D)  # of normalised coordinates where the distortion model is valid

    def project(self, points_camera):
        """Pixels (..., 2) where points (..., 3) [m] in camera axes are seen; NaN behind the camera.

        Also NaN outside the cone for which the distortion polynomial is single-valued: it would fold such points
        back into the picture. Points outside the picture keep their (distorted) coordinates: see `in_picture`.
        """
        points = np.asarray(points_camera, dtype=float)
        flat = points.reshape(-1, 3)
        depth = flat[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            normalised = flat[:, 1:] / depth[:, None]
        seen = (depth > 0.0) & (np.hypot(normalised[:, 0], normalised[:, 1]) <= self.radius_limit)
        pixels = np.full((len(flat), 2), np.nan)
        if seen.any():
            homogeneous = np.column_stack((normalised[seen], np.ones(seen.sum())))
            pixels[seen] = cv2.projectPoints(homogeneous, np.zeros(3), np.zeros(3), self.K, self.D)[0][:, 0]
        return pixels.reshape(points.shape[:-1] + (2,))

    def rays(self, pixels):
        """Unit vectors (..., 3) in camera axes towards what is seen at pixels (..., 2): undistort, back-project."""
        pixels = np.asarray(pixels, dtype=float)
        normalised = self.undistort(pixels).reshape(-1, 2)
        rays = np.column_stack((np.ones(len(normalised)), normalised))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return rays.reshape(pixels.shape[:-1] + (3,))

    def undistort(self, pixels):
        """Normalised coordinates (..., 2), right and down at depth 1, of pixels (..., 2)."""
        pixels = np.asarray(pixels, dtype=float)
        flat = np.ascontiguousarray(pixels.reshape(-1, 1, 2))
        if not len(flat):
            return pixels.copy()
        return cv2.undistortPointsIter(flat, self.K, self.D, None, None, _UNDISTORT).reshape(pixels.shape)

    def bearings(self, pixels):
        """(azimuth, elevation) [rad], each (...), of what is seen at pixels (..., 2)."""
        return bearings_of_rays(self.rays(pixels))

    def pixels_of_bearings(self, azimuth_rad, elevation_rad):
        """Pixels (..., 2) at which something in these directions is seen; NaN as in `project`."""
        return self.project(rays_of_bearings(azimuth_rad, elevation_rad))

    def in_picture(self, pixels):
        """Whether pixels (..., 2) lie in the picture; NaN does not."""
        pixels = np.asarray(pixels, dtype=float)
        x, y = pixels[..., 0], pixels[..., 1]
        return (x >= -0.5) & (x < self.width_px - 0.5) & (y >= -0.5) & (y < self.height_px - 0.5)


def bearings_of_rays(rays):
    """(azimuth, elevation) [rad], each (...), of vectors (..., 3) of any length in camera axes."""
    rays = np.asarray(rays, dtype=float)
    forward, right, down = rays[..., 0], rays[..., 1], rays[..., 2]
    return np.arctan2(right, forward), np.arctan2(-down, np.hypot(forward, right))


def rays_of_bearings(azimuth_rad, elevation_rad):
    """Unit vectors (..., 3) in camera axes."""
    azimuth, elevation = np.broadcast_arrays(azimuth_rad, elevation_rad)
    level = np.cos(elevation)
    return np.stack((level * np.cos(azimuth), level * np.sin(azimuth), -np.sin(elevation)), axis=-1)


def rotation_camera_to_body(mount):
    """Rotation matrix (3, 3) of a lab.calibration.CameraMount: v_body = R @ v_camera."""
    return rotation_body_to_ned(mount.roll_rad, mount.pitch_rad, mount.yaw_rad)


def cortex_to_camera(points_cortex, positions_m, R_body_to_cortex, mount):
    """Points (..., 3) [m] from the cortex frame into the axes of a camera on a vehicle.

    positions_m: (..., 3) of the vehicle's centre, cortex frame, R_body_to_cortex: (..., 3, 3): broadcast with the
    points.  mount: lab.calibration.CameraMount.
    """
    relative = np.asarray(points_cortex, dtype=float) - positions_m
    relative_body = np.einsum("...i,...ij->...j", relative, R_body_to_cortex)
    return (relative_body - mount.position_m) @ rotation_camera_to_body(mount)


def _monotonic_radius(D):
    """Greatest normalised radius up to which r (1 + k1 r^2 + k2 r^4 + k3 r^6) grows."""
    k1, k2, _, _, k3 = D
    roots = np.roots([7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])  # of the slope, in r^2
    positive = [root.real for root in roots if abs(root.imag) < 1e-9 and root.real > 0.0]
    return np.sqrt(min(positive)) if positive else np.inf
