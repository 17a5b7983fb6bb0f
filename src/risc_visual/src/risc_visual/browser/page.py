"""The laboratory in a web browser: a page by viser (three.js) that loads nothing from elsewhere. No ROS.

What is drawn is decided in marker_scene, what the panel says in live_status; here both become viser's messages.
"""

import cv2
import numpy as np

from risc_visual.browser.live_status import PAGE_STYLE
from risc_visual.browser.marker_scene import Draw, Erase, Look, Placement, Shape

_GROUND_RGB = (0.08, 0.08, 0.08)  # of the dark page; lines have no opacity there, so they are mixed with it
_FAINT = 0.5  # texts less opaque than this are scenery: they lie on the floor, all others face the viewer
_FACETS = 2  # subdivisions of a ball, enough for what is small on the screen
_ROUND = 24  # sides of a cylinder
_LINE_MIN_M = 0.012  # a thinner line breaks up on a screen
_SHEET_M = 0.05  # a faint box that is thinner hides, for three.js, what is behind it: it is drawn as a net of lines
_MESH_M, _MESH_LINE_M = 0.5, 0.006  # distance and width of these lines
_LABEL = 0.65  # of a text's height: a label stands on a white card that makes it larger
_TEXT_PX = 48  # height of a text on the floor, in its picture
_HALF = float(np.sqrt(0.5))
# Texts on the floor are read from -x, where the view begins: their right is -y, their top is +x. A picture's own axes
# are x to its right and y down.
_ON_FLOOR = (_HALF, -_HALF, 0.0, 0.0)  # x, y, z, w
_EYE_M, _LOOKS_AT_M, _FIELD_RAD = (-6.3, 3.6, 4.2), (0.0, -0.1, 0.9), 0.75  # where the view begins
_TILE_M = 0.5
_AMBIENT = 1.0  # beside viser's own two lights


class BrowserScene:
    """The scene of the page, kept equal to what a `MarkerScene` says."""

    def __init__(self, server, half_x_m, half_y_m):
        """half_x_m, half_y_m: half the floor's size."""
        self._server = server
        self._scene = server.scene
        self._nodes = {}  # path -> (handle, Look or None for a group)
        server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        view = server.initial_camera
        view.position, view.look_at, view.fov = _EYE_M, _LOOKS_AT_M, _FIELD_RAD
        # Light that is cheap: the page must do on computers whose browser draws by software.
        self._scene.configure_environment_map(None)
        self._scene.configure_default_lights(enabled=True, cast_shadow=False)
        self._scene.add_light_ambient("/light", intensity=_AMBIENT)
        self._scene.add_grid(
            "/floor",
            width=2.0 * half_x_m,
            height=2.0 * half_y_m,
            cell_size=_TILE_M,
            section_size=2.0 * _TILE_M,
            cell_color=(60, 60, 60),
            section_color=(90, 90, 90),
            shadow_opacity=0.0,
        )

    def apply(self, changes):
        """Do what `MarkerScene.changes` found, all that can be done. Raises the first error, afterwards."""
        with self._server.atomic():
            problems = [error for error in map(self._try, changes) if error is not None]
        if problems:
            raise problems[0]

    def _try(self, change):
        """Returns the error, None when there was none."""
        try:
            self._apply(change)
        except Exception as error:  # whatever it is, the others count as drawn
            return error
        return None

    def _apply(self, change):
        if isinstance(change, Erase):
            if change.path in self._nodes:  # else drawing it has failed
                self._nodes.pop(change.path)[0].remove()
        elif isinstance(change, Draw):
            self._draw(change)
        elif change.path in self._nodes:
            handle, look = self._nodes[change.path]
            placement = _as_seen(look, change.placement)
            handle.position, handle.wxyz = placement.position_m, _wxyz(placement)
        else:
            handle = self._scene.add_frame(change.path, show_axes=False, **_pose(change.placement))
            self._nodes[change.path] = handle, None

    def clear(self):
        """Nothing is drawn any more but the floor."""
        with self._server.atomic():
            for path in sorted(self._nodes, key=len, reverse=True):
                self._nodes.pop(path)[0].remove()

    def _draw(self, change):
        path, look = change.path, change.look
        placement = _as_seen(look, change.placement)
        handle, before = self._nodes.get(path, (None, None))
        if before is None or not _restyle(handle, before, look):
            handle = _ADD[look.shape](self._scene, path, look, _pose(placement))
        else:
            handle.position, handle.wxyz = placement.position_m, _wxyz(placement)
        self._nodes[path] = handle, look


class BrowserPanel:
    """The panel of the page: the button that lands all, those that land one, and the status."""

    def __init__(self, server, names, land_all, land_one):
        """names: of the vehicles; land_all(), land_one(name): called in a thread of its own for a button pressed."""
        gui = server.gui
        gui.set_panel_label("RISC MAAP")
        gui.main_panel.dock_right()
        gui.add_html(PAGE_STYLE)
        button = gui.add_button("LAND ALL", color="red", hint="Every vehicle lands where it is, whoever flies it")
        button.on_click(lambda _event: land_all())
        self._status = gui.add_html("")
        for name in names:  # a button each: one for several may say another vehicle by the time it is asked
            gui.add_button("land %s" % name).on_click(lambda _event, name=name: land_one(name))

    def show(self, html):
        """What the status says now."""
        self._status.content = html


def _restyle(handle, before, look):
    """Change a drawn marker in place; False when it must be drawn anew."""
    if before.shape != look.shape or before.size_m != look.size_m:
        return False
    if look.shape == Shape.TEXT:
        if _is_faint(before) or _is_faint(look):
            return False
        handle.text = look.text
        return True
    if look.shape in _LINES | _CLOUDS and not before.colours and not look.colours:
        handle.points, handle.colors = _points(look), _point_colours(look)
        return True
    return False


def _as_seen(look, placement):
    """Where viser is to put it: a text on the floor lies, whatever orientation it was sent with."""
    if look is not None and look.shape == Shape.TEXT and _is_faint(look):
        return Placement(placement.position_m, _ON_FLOOR)
    return placement


def _is_faint(look):
    return look.rgba[3] < _FAINT


def _pose(placement):
    return {"position": placement.position_m, "wxyz": _wxyz(placement)}


def _wxyz(placement):
    x, y, z, w = placement.quaternion
    return w, x, y, z


def _solid(look):
    """Colour and opacity of a body."""
    return {
        "color": look.rgba[:3],
        "opacity": None if look.rgba[3] >= 1.0 else look.rgba[3],
        "cast_shadow": False,
        "receive_shadow": False,
    }


def _mixed(rgba):
    """A colour on the ground of the page, as integers: lines and points have no opacity of their own."""
    return tuple(int(255.0 * (rgba[3] * c + (1.0 - rgba[3]) * g)) for c, g in zip(rgba, _GROUND_RGB))


def _points(look):
    """Points of a look as viser wants them: (n, 3), of lines (n, 2, 3)."""
    points_m = np.array(look.points_m, dtype=np.float32).reshape(-1, 3)
    if look.shape == Shape.LINE_STRIP:
        return np.stack([points_m[:-1], points_m[1:]], axis=1)
    if look.shape == Shape.LINE_LIST:
        return points_m[: len(points_m) // 2 * 2].reshape(-1, 2, 3)
    return points_m


def _point_colours(look):
    """Colours of the points: (3,) if they have none of their own, else in the order of `_points`."""
    if len(look.colours) != len(look.points_m) or not look.colours:
        return np.array(_mixed(look.rgba), dtype=np.uint8)
    own = Look(look.shape, look.size_m, look.rgba, tuple(map(_mixed, look.colours)))
    return _points(own).astype(np.uint8)


def _add_ball(scene, path, look, pose):
    return scene.add_icosphere(path, 0.5, scale=look.size_m, subdivisions=_FACETS, **_solid(look), **pose)


def _add_box(scene, path, look, pose):
    if _is_faint(look) and min(look.size_m) < _SHEET_M:
        colour = np.array(_mixed(look.rgba), dtype=np.uint8)
        return scene.add_line_segments(path, net_of_sheet(look.size_m), colour, thickness=_MESH_LINE_M, **pose)
    return scene.add_box(path, dimensions=look.size_m, **_solid(look), **pose)


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


def _add_cylinder(scene, path, look, pose):
    return scene.add_cylinder(path, 0.5, 1.0, scale=look.size_m, radial_segments=_ROUND, **_solid(look), **pose)


def _add_arrow(scene, path, look, pose):
    """With points: scale is shaft diameter, head diameter, head length; without: length, width, height along x."""
    a, b, c = look.size_m
    if len(look.points_m) >= 2:
        ends, shaft_m, head_m, head_length_m = look.points_m[:2], a, b, c
    else:
        ends, shaft_m, head_m, head_length_m = ((0.0, 0.0, 0.0), (a, 0.0, 0.0)), 0.5 * b, b, 0.25 * a
    return scene.add_arrows(
        path,
        np.array([ends], dtype=np.float32),
        np.array(_mixed(look.rgba), dtype=np.uint8),
        shaft_radius=0.5 * shaft_m,
        head_radius=0.5 * head_m,
        head_length=head_length_m or 0.2 * float(np.linalg.norm(np.subtract(*ends))),
        **pose,
    )


def _add_lines(scene, path, look, pose):
    width_m = max(look.size_m[0], _LINE_MIN_M)
    return scene.add_line_segments(path, _points(look), _point_colours(look), thickness=width_m, **pose)


def _add_points(scene, path, look, pose):
    round_ = look.shape == Shape.SPHERE_LIST
    return scene.add_point_cloud(
        path,
        _points(look),
        _point_colours(look),
        point_size=look.size_m[0],
        point_shape="circle" if round_ else "square",
        point_shading="gradient" if round_ else "flat",
        precision="float32",
        **pose,
    )


def _add_text(scene, path, look, pose):
    height_m = look.size_m[2]
    if not _is_faint(look):
        size = {"font_size_mode": "scene", "font_scene_height": _LABEL * height_m}
        return scene.add_label(path, look.text, anchor="center-center", **size, **pose)
    picture = text_picture(look.text, look.rgba)
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


_LINES = frozenset((Shape.LINE_STRIP, Shape.LINE_LIST))
_CLOUDS = frozenset((Shape.SPHERE_LIST, Shape.CUBE_LIST, Shape.POINTS))
_ADD = {
    Shape.ARROW: _add_arrow,
    Shape.CUBE: _add_box,
    Shape.SPHERE: _add_ball,
    Shape.CYLINDER: _add_cylinder,
    Shape.LINE_STRIP: _add_lines,
    Shape.LINE_LIST: _add_lines,
    Shape.CUBE_LIST: _add_points,
    Shape.SPHERE_LIST: _add_points,
    Shape.POINTS: _add_points,
    Shape.TEXT: _add_text,
}
SHAPES = frozenset(_ADD)  # that can be shown
