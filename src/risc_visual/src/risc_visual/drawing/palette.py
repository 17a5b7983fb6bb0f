"""Colours of vehicles, of landmarks and rays by the paint in the disc's middle; all colours on white. Needs no ROS."""

import colorsys

import numpy as np

from risc_visual.vision.colours import HUES

WHITE_RGB = (1.0, 1.0, 1.0)
# Those of the original release; other paints have the colour of their hue.
SPHERE_RGB = {"orange": (1.0, 0.6, 0.0), "green": (0.0, 1.0, 0.0), "blue": (0.0, 0.0, 1.0), "pink": (1.0, 0.0, 0.5)}
RAY_RGB = {**SPHERE_RGB, "orange": (1.0, 0.27, 0.0), "pink": (0.78, 0.082, 0.52)}
# Distinct from each other on a dark ground, and from colours with a meaning: red (flown), green (desired).
_VEHICLES_RGB = (
    (0.30, 0.70, 1.00),
    (1.00, 0.80, 0.25),
    (0.75, 0.55, 1.00),
    (0.25, 0.90, 0.80),
    (1.00, 0.60, 0.75),
    (0.80, 0.85, 0.55),
    (0.85, 0.85, 0.90),
    (0.90, 0.65, 0.45),
)
_PRINT_LUMINANCE = 0.25  # the most on white paper: a contrast of 3.5 : 1
_GREY_CHROMA = 0.15  # less is grey
_LUMINANCE = np.array((0.2126, 0.7152, 0.0722))  # of linear sRGB


def on_white(rgb):
    """(r, g, b) for a white ground from (r, g, b) for a black one: greys are inverted, bright colours darkened."""
    rgb = np.asarray(rgb, dtype=float)
    if np.ptp(rgb) < _GREY_CHROMA:
        return tuple((1.0 - rgb).tolist())
    linear = rgb**2.2
    return tuple((rgb * min(1.0, _PRINT_LUMINANCE / (_LUMINANCE @ linear)) ** (1.0 / 2.2)).tolist())


def vehicle_colour(index):
    """(r, g, b) of the vehicle with this index; they repeat after eight."""
    return _VEHICLES_RGB[index % len(_VEHICLES_RGB)]


def sphere_colours(landmarks):
    """dict mocap template -> (r, g, b). landmarks: landmark_config.LandmarksConfig."""
    return {kind.name: _rgb(SPHERE_RGB, kind.centre, landmarks.colours) for kind in landmarks.landmarks}


def ray_colours(landmarks):
    """dict name -> (r, g, b), under both names of every landmark: that on /land_rois and its mocap template's."""
    kinds = landmarks.landmarks
    named = [(kind.name, kind) for kind in kinds] + [(kind.roi_name, kind) for kind in kinds]
    return {name: _rgb(RAY_RGB, kind.centre, landmarks.colours) for name, kind in named}


def _rgb(known, paint, ranges):
    """(r, g, b) of a paint; if not known, from the middle of its range of hues, which may wrap through red."""
    if paint in known:
        return known[paint]
    first, last = ranges[paint].hue
    middle = (first + 0.5 * ((last - first) % HUES)) % HUES
    return colorsys.hsv_to_rgb(middle / HUES, 1.0, 1.0)
