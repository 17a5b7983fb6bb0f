"""Edge detection: grey, blurred, then Canny's detector."""

from dataclasses import dataclass

import cv2

from risc_visual.vision.templates.checks import within


@dataclass(frozen=True)
class EdgeSettings:
    """Settings of `find_edges`; the defaults are those of the original release."""

    blur: int = 2  # [px] radius of the box blur; 0: none
    threshold: int = 800  # gradient above which an edge is followed; the sums of a 7 x 7 kernel are large numbers
    ratio: float = 3.0  # an edge begins where the gradient is above threshold * ratio
    aperture: int = 7  # [px] width of the gradient's kernel: 3, 5 or 7

    def __post_init__(self):
        within(self, "blur", 0, 100)
        within(self, "threshold", 0, 100000)
        within(self, "ratio", 1.0, 100.0)
        if self.aperture not in (3, 5, 7):
            raise ValueError("parameter 'aperture' must be 3, 5 or 7, got %r" % self.aperture)


def find_edges(picture, settings):
    """Edges of a picture (h, w, 3): (h, w) uint8, 255 on an edge, else 0."""
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    width = 2 * settings.blur + 1
    smooth = cv2.blur(grey, (width, width))
    return cv2.Canny(smooth, settings.threshold, settings.ratio * settings.threshold, apertureSize=settings.aperture)
