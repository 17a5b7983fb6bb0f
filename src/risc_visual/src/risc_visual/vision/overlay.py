"""Draws what was found into pictures. Needs no ROS."""

import math

import cv2

from risc_visual.vision.templates.drawing import (
    BLACK,
    RED,
    SHIFT,
    WHITE,
    draw_text,
    fixed,
    outline_rectangle,
    text_size,
)

# BGR of the original release's overlay, by ROI name.
_COLOURS = {"green": (0, 204, 204), "pink": (0, 0, 100), "Orange": (0, 153, 255), "blue": (200, 0, 100)}
_VEHICLE = (255, 255, 0)


def draw_landmarks(bgr, detections, ring_scale):
    """Outlines of centre and ring, centre, name and score of landmark_detector.Detections, in place."""
    for found in detections:
        colour = _COLOURS.get(found.name, WHITE)
        for scale, paint, thickness in ((1.0, colour, 2), (ring_scale, WHITE, 1)):
            outline = found.outline.grown(scale)
            place, axes = fixed(outline.x, outline.y), fixed(outline.semi_major, outline.semi_minor)
            angle_deg = math.degrees(outline.angle_rad)
            cv2.ellipse(bgr, place, axes, angle_deg, 0, 360, paint, thickness, cv2.LINE_AA, SHIFT)
        text = "%s %.2f%s" % (found.name, found.score, " (part)" if found.partial else "")
        _mark(bgr, found, text, found.y + ring_scale * found.outline.semi_major, colour)


def draw_vehicles(bgr, detections):
    """Rectangle, centre and name of vehicle_detector.VehicleDetections, in place."""
    for found in detections:
        corners = outline_rectangle(bgr, found.x, found.y, found.width, found.height, found.angle, _VEHICLE)
        _mark(bgr, found, found.name, corners[:, 1].max(), _VEHICLE)


def _mark(bgr, found, text, below, colour):
    """A cross in the middle, and below it a text, moved into the picture where it would leave it."""
    for dx, dy in ((6.0, 0.0), (0.0, 6.0)):
        ends = fixed(found.x - dx, found.y - dy), fixed(found.x + dx, found.y + dy)
        cv2.line(bgr, *ends, BLACK, 1, cv2.LINE_AA, SHIFT)
    cv2.circle(bgr, fixed(found.x, found.y), 2 << SHIFT, RED, cv2.FILLED, cv2.LINE_AA, SHIFT)
    width, height = text_size(text)
    x = min(max(2.0, found.x - 0.5 * width), bgr.shape[1] - width - 2.0)
    y = min(max(height + 2.0, below + height + 4.0), bgr.shape[0] - 3.0)
    draw_text(bgr, text, (x, y), colour)
