"""From regions of a picture to bearing angles (thesis 4.4.4): undistort, back-project, azimuth and elevation.

Pictures are raw (the lens' distortion is in them) or rectified (image_proc has taken it out: a camera of its own, with
the projection matrix P of the calibration). The caller always says which; it is never guessed. Needs no ROS.
"""

from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from risc_lab.camera import Camera
from risc_lab.lab.calibration import CameraCalibration

# Optical axes (x right, y down, z along the axis) of vectors in camera axes (x along the axis, y right, z down).
_CAMERA_TO_OPTICAL = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
_RECENT_IMAGES = 16  # for which a message may still come on the other topic
_EXACT_LASTS_NS = 1_000_000_000  # regions are ignored this long after exact detections; a later bag may have only them
_ROUND_TRIP_PX = 0.1  # a pixel whose bearing projects back farther off lies where the lens model folds


class Region(NamedTuple):
    """An object found in a picture."""

    name: str
    visible: bool
    x_px: float  # centre, to the right
    y_px: float  # centre, downwards


class Bearing(NamedTuple):
    """Direction of an object in camera axes; both angles NaN when it is not visible."""

    name: str
    visible: bool
    azimuth_rad: float  # + right of the optical axis
    elevation_rad: float  # + above it


class RectifiedCamera(Camera):
    """The camera that would have taken the rectified picture: R and P of the calibration, no distortion.

    Points, rays and bearings stay in the axes of the real camera; only pixels are those of the rectified picture.
    """

    def __init__(self, calibration):
        """Raises ValueError when the calibration has no projection matrix."""
        P = np.array(calibration.P).reshape(3, 4)
        if P[0, 0] <= 0.0 or P[1, 1] <= 0.0:
            raise ValueError(
                "camera %s: projection_matrix has no focal length, so its rectified picture does not exist: "
                "calibrate the camera again" % calibration.name
            )
        super().__init__(replace(calibration, K=tuple(P[:, :3].ravel()), D=(0.0,) * 5))
        self.raw = Camera(calibration)
        R_optical = np.array(calibration.R).reshape(3, 3)
        self._R_camera_to_rectified = _CAMERA_TO_OPTICAL.T @ R_optical @ _CAMERA_TO_OPTICAL

    def project(self, points_camera):
        """As Camera.project; also NaN for directions that the real lens does not see."""
        points = np.asarray(points_camera, dtype=float)
        pixels = super().project(points @ self._R_camera_to_rectified.T)
        pixels[np.isnan(self.raw.project(points)).any(axis=-1)] = np.nan
        return pixels

    def rays(self, pixels):
        """As Camera.rays."""
        return super().rays(pixels) @ self._R_camera_to_rectified


class ImageSource:
    """Chooses the topic to use for an image: exact detections if an observer sends them, else regions in whole pixels.

    Never both for one image, in whichever order they come.
    """

    def __init__(self):
        self._recent_ns = {}  # (observer, exact) -> stamps: exact detections that came, regions that were used

    def take(self, observer, stamp_ns, exact):
        """Whether to use this message for the image of this stamp. exact: it holds exact detections."""
        others_ns = self._recent_ns.get((observer, not exact), ())
        taken = stamp_ns not in others_ns
        if not exact and others_ns:
            taken &= abs(stamp_ns - others_ns[-1]) > _EXACT_LASTS_NS
        if exact or taken:
            self._recent_ns.setdefault((observer, exact), deque(maxlen=_RECENT_IMAGES)).append(stamp_ns)
        return taken


def make_camera(calibration, rectified):
    """Camera of the raw or of the rectified picture. Raises ValueError, from RectifiedCamera."""
    return RectifiedCamera(calibration) if rectified else Camera(calibration)


def bearings_of_regions(camera, regions):
    """List of Bearing, one per Region, in their order.

    camera: of the picture that the regions were found in; None = not calibrated, hence nothing is visible. A region at
    which the lens model has no direction is not visible either.
    """
    lost = [Bearing(region.name, False, np.nan, np.nan) for region in regions]
    rows = [row for row, region in enumerate(regions) if region.visible]
    if camera is None or not rows:
        return lost
    pixels = np.array([(regions[row].x_px, regions[row].y_px) for row in rows], dtype=float)
    azimuth, elevation = camera.bearings(pixels)
    with np.errstate(invalid="ignore"):
        again = np.linalg.norm(camera.pixels_of_bearings(azimuth, elevation) - pixels, axis=1) <= _ROUND_TRIP_PX
    for row, azimuth_rad, elevation_rad, good in zip(rows, azimuth.tolist(), elevation.tolist(), again.tolist()):
        if good:
            lost[row] = Bearing(regions[row].name, True, azimuth_rad, elevation_rad)
    return lost


def calibration_from_info(info, name):
    """CameraCalibration of a sensor_msgs/CameraInfo (of rospy or of the rosbags library); None if not calibrated.

    name: of the camera, for errors. Raises ValueError for binning or a region of interest, which are not supported.
    """
    if info.K[0] == 0.0:
        return None
    region = info.roi
    cropped = (region.width, region.height) not in ((0, 0), (info.width, info.height))
    if info.binning_x > 1 or info.binning_y > 1 or cropped or region.x_offset or region.y_offset:
        raise ValueError("camera %s: its camera_info has binning or a region of interest: switch them off" % name)
    return CameraCalibration.from_info(info, name).usable()
