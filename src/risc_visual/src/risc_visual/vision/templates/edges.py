"""Edge detection: grey, blurred, then Canny's detector."""

from dataclasses import dataclass
from typing import Literal

import cv2

from risc_lab.settings import Settings, between


@dataclass(frozen=True)
class EdgeSettings(Settings):
    """Settings of `find_edges`; the defaults are those of the original release."""

    blur: between(0, 100) = 2  # [px] radius of the box blur; 0: none
    threshold: between(0, 100000) = 800  # gradient above which an edge is followed; large for a 7 x 7 kernel
    ratio: between(1.0, 100.0) = 3.0  # an edge begins where the gradient is above threshold * ratio
    aperture: Literal[3, 5, 7] = 7  # [px] width of the gradient's kernel


def find_edges(picture, settings):
    """Edges of a picture (h, w, 3): (h, w) uint8, 255 on an edge, else 0."""
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    width = 2 * settings.blur + 1
    smooth = cv2.blur(grey, (width, width))
    return cv2.Canny(smooth, settings.threshold, settings.ratio * settings.threshold, apertureSize=settings.aperture)
