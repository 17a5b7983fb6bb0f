"""Paints as boxes in OpenCV's 8-bit HSV (thesis 4.4.5): hue 0..179 (half degrees), saturation and value 0..255.

HSV is the hexcone, V = max, S = (max - min) / max: the formulas printed in the thesis are those of HLS.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from risc_lab.settings import Settings, between

HUES = 180  # of an 8-bit picture
SIDE_MIN_PX = 8  # smaller pictures are ignored


@dataclass(frozen=True)
class HsvRange(Settings):
    """All colours that count as one paint. Limits are inclusive; a hue range with first > last wraps through red."""

    hue: tuple[between(0, HUES - 1), between(0, HUES - 1)]
    saturation: tuple[between(0, 255), between(0, 255)] = (0, 255)
    value: tuple[between(0, 255), between(0, 255)] = (0, 255)

    def __post_init__(self):
        super().__post_init__()
        for name in ("saturation", "value"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError("'%s' must be [lowest, highest], found %r: swap them" % (name, [low, high]))


class Planes:
    """Hue, saturation and value of one picture, and its masks; what several paints share is computed once."""

    def __init__(self, bgr, shrink=1):
        """bgr: (h, w, 3) uint8. shrink: by which factor the planes are smaller, which also averages the noise."""
        if shrink != 1:
            height, width = (side // shrink for side in bgr.shape[:2])
            whole = bgr[: height * shrink, : width * shrink]
            bgr = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
        self._planes = cv2.split(cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV))
        self._ranges = {}

    @property
    def hue(self):
        """(h, w) uint8 in 0..179."""
        return self._planes[0]

    def mask(self, paint):
        """(h, w) uint8: 255 where the picture has this paint (an HsvRange)."""
        first, last = paint.hue
        if first <= last:
            hue = self._range(0, first, last)
        else:
            hue = self._range(0, first, HUES - 1) | self._range(0, 0, last)
        return hue & self._range(1, *paint.saturation) & self._range(2, *paint.value)

    def _range(self, *key):
        if key not in self._ranges:
            plane, low, high = key
            self._ranges[key] = cv2.inRange(self._planes[plane], low, high)
        return self._ranges[key]


def as_bgr(image):
    """The picture as (h, w, 3) uint8 BGR; None for one that is grey or too small to hold anything.

    Raises ValueError for anything but a picture.
    """
    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3, 4)):
        raise ValueError(
            "a picture must be uint8 of shape (h, w, 3), BGR, found %s of shape %s" % (image.dtype, image.shape)
        )
    if min(image.shape[:2]) < SIDE_MIN_PX or image.ndim == 2 or image.shape[2] == 1:
        return None
    return np.ascontiguousarray(image[:, :, :3])


def check_paints(colours, item, keys):
    """Raises ValueError for the first of these fields of an item (which has a name) that is not one of the colours."""
    for key in keys:
        paint = getattr(item, key)
        if paint not in colours:
            raise ValueError(
                "%s: '%s' is %r, not a known colour; known are %s" % (item.name, key, paint, ", ".join(colours))
            )
