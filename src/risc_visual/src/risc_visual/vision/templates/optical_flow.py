"""Optical flow: where every pixel went (dense, Farneback), and where good corners went (sparse, Lucas-Kanade)."""

from dataclasses import dataclass

import cv2
import numpy as np

from risc_lab.settings import Settings, between
from risc_visual.vision.templates.edges import EdgeSettings, find_edges

_PYRAMID_SCALE = 0.5
_SIGMA_PER_POLY_N = 0.22
_SPARSE_LEVELS = 3


@dataclass(frozen=True)
class DenseSettings(Settings):
    """Settings of `DenseFlow`; the defaults are those of the original release."""

    on_edges: bool = True  # flow of the edges, as the original; False: of the grey picture, which measures better
    blur: between(0, 100) = 2  # [px] and threshold: of the edges
    threshold: between(0, 100000) = 8000
    levels: between(1, 10) = 1  # of the pyramid; one more for every doubling of the motion that must be followed
    window: between(3, 200) = 15  # [px] over which the motion is taken as equal
    iterations: between(1, 50) = 3
    poly_n: between(3, 15) = 5  # [px] neighbourhood that is approximated by a polynomial: 5 or 7
    full_scale_px: between(0.0, 1e4) = 0.0  # [px/picture] motion that is drawn brightest; 0: the picture's greatest


class DenseFlow:
    """Motion of every pixel from one picture to the next."""

    def __init__(self, settings):
        self.settings = settings
        self._previous = None

    def update(self, picture):
        """Flow (h, w, 2) [px/picture, right and down] since the picture before; None for the first of its size."""
        settings = self.settings
        if settings.on_edges:
            current = find_edges(picture, EdgeSettings(settings.blur, settings.threshold))
        else:
            current = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        previous, self._previous = self._previous, current
        if previous is None or previous.shape != current.shape:
            return None
        pyramid = _PYRAMID_SCALE, settings.levels, settings.window, settings.iterations
        smooth = settings.poly_n, _SIGMA_PER_POLY_N * settings.poly_n
        return cv2.calcOpticalFlowFarneback(previous, current, None, *pyramid, *smooth, 0)


def flow_picture(flow, full_scale_px=0.0):
    """Picture (h, w, 3) of a flow (h, w, 2): hue is direction (red right, then clockwise), brightness is motion."""
    motion, direction_deg = cv2.cartToPolar(flow[..., 0], flow[..., 1], angleInDegrees=True)
    scale = full_scale_px or max(float(motion.max()), 1e-6)
    hsv = np.empty(flow.shape[:2] + (3,), np.uint8)
    hsv[..., 0] = (0.5 * direction_deg).astype(np.uint8) % 180  # OpenCV's hue is in steps of 2 degrees
    hsv[..., 1] = 255
    hsv[..., 2] = np.clip(255.0 * motion / scale, 0.0, 255.0)
    return cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)


@dataclass(frozen=True)
class SparseSettings(Settings):
    """Settings of `SparseFlow`."""

    points: between(1, 10000) = 200  # that are followed; new corners are sought when half of them are lost
    quality: between(1e-6, 1.0) = 0.01  # of a corner, as a fraction of the best one's
    distance: between(1, 1000) = 10  # [px] least one between two corners
    window: between(3, 101) = 21  # [px] compared around a point
    round_trip_px: between(1e-3, 100.0) = 0.5  # a point that does not come back to within this is dropped


class SparseFlow:
    """Follows corners from picture to picture."""

    def __init__(self, settings):
        self.settings = settings
        self._previous = None
        self._points = np.empty((0, 1, 2), np.float32)

    def update(self, picture):
        """(before, after): pixels (n, 2) of the points that were followed since the picture before; n may be 0."""
        current = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        previous, self._previous = self._previous, current
        if previous is None or previous.shape != current.shape:
            self._points = self._corners(current)
            return np.empty((0, 2), np.float32), np.empty((0, 2), np.float32)
        before, after = self._follow(previous, current)
        # New corners join in the place where they are now, and move from the next picture on.
        self._points = after if 2 * len(after) >= self.settings.points else self._corners(current)
        return before.reshape(-1, 2), after.reshape(-1, 2)

    def _follow(self, previous, current):
        if not len(self._points):
            return self._points, self._points
        size = {"winSize": (self.settings.window, self.settings.window), "maxLevel": _SPARSE_LEVELS}
        there, found, _ = cv2.calcOpticalFlowPyrLK(previous, current, self._points, None, **size)
        back, found_back, _ = cv2.calcOpticalFlowPyrLK(current, previous, there, None, **size)
        error_px = np.linalg.norm(back - self._points, axis=2).ravel()
        kept = (found.ravel() == 1) & (found_back.ravel() == 1) & (error_px < self.settings.round_trip_px)
        return self._points[kept], there[kept]

    def _corners(self, grey):
        settings = self.settings
        corners = cv2.goodFeaturesToTrack(grey, settings.points, settings.quality, settings.distance)
        return np.empty((0, 1, 2), np.float32) if corners is None else corners


def draw_motion(picture, before, after, colour=(0, 255, 0)):
    """Draw (in place) where points (n, 2) came from and where they are."""
    for start, end in zip(np.round(before).astype(int).tolist(), np.round(after).astype(int).tolist()):
        cv2.line(picture, start, end, colour, 1, cv2.LINE_AA)
        cv2.circle(picture, end, 2, colour, -1, cv2.LINE_AA)
