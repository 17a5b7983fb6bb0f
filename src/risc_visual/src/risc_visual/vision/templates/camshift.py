"""CamShift: follow something by its colours, at any size and rotation (Bradski 1998)."""

from dataclasses import dataclass

import cv2
import numpy as np

from risc_lab.settings import Fraction, Settings, between
from risc_visual.vision.templates.drawing import Region

_BINS = 36
_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 10, 1.0)


@dataclass(frozen=True)
class CamshiftSettings(Settings):
    """Settings of `CamshiftTracker`. Colours are hue only, so pale and dark pixels are ignored."""

    saturation_low: between(0, 255) = 60  # 0..255: of pixels that count
    value_low: between(0, 255) = 32
    value_high: between(0, 255) = 255
    likeness: Fraction = 0.25  # mean likeness to the target's colours in the window, below which it is lost
    least_px: between(1, 10**8) = 25  # [px^2] area below which it is lost


class CamshiftTracker:
    """Follows one target. While it is lost it is sought in the whole picture."""

    def __init__(self, settings):
        self.settings = settings
        self._histogram = None
        self._window = None  # x, y, width, height [px]; None: lost
        self._size = None  # width and height [px] when it was seen last

    def start(self, picture, rectangle):
        """Learn the target's colours from a rectangle (x, y, width, height) [px] of a picture (h, w, 3).

        Raises ValueError when nothing coloured is in it.
        """
        x, y, width, height = _clipped(rectangle, picture.shape)
        hue, coloured = self._hue(picture[y : y + height, x : x + width])
        if not width * height or cv2.countNonZero(coloured) < self.settings.least_px:
            raise ValueError(
                "the rectangle x %d, y %d, width %d, height %d has no colour to follow: place it on the target, or "
                "lower saturation_low and value_low" % tuple(rectangle)
            )
        histogram = cv2.calcHist([hue], [0], coloured, [_BINS], [0, 180])
        self._histogram = cv2.normalize(histogram, None, 0, 255, cv2.NORM_MINMAX)
        self._window, self._size = (x, y, width, height), (width, height)

    @property
    def started(self):
        """Whether there are colours to follow."""
        return self._histogram is not None

    def update(self, picture):
        """`Region` of the target in a picture (h, w, 3), or None while it is lost."""
        hue, coloured = self._hue(picture)
        likeness = cv2.calcBackProject([hue], [0], self._histogram, [0, 180], 1) & coloured
        start = self._window or self._most_like(likeness)
        box, window = cv2.CamShift(likeness, _clipped(start, picture.shape), _STOP)
        x, y, width, height = window = _clipped(window, picture.shape)
        inside = likeness[y : y + height, x : x + width]
        if width * height < self.settings.least_px or inside.mean() < 255.0 * self.settings.likeness:
            self._window = None
            return None
        self._window, self._size = window, (width, height)
        (x, y), (width, height), angle_deg = box
        return Region("target", x, y, width, height, angle_deg)

    def _most_like(self, likeness):
        """The window of the size seen last with the most likeness (h, w) in it."""
        width, height = self._size
        mean = cv2.boxFilter(likeness, cv2.CV_32F, (width, height), borderType=cv2.BORDER_CONSTANT)
        x, y = cv2.minMaxLoc(mean)[3]
        return x - width // 2, y - height // 2, width, height

    def _hue(self, picture):
        """(hue (h, w), mask (h, w) of the pixels whose hue is meaningful)."""
        if not picture.size:
            return np.empty((0, 0), np.uint8), np.empty((0, 0), np.uint8)
        hsv = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)
        settings = self.settings
        coloured = cv2.inRange(hsv, (0, settings.saturation_low, settings.value_low), (180, 255, settings.value_high))
        return hsv[..., 0].copy(), coloured


def _clipped(rectangle, shape):
    """The part of (x, y, width, height) that lies in a picture of this shape."""
    x, y, width, height = map(int, rectangle)
    left, right = np.clip((x, x + max(0, width)), 0, shape[1]).tolist()
    top, bottom = np.clip((y, y + max(0, height)), 0, shape[0]).tolist()
    return left, top, right - left, bottom - top
