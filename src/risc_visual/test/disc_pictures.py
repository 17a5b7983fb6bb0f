"""Pictures of landmark discs for tests, drawn by rays of sub-pixels; no code of the detector is used."""

import math

import cv2
import numpy as np

from risc_lab.camera import Camera
from risc_lab.lab.calibration import CameraCalibration

HSV = {"green": (66, 150, 170), "blue": (98, 150, 170), "pink": (167, 150, 200), "orange": (15, 160, 230)}
PAINTS = {name: cv2.cvtColor(np.uint8([[hsv]]), cv2.COLOR_HSV2BGR)[0, 0].astype(float) for name, hsv in HSV.items()}
KINDS = {  # ROI name: centre, ring
    "green": ("green", "pink"),
    "pink": ("pink", "blue"),
    "Orange": ("orange", "blue"),
    "blue": ("blue", "green"),
}
CENTRE_M, RING_M = 0.10, 0.15  # radii
_FINE = 4  # sub-pixels along a side


def camera(size=(640, 360), focal=600.0, distortion=(0.0,) * 5):
    middle = (0.5 * (size[0] - 1), 0.5 * (size[1] - 1))
    return Camera(CameraCalibration.from_intrinsics("test", size, (focal, focal), middle, distortion))


def wall(size=(640, 360), grey=110.0):
    """An empty picture (h, w, 3) float."""
    return np.full((size[1], size[0], 3), grey)


def paint_disc(picture, eye, name, pixel, distance_m, tilt_deg=0.0, towards_deg=0.0, kinds=None):
    """Draw a landmark into a picture (in place): its centre is at a pixel, its normal tilted from the line of sight.

    picture: (h, w, 3) float BGR. Returns the pixel, as the truth. kinds: name -> (centre, ring), default KINDS.
    """
    centre_bgr, ring_bgr = (PAINTS[paint] for paint in (kinds or KINDS)[name])
    sight = eye.rays(np.asarray(pixel, dtype=float))
    centre = distance_m * sight
    across = np.cross(sight, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    side = math.cos(math.radians(towards_deg)) * across
    side = side + math.sin(math.radians(towards_deg)) * np.cross(sight, across)
    normal = -math.cos(math.radians(tilt_deg)) * sight + math.sin(math.radians(tilt_deg)) * side
    height, width = picture.shape[:2]
    reach = int(1.3 * RING_M * eye.K[0, 0] / (distance_m - RING_M)) + 3
    x0, x1 = max(0, int(pixel[0]) - reach), min(width, int(pixel[0]) + reach)
    y0, y1 = max(0, int(pixel[1]) - reach), min(height, int(pixel[1]) + reach)
    offsets = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    columns = (np.arange(x0, x1)[:, None] + offsets).ravel()
    rows = (np.arange(y0, y1)[:, None] + offsets).ravel()
    rays = eye.rays(np.stack(np.meshgrid(columns, rows), axis=-1))
    depth = (centre @ normal) / (rays @ normal)
    radius = np.linalg.norm(rays * depth[..., None] - centre, axis=-1)
    radius[depth <= 0.0] = np.inf

    def coverage(limit):
        return (radius < limit).reshape(y1 - y0, _FINE, x1 - x0, _FINE).mean(axis=(1, 3))[..., None]

    inner, outer = coverage(CENTRE_M), coverage(RING_M)
    part = picture[y0:y1, x0:x1]
    part[:] = part * (1.0 - outer) + ring_bgr * (outer - inner) + centre_bgr * inner
    return np.asarray(pixel, dtype=float)


def exposed(picture, gain=1.0, noise=1.5, blur=0.5, seed=0):
    """(h, w, 3) uint8 as a sensor gives it."""
    picture = cv2.GaussianBlur(picture, (0, 0), blur) if blur else picture
    picture = gain * picture + np.random.default_rng(seed).normal(0.0, noise, picture.shape)
    return np.clip(picture + 0.5, 0, 255).astype(np.uint8)
