"""visualization_msgs/Marker -> its shape in a page by viser (three.js). Needs no ROS master."""

import cv2
import numpy as np
from visualization_msgs.msg import Marker

_GROUND_RGB = np.array((0.08, 0.08, 0.08))  # of the dark page; lines have no opacity there, so they are mixed with it
_FAINT = 0.5  # texts less opaque than this are scenery: they lie on the floor, all others face the viewer
_FACETS = 2  # subdivisions of a ball, enough for what is small on the screen
_ROUND = 24  # sides of a cylinder
_LINE_MIN_M = 0.012  # a thinner line breaks up on a screen
_SHEET_M = 0.05  # a thinner faint box would hide what is behind it in three.js: it is drawn as a net of lines
_MESH_M, _MESH_LINE_M = 0.5, 0.006  # distance and width of these lines
_LABEL = 0.65  # of a text's height: a label stands on a white card that makes it larger
_TEXT_PX = 48  # height of a text on the floor, in its picture
# Texts on the floor are read from -x, as in the initial view: their right is -y, their top is +x. A picture's own axes
# are x to its right and y down.
_ON_FLOOR = np.array((np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0))  # x, y, z, w
_LINES = (Marker.LINE_STRIP, Marker.LINE_LIST)
_POINTS = (Marker.SPHERE_LIST, Marker.CUBE_LIST, Marker.POINTS)
SHAPES = frozenset(  # types that can be shown
    (Marker.ARROW, Marker.CUBE, Marker.SPHERE, Marker.CYLINDER, Marker.TEXT_VIEW_FACING, *_LINES, *_POINTS)
)


def look_of(marker):
    """(method of viser's scene that adds it, dict of its fixed arguments, dict of those that may change in place)."""
    size_m, rgba = (marker.scale.x, marker.scale.y, marker.scale.z), _rgba(marker.color)
    opacity = None if rgba[3] >= 1.0 else rgba[3]
    solid = {"color": rgba[:3], "opacity": opacity, "cast_shadow": False, "receive_shadow": False}
    if marker.type == Marker.SPHERE:
        return "add_icosphere", {"radius": 0.5, "scale": size_m, "subdivisions": _FACETS, **solid}, {}
    if marker.type == Marker.CYLINDER:
        return "add_cylinder", {"radius": 0.5, "scale": size_m, "radial_segments": _ROUND, **solid}, {}
    if marker.type == Marker.CUBE and rgba[3] < _FAINT and min(size_m) < _SHEET_M:
        lines = {"points": net_of_sheet(size_m), "colors": _mixed(marker.color)}
        return "add_line_segments", {"thickness": _MESH_LINE_M, **lines}, {}
    if marker.type == Marker.CUBE:
        return "add_box", {"dimensions": size_m, **solid}, {}
    if marker.type == Marker.ARROW:
        return "add_arrows", {"colors": _mixed(marker.color), **_arrow(marker, *size_m)}, {}
    if is_on_floor(marker):
        picture = text_picture(marker.text, rgba)
        width_m = size_m[2] * picture.shape[1] / picture.shape[0]
        size = {"render_width": width_m, "render_height": size_m[2]}
        return "add_image", {"image": picture, **size, "cast_shadow": False, "receive_shadow": False}, {}
    if marker.type == Marker.TEXT_VIEW_FACING:
        size = {"font_size_mode": "scene", "font_scene_height": _LABEL * size_m[2]}
        return "add_label", {"anchor": "center-center", **size}, {"text": marker.text}
    many = {"points": _in_order(_points(marker.points), marker.type), "colors": _mixed(marker.color)}
    fixed, free = {}, many
    if marker.colors and len(marker.colors) == len(marker.points):  # each has a colour of its own
        many["colors"] = _in_order(np.array([_mixed(colour) for colour in marker.colors]), marker.type)
        fixed, free = many, {}
    if marker.type in _LINES:
        return "add_line_segments", {"thickness": max(marker.scale.x, _LINE_MIN_M), **fixed}, free
    look = {"point_shape": "square"}
    if marker.type == Marker.SPHERE_LIST:
        look = {"point_shape": "circle", "point_shading": "gradient"}
    return "add_point_cloud", {"point_size": marker.scale.x, "precision": "float32", **look, **fixed}, free


def is_on_floor(marker):
    """Whether it is a text that lies on the floor."""
    return marker.type == Marker.TEXT_VIEW_FACING and marker.color.a < _FAINT


def turn_of(marker, turn):
    """Quaternion (4,) x, y, z, w that a marker has in the page: a text on the floor lies, however it was sent."""
    return _ON_FLOOR if is_on_floor(marker) else turn


def _rgba(colour):
    return colour.r, colour.g, colour.b, colour.a


def _mixed(colour):
    """A colour blended with the page's background, as integers."""
    *rgb, alpha = _rgba(colour)
    return (255.0 * (alpha * np.array(rgb) + (1.0 - alpha) * _GROUND_RGB)).astype(np.uint8)


def _points(points):
    return np.array([(point.x, point.y, point.z) for point in points], dtype=np.float32).reshape(-1, 3)


def _in_order(rows, shape):
    """Rows (n, 3) that belong to the points as viser wants them: of lines (n, 2, 3)."""
    if shape == Marker.LINE_STRIP:
        return np.stack([rows[:-1], rows[1:]], axis=1)
    return rows[: len(rows) // 2 * 2].reshape(-1, 2, 3) if shape == Marker.LINE_LIST else rows


def net_of_sheet(size_m):
    """Lines of a net in the two larger dimensions of a box: (n, 2, 3) [m], its centre being the origin."""
    found = []
    directions = np.argsort(size_m)[1:]
    for along, across in (directions, directions[::-1]):
        count = max(1, round(size_m[across] / _MESH_M)) + 1
        lines = np.zeros((count, 2, 3))
        lines[:, :, across] = np.linspace(-0.5, 0.5, count)[:, None] * size_m[across]
        lines[:, :, along] = np.array([-0.5, 0.5]) * size_m[along]
        found.append(lines)
    return np.concatenate(found)


def _arrow(marker, a, b, c):
    """With points: scale is shaft diameter, head diameter, head length; without: length, width, height along x."""
    if len(marker.points) >= 2:
        ends, shaft_m, head_m, head_length_m = _points(marker.points[:2]), a, b, c
    else:
        ends, shaft_m, head_m, head_length_m = np.array(((0.0, 0.0, 0.0), (a, 0.0, 0.0))), 0.5 * b, b, 0.25 * a
    return {
        "points": ends[None].astype(np.float32),
        "shaft_radius": 0.5 * shaft_m,
        "head_radius": 0.5 * head_m,
        "head_length": head_length_m or 0.2 * float(np.linalg.norm(ends[1] - ends[0])),
    }


def text_picture(text, rgba):
    """A line of text as a picture (h, w, 4) uint8 with a transparent background."""
    font, stroke = cv2.FONT_HERSHEY_SIMPLEX, 3
    scale = cv2.getFontScaleFromHeight(font, int(0.6 * _TEXT_PX), stroke)
    (width, _), _ = cv2.getTextSize(text, font, scale, stroke)
    shade = np.zeros((_TEXT_PX, width + 2 * stroke), dtype=np.uint8)
    cv2.putText(shade, text, (stroke, int(0.8 * _TEXT_PX)), font, scale, 255, stroke, cv2.LINE_AA)
    picture = np.empty(shade.shape + (4,), dtype=np.uint8)
    picture[..., :3] = np.multiply(rgba[:3], 255.0).astype(np.uint8)
    picture[..., 3] = (rgba[3] * shade).astype(np.uint8)
    return picture
