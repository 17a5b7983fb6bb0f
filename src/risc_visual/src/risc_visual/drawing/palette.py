"""Colours of landmarks and of the rays towards them, by the paint of the disc in their middle. Needs no ROS."""

import colorsys

from risc_visual.vision.colours import HUES

WHITE_RGB = (1.0, 1.0, 1.0)
# Those of the original release; other paints have the colour of their hue.
SPHERE_RGB = {"orange": (1.0, 0.6, 0.0), "green": (0.0, 1.0, 0.0), "blue": (0.0, 0.0, 1.0), "pink": (1.0, 0.0, 0.5)}
RAY_RGB = {
    "orange": (1.0, 0.27, 0.0),
    "green": (0.0, 1.0, 0.0),
    "blue": (0.0, 0.0, 1.0),
    "pink": (0.78, 0.082, 0.52),
}


def sphere_colours(landmarks):
    """dict mocap template -> (r, g, b). landmarks: landmark_config.LandmarksConfig."""
    return {kind.name: _rgb(SPHERE_RGB, kind.centre, landmarks.colours) for kind in landmarks.landmarks}


def ray_colours(landmarks):
    """dict name -> (r, g, b), under both names of every landmark: that on /land_rois and its mocap template's."""
    rgb = {kind: _rgb(RAY_RGB, kind.centre, landmarks.colours) for kind in landmarks.landmarks}
    colours = {kind.name: rgb[kind] for kind in landmarks.landmarks}
    colours.update({kind.roi_name: rgb[kind] for kind in landmarks.landmarks})
    return colours


def _rgb(known, paint, ranges):
    return known[paint] if paint in known else _of_hue(*ranges[paint].hue)


def _of_hue(first, last):
    """(r, g, b) of the middle of a range of OpenCV's hues; one that wraps has first > last."""
    middle = (first + 0.5 * ((last - first) % HUES)) % HUES
    return colorsys.hsv_to_rgb(middle / HUES, 1.0, 1.0)
