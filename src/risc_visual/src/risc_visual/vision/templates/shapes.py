"""Shape detection: outlines with few corners, and circles."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from risc_lab.settings import Settings, between
from risc_visual.vision.templates.drawing import Region, draw_text

_POLYGONS = {3: "triangle", 4: "rectangle", 5: "pentagon", 6: "hexagon"}
_CLOSE = np.ones((3, 3), np.uint8)


@dataclass(frozen=True)
class ShapeSettings(Settings):
    """Settings of `find_shapes`."""

    blur: between(0, 50) = 2  # [px] radius of the Gaussian blur
    threshold: between(1, 1000) = 40  # gradient above which an outline is followed
    least_px: between(1, 10**8) = 200  # [px^2] smaller areas are noise
    tolerance: between(0.001, 0.2) = 0.03  # of the straight sides, as a fraction of the outline's length
    roundness: between(0.1, 1.0) = 0.88  # 4 pi area / length^2 above which an outline with many corners is a circle
    solidity: between(0.1, 1.0) = 0.9  # area over that of its convex hull, below which it is ignored


class Shape(NamedTuple):
    """One outline."""

    name: str  # triangle, square, rectangle (any other with four corners), pentagon, hexagon, circle
    corners: np.ndarray  # (n, 2) [px]; the whole outline of a circle
    region: Region  # the smallest rotated rectangle around it
    area_px: float


def find_shapes(picture, settings):
    """List of `Shape` in a picture (h, w, 3), the largest first. What lies inside another outline is ignored."""
    width = 2 * settings.blur + 1
    smooth = cv2.GaussianBlur(picture, (width, width), 0)
    # Each channel by itself: what differs from its background in hue only has no edge in the grey picture.
    edges = np.zeros(picture.shape[:2], np.uint8)
    for channel in cv2.split(smooth):
        edges |= cv2.Canny(channel, settings.threshold, 3 * settings.threshold)
    edges = cv2.morphologyEx(edges, cv2.MORPH_CLOSE, _CLOSE)  # an outline with a gap of a pixel has no inside
    outlines = cv2.findContours(edges, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    found = [shape for shape in (_named(outline, settings) for outline in outlines) if shape]
    return sorted(found, key=lambda shape: -shape.area_px)


def _named(outline, settings):
    """`Shape` of an outline (n, 1, 2), or None."""
    area_px, hull = cv2.contourArea(outline), cv2.convexHull(outline)
    if area_px < settings.least_px or area_px < settings.solidity * cv2.contourArea(hull):
        return None
    length_px = cv2.arcLength(hull, True)
    corners = cv2.approxPolyDP(hull, settings.tolerance * length_px, True)
    (x, y), (width, height), angle_deg = cv2.minAreaRect(hull)
    if len(corners) > 5 and 4.0 * math.pi * area_px / length_px**2 > settings.roundness and _is_ellipse(hull, area_px):
        name, corners = "circle", hull
    elif len(corners) in _POLYGONS:
        name = _POLYGONS[len(corners)]
        if name == "rectangle" and min(width, height) > 0.9 * max(width, height) and area_px > 0.9 * width * height:
            name = "square"
    else:
        return None
    return Shape(name, corners.reshape(-1, 2), Region(name, x, y, width, height, angle_deg), area_px)


def _is_ellipse(hull, area_px):
    """Whether the area is that of the ellipse through the outline; a hexagon's is 8 % less than its circle's."""
    (_, (width, height), _) = cv2.fitEllipse(hull) if len(hull) >= 5 else (None, (0.0, 0.0), None)
    return abs(area_px - 0.25 * math.pi * width * height) < 0.03 * area_px


def draw_shapes(picture, shapes, colour=(0, 255, 0)):
    """Draw (in place) the outlines of `Shape`s and their names."""
    for shape in shapes:
        cv2.polylines(picture, [shape.corners.astype(np.int32)], True, colour, 2, cv2.LINE_AA)
        draw_text(picture, shape.name, (shape.region.x - 30.0, shape.region.y), colour)
