"""visualization_msgs markers as rviz accepts them, and what is drawn of the arena, of rays and of paths.

Frame: cortex for all but rays, which are in the frame of a camera. Namespaces, colours and sizes are those of the
original release; ids are stable, so that a marker replaces its predecessor. Every marker has a lifetime: what is
no longer sent vanishes.
"""

import functools

import genpy
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from risc_lab.lab.arena import Arena

FRAME_ID = "cortex"

WHITE = (1.0, 1.0, 1.0)
RED = (1.0, 0.0, 0.0)
GREEN = (0.0, 1.0, 0.0)
ORANGE = (1.0, 0.4, 0.0)
ORIGIN = (0.0, 0.0, 0.0)
_NO_TURN = Quaternion(0.0, 0.0, 0.0, 1.0)
LABEL_M = (0.25, 0.0, 0.3)  # from a thing to its name: off the hull, in a view from above, too
NAME_M = 0.17  # heights of names, ...
TEXT_M = 0.3  # ... of a text that stands alone, ...
LINE_M = 0.2  # ... and of one that is a line among others
FLOWN_M, DESIRED_M = 0.04, 0.02  # widths of paths: the desired one is seen on the one flown
_BEHIND_M = 0.8


# The values of a message are shared where they repeat: a message is written once and only read after that.
_rgba = functools.lru_cache(maxsize=1024)(ColorRGBA)
_vector = functools.lru_cache(maxsize=1024)(Vector3)
_duration = functools.lru_cache(maxsize=64)(genpy.Duration.from_sec)


def header(stamp=None, frame_id=FRAME_ID):
    """Header, by default in the frame cortex; without a stamp rviz uses the newest pose of the frame."""
    return Header(stamp=stamp or genpy.Time(), frame_id=frame_id)


class Pen:
    """Makes markers that have the same header and the same lifetime."""

    def __init__(self, lifetime_s, head=None):
        self.header = head or header()
        self._lifetime = _duration(lifetime_s)

    def marker(self, ns, number, shape, at_m, size_m, rgba, turn=_NO_TURN, points_m=(), text=""):
        """One marker. shape: a type of Marker; turn: geometry_msgs/Quaternion, marker axes to those of the frame."""
        return Marker(
            header=self.header,
            ns=ns,
            id=number,
            type=shape,
            pose=Pose(Point(*at_m), turn),
            scale=_vector(*size_m),
            color=_rgba(*rgba),
            lifetime=self._lifetime,
            points=[Point(*point) for point in points_m],
            text=text,
        )

    def ball(self, ns, number, at_m, diameter_m, rgba):
        """A sphere."""
        return self.marker(ns, number, Marker.SPHERE, at_m, (diameter_m,) * 3, rgba)

    def line(self, ns, number, points_m, width_m, rgba, shape=Marker.LINE_STRIP):
        """A line through points, or with LINE_LIST lines between two points each."""
        return self.marker(ns, number, shape, ORIGIN, (width_m, 0.0, 0.0), rgba, points_m=points_m)

    def text(self, ns, number, text, at_m, height_m, rgba):
        """A text that faces the viewer, centred at a position."""
        return self.marker(ns, number, Marker.TEXT_VIEW_FACING, at_m, (0.0, 0.0, height_m), rgba, text=text)

    def label(self, ns, number, text, at_m, rgba, side=1.0):
        """The name of the thing at a position: above it, with side -1 below."""
        place_m = tuple(value + side * offset for value, offset in zip(at_m, LABEL_M))
        return self.text(ns, number, text, place_m, NAME_M, rgba)


def is_known(position_m):
    """False for what stands for 'not seen': NaN, or the 10 km of the original release."""
    return all(abs(value) < 1000.0 for value in position_m)


def gone_marker(ns, number):
    """Makes rviz delete an expired marker, and its status message if it could not place it."""
    return Marker(header=header(), ns=ns, id=number, action=Marker.DELETE)


def pyramid(far_m, wide_m, high_m):
    """Ends of the lines (x, y, z) of what a camera sees: edges from its centre, and a frame. x: the optical axis."""
    corners = [(far_m, y, z) for y, z in ((wide_m, high_m), (-wide_m, high_m), (-wide_m, -high_m), (wide_m, -high_m))]
    edges = [end for corner in corners for end in (ORIGIN, corner)]
    return edges + [end for side in zip(corners, corners[1:] + corners[:1]) for end in side]


def net_markers(pen, net):
    """The net: four panels (ids 0..3) and the edges of the box (id 4)."""
    found = [pen.marker("Net", k, Marker.CUBE, *wall, WHITE + (0.1,)) for k, wall in enumerate(net.walls())]
    edges = net.edges().tolist()
    return found + [pen.line("Net", 4, edges, 2.0 * net.thickness_m, WHITE + (0.4,), Marker.LINE_LIST)]


def grid_markers(pen, grid, net):
    """Numbers along the edges of the floor, ids in the order of `Grid.labels`."""
    labels = enumerate(grid.labels(net))
    return [pen.text("grid", k, text, at_m, grid.text_height_m, WHITE + (0.3,)) for k, (text, at_m) in labels]


def camera_markers(pen, cameras):
    """Motion capture cameras: housings (ids 0..n-1), lenses (n..2n-1) and the corners of what each sees (2n..3n-1)."""
    lines, n, found = pyramid(0.5, 0.2, 0.15), len(cameras.poses), []
    for k, (pose, rotation) in enumerate(zip(cameras.poses, cameras.turns())):
        turn = Quaternion(*rotation.as_quat().tolist())
        at_m, lens_m = pose.position_m, (pose.position_m + rotation.apply((0.10, 0.0, 0.0))).tolist()
        for number, shape, place_m, size_m, rgba, points_m in (
            (k, Marker.CUBE, at_m, (0.14, 0.10, 0.10), WHITE + (0.6,), ()),
            (n + k, Marker.SPHERE, lens_m, (0.08, 0.08, 0.08), (1.0, 0.2, 0.2, 0.8), ()),
            (2 * n + k, Marker.LINE_LIST, at_m, (0.006, 0.0, 0.0), WHITE + (0.25,), lines),
        ):
            found.append(pen.marker("Camera", number, shape, place_m, size_m, rgba, turn, points_m))
    return found


def title_marker(pen, text, arena=Arena()):
    """Title, what is flown: a text behind the far wall, where it covers no vehicle, seen from behind or from above."""
    at_m = (arena.half_x_m + _BEHIND_M, 0.0, arena.height_m)
    return pen.text("trajectory_name", 0, text, at_m, TEXT_M, ORANGE + (1.0,))


def ray_markers(pen, observer, numbered, alpha, label_alpha=0.0):
    """Rays of one picture as lines from the camera: ns = observer, for vehicles that are seen `<observer>/vehicles`;
    unless label_alpha is 0 also names at their ends: ns = `<observer>/names`.

    pen: with the stamp of the picture and the frame of the camera. numbered: list of (number, rays.Ray); the number is
    the id, the same for the same thing at all times.
    """
    found = []
    for number, ray in numbered:
        ns = "%s/vehicles" % observer if ray.is_vehicle else observer
        found.append(pen.line(ns, number, (ORIGIN, ray.end_m), ray.width_m, ray.rgb + (alpha,), Marker.LINE_LIST))
        if label_alpha:
            rgba = ray.rgb + (label_alpha,)
            found.append(pen.text("%s/names" % observer, number, ray.name, ray.end_m, NAME_M, rgba))
    return found
