"""Draws what was found into pictures. Needs no ROS."""

import math

import cv2
import numpy as np

# BGR of the original release's overlay, by ROI name.
_COLOURS = {"green": (0, 204, 204), "pink": (0, 0, 100), "Orange": (0, 153, 255), "blue": (200, 0, 100)}
_OTHER = (255, 255, 255)
_VEHICLE = (255, 255, 0)
_BLACK, _RED, _WHITE = (0, 0, 0), (0, 0, 255), (255, 255, 255)
_SHIFT = 4  # binary digits of a pixel that OpenCV's drawing functions get


def draw_landmarks(bgr, detections, ring_scale):
    """Outlines of centre and ring, centre, name and score of landmarks.Detections; the picture is drawn on."""
    for found in detections:
        colour = _COLOURS.get(found.name, _OTHER)
        for scale in (1.0, ring_scale):
            outline = found.outline.grown(scale)
            cv2.ellipse(
                bgr,
                _fixed(outline.x, outline.y),
                _fixed(outline.semi_major, outline.semi_minor),
                math.degrees(outline.angle_rad),
                0,
                360,
                colour if scale == 1.0 else _WHITE,
                2 if scale == 1.0 else 1,
                cv2.LINE_AA,
                _SHIFT,
            )
        _cross(bgr, found.x, found.y)
        text = "%s %.2f%s" % (found.name, found.score, " (part)" if found.partial else "")
        _label(bgr, text, found.x, found.y + ring_scale * found.outline.semi_major, colour)


def draw_vehicles(bgr, detections):
    """Rectangle, centre and name of vehicles.VehicleDetections; the picture is drawn on."""
    for found in detections:
        corners = cv2.boxPoints(((found.x, found.y), (found.width, found.height), found.angle))
        fixed = np.round(corners * (1 << _SHIFT)).astype(np.int32)
        cv2.polylines(bgr, [fixed], True, _VEHICLE, 2, cv2.LINE_AA, _SHIFT)
        _cross(bgr, found.x, found.y)
        _label(bgr, found.name, found.x, corners[:, 1].max(), _VEHICLE)


def _cross(bgr, x, y):
    for dx, dy in ((6.0, 0.0), (0.0, 6.0)):
        cv2.line(bgr, _fixed(x - dx, y - dy), _fixed(x + dx, y + dy), _BLACK, 1, cv2.LINE_AA, _SHIFT)
    cv2.circle(bgr, _fixed(x, y), 2 << _SHIFT, _RED, cv2.FILLED, cv2.LINE_AA, _SHIFT)


def _label(bgr, text, x, y, colour):
    """Text below a point, moved into the picture where it would leave it."""
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 1)
    x = int(min(max(2.0, x - 0.5 * width), bgr.shape[1] - width - 2.0))
    y = int(min(max(height + 2.0, y + height + 4.0), bgr.shape[0] - 3.0))
    cv2.putText(bgr, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _BLACK, 3, cv2.LINE_AA)
    cv2.putText(bgr, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.45, colour, 1, cv2.LINE_AA)


def _fixed(x, y):
    return int(round(x * (1 << _SHIFT))), int(round(y * (1 << _SHIFT)))
