"""Drawing over a picture: cross hair, text, rotated rectangles. All draw in place."""

import math
from typing import NamedTuple

import cv2
import numpy as np

BLACK = (0, 0, 0)
WHITE = (255, 255, 255)
RED = (0, 0, 255)
YELLOW = (0, 255, 255)
SHIFT = 4  # fractional bits of a pixel's coordinates for OpenCV's drawing functions
_FONT = cv2.FONT_HERSHEY_SIMPLEX, 0.5


class Region(NamedTuple):
    """A rotated rectangle with a name, as risc_msgs/Risc_roi."""

    name: str
    x: float  # [px] centre
    y: float
    width: float  # [px]
    height: float
    angle_deg: float = 0.0  # clockwise in the picture


def draw_crosshair(picture, rings=12, gap=(0.1, 0.2), arc_deg=10.0):
    """Cross hair of the original release: lines with a gap in the middle, scales of short arcs, a red dot.

    gap: fraction of (width, height) that the lines leave free.  arc_deg: half the length of each arc.
    """
    height, width = picture.shape[:2]
    x, y = width // 2, height // 2
    free_x, free_y = round(0.5 * gap[0] * width), round(0.5 * gap[1] * height)
    for start, end in (
        ((0, y), (x - free_x, y)),
        ((x + free_x, y), (width - 1, y)),
        ((x, 0), (x, y - free_y)),
        ((x, y + free_y), (x, height - 1)),
    ):
        cv2.line(picture, start, end, BLACK, 1)
    for ring in range(1, rings + 1):
        radius = round(0.5 * width * ring / rings)
        for direction_deg in (0, 90, 180, 270):
            cv2.ellipse(
                picture, (x, y), (radius, radius), direction_deg, -arc_deg, arc_deg, BLACK, 1, lineType=cv2.LINE_AA
            )
    cv2.circle(picture, (x, y), max(2, width // 200), RED, -1, cv2.LINE_AA)


def draw_region(picture, region, colour=YELLOW):
    """A `Region` and its name."""
    corners = outline_rectangle(picture, region.x, region.y, region.width, region.height, region.angle_deg, colour)
    if region.name:
        highest = corners[corners[:, 1].argmin()]
        draw_text(picture, region.name, (highest[0], highest[1] - 5.0), colour)


def outline_rectangle(picture, x, y, width, height, angle_deg, colour):
    """A rotated rectangle; returns its corners (4, 2)."""
    corners = cv2.boxPoints(((x, y), (width, height), angle_deg))
    cv2.polylines(picture, [np.int32(np.round(corners * (1 << SHIFT)))], True, colour, 2, cv2.LINE_AA, SHIFT)
    return corners


def draw_text(picture, text, position_px, colour=WHITE):
    """A line of text from a position on its base line, with a dark outline, so that it can be read on anything."""
    position = tuple(math.floor(value) for value in position_px)
    for thickness, paint in ((3, BLACK), (1, colour)):
        cv2.putText(picture, text, position, *_FONT, paint, thickness, cv2.LINE_AA)


def text_size(text):
    """(width, height) [px] of a line of text."""
    return cv2.getTextSize(text, *_FONT, 1)[0]


def fixed(x, y):
    """A point in fixed-point coordinates with SHIFT fractional bits, for OpenCV's drawing functions."""
    return int(round(x * (1 << SHIFT))), int(round(y * (1 << SHIFT)))


def draw_overlay(picture, regions=(), lines=()):
    """Everything at once: cross hair, `Region`s, and lines of text in the top left corner."""
    draw_crosshair(picture)
    for region in regions:
        draw_region(picture, region)
    for k, line in enumerate(lines):
        draw_text(picture, line, (8, 20 + 18 * k))
