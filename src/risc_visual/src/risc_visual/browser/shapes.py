"""visualization_msgs/Marker -> what stands for it in a page by viser (three.js). Needs no ROS master."""

import cv2
import numpy as np
from visualization_msgs.msg import Marker

_GROUND_RGB = (0.08, 0.08, 0.08)  # of the dark page; lines have no opacity there, so they are mixed with it
_FAINT = 0.5  # texts less opaque than this are scenery: they lie on the floor, all others face the viewer
_FACETS = 2  # subdivisions of a ball, enough for what is small on the screen
_ROUND = 24  # sides of a cylinder
_LINE_MIN_M = 0.012  # a thinner line breaks up on a screen
_SHEET_M = 0.05  # a faint box that is thinner hides, for three.js, what is behind it: it is drawn as a net of lines
_MESH_M, _MESH_LINE_M = 0.5, 0.006  # distance and width of these lines
_LABEL = 0.65  # of a text's height: a label stands on a white card that makes it larger
_TEXT_PX = 48  # height of a text on the floor, in its picture
# Texts on the floor are read from -x, where the view begins: their right is -y, their top is +x. A picture's own axes
# are x to its right and y down.
_ON_FLOOR = (np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0)  # x, y, z, w


def add_marker(scene, path, marker, turn):
    """Add a marker to viser's scene; returns its handle. turn: (4,) quaternion x, y, z, w that `turn_of` gave."""
    return _ADD[marker.type](scene, path, marker, {"wxyz": np.roll(turn, 1)})


def change_marker(handle, before, marker):
    """Change what a marker looks like in place; False when it must be added anew. before: the marker as it was."""
    if (before.type, before.scale) != (marker.type, marker.scale):
        return False
    if marker.type == Marker.TEXT_VIEW_FACING and not is_on_floor(before) and not is_on_floor(marker):
        handle.text = marker.text
        return True
    if marker.type in _OF_POINTS and not before.colors and not marker.colors:
        handle.points, handle.colors = _points(marker.points, marker), _colours(marker)
        return True
    return False


def is_on_floor(marker):
    """Whether it is a text that lies on the floor."""
    return marker.type == Marker.TEXT_VIEW_FACING and marker.color.a < _FAINT


def turn_of(marker, turn):
    """Quaternion (4,) x, y, z, w that a marker has in the page: a text on the floor lies, however it was sent."""
    return _ON_FLOOR if is_on_floor(marker) else turn


def _size(marker):
    return marker.scale.x, marker.scale.y, marker.scale.z


def _solid(marker):
    """Colour and opacity of a body."""
    colour = marker.color
    opacity = None if colour.a >= 1.0 else colour.a
    return {"color": (colour.r, colour.g, colour.b), "opacity": opacity, "cast_shadow": False, "receive_shadow": False}


def _mixed(colour):
    """A colour on the ground of the page, as integers."""
    rgb = np.array((colour.r, colour.g, colour.b))
    return (255.0 * (colour.a * rgb + (1.0 - colour.a) * np.array(_GROUND_RGB))).astype(np.uint8)


def _points(items, marker):
    """What belongs to the points as viser wants it: (n, 3), of lines (n, 2, 3). items: Points, or arrays (3,)."""
    rows = [(item.x, item.y, item.z) if hasattr(item, "x") else item for item in items]
    rows = np.array(rows, dtype=np.float32).reshape(-1, 3)
    if marker.type == Marker.LINE_STRIP:
        return np.stack([rows[:-1], rows[1:]], axis=1)
    if marker.type == Marker.LINE_LIST:
        return rows[: len(rows) // 2 * 2].reshape(-1, 2, 3)
    return rows


def _colours(marker):
    """Colours of the points: (3,) if they have none of their own, else in the order of `_points`."""
    if len(marker.colors) != len(marker.points) or not marker.colors:
        return _mixed(marker.color)
    return _points(map(_mixed, marker.colors), marker).astype(np.uint8)


def _add_ball(scene, path, marker, pose):
    return scene.add_icosphere(path, 0.5, scale=_size(marker), subdivisions=_FACETS, **_solid(marker), **pose)


def _add_box(scene, path, marker, pose):
    if marker.color.a < _FAINT and min(_size(marker)) < _SHEET_M:
        lines = net_of_sheet(_size(marker))
        return scene.add_line_segments(path, lines, _mixed(marker.color), thickness=_MESH_LINE_M, **pose)
    return scene.add_box(path, dimensions=_size(marker), **_solid(marker), **pose)


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


def _add_cylinder(scene, path, marker, pose):
    return scene.add_cylinder(path, 0.5, 1.0, scale=_size(marker), radial_segments=_ROUND, **_solid(marker), **pose)


def _add_arrow(scene, path, marker, pose):
    """With points: scale is shaft diameter, head diameter, head length; without: length, width, height along x."""
    a, b, c = _size(marker)
    if len(marker.points) >= 2:
        ends, shaft_m, head_m, head_length_m = _points(marker.points[:2], marker), a, b, c
    else:
        ends, shaft_m, head_m, head_length_m = np.array(((0.0, 0.0, 0.0), (a, 0.0, 0.0))), 0.5 * b, b, 0.25 * a
    return scene.add_arrows(
        path,
        ends[None].astype(np.float32),
        _mixed(marker.color),
        shaft_radius=0.5 * shaft_m,
        head_radius=0.5 * head_m,
        head_length=head_length_m or 0.2 * float(np.linalg.norm(ends[1] - ends[0])),
        **pose,
    )


def _add_lines(scene, path, marker, pose):
    width_m = max(marker.scale.x, _LINE_MIN_M)
    return scene.add_line_segments(path, _points(marker.points, marker), _colours(marker), thickness=width_m, **pose)


def _add_points(scene, path, marker, pose):
    is_round = marker.type == Marker.SPHERE_LIST
    look = {"point_shape": "circle", "point_shading": "gradient"} if is_round else {"point_shape": "square"}
    points, colours = _points(marker.points, marker), _colours(marker)
    return scene.add_point_cloud(path, points, colours, point_size=marker.scale.x, precision="float32", **look, **pose)


def _add_text(scene, path, marker, pose):
    height_m = marker.scale.z
    if not is_on_floor(marker):
        size = {"font_size_mode": "scene", "font_scene_height": _LABEL * height_m}
        return scene.add_label(path, marker.text, anchor="center-center", **size, **pose)
    picture = text_picture(marker.text, (marker.color.r, marker.color.g, marker.color.b, marker.color.a))
    width_m = height_m * picture.shape[1] / picture.shape[0]
    return scene.add_image(path, picture, width_m, height_m, cast_shadow=False, receive_shadow=False, **pose)


def text_picture(text, rgba):
    """A line of text as a picture (h, w, 4) uint8: its colour on nothing."""
    font, stroke = cv2.FONT_HERSHEY_SIMPLEX, 3
    scale = cv2.getFontScaleFromHeight(font, int(0.6 * _TEXT_PX), stroke)
    (width, _), _ = cv2.getTextSize(text, font, scale, stroke)
    shade = np.zeros((_TEXT_PX, width + 2 * stroke), dtype=np.uint8)
    cv2.putText(shade, text, (stroke, int(0.8 * _TEXT_PX)), font, scale, 255, stroke, cv2.LINE_AA)
    picture = np.empty(shade.shape + (4,), dtype=np.uint8)
    picture[..., :3] = np.multiply(rgba[:3], 255.0).astype(np.uint8)
    picture[..., 3] = (rgba[3] * shade).astype(np.uint8)
    return picture


_ADD = {
    Marker.ARROW: _add_arrow,
    Marker.CUBE: _add_box,
    Marker.SPHERE: _add_ball,
    Marker.CYLINDER: _add_cylinder,
    Marker.LINE_STRIP: _add_lines,
    Marker.LINE_LIST: _add_lines,
    Marker.CUBE_LIST: _add_points,
    Marker.SPHERE_LIST: _add_points,
    Marker.POINTS: _add_points,
    Marker.TEXT_VIEW_FACING: _add_text,
}
_OF_POINTS = {kind for kind, add in _ADD.items() if add in (_add_lines, _add_points)}
SHAPES = frozenset(_ADD)  # types that can be shown
