"""Everything that rviz is told, as functions from values to visualization_msgs markers.

Frame: that of the header; cortex for all but rays, which are in the frame of a camera. Namespaces, colours and sizes
are those of the original release; ids are stable, so that a marker replaces its predecessor. Every marker has a
lifetime: what nobody sends any more vanishes.
"""

import functools
import math

import genpy
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from scipy.spatial.transform import Rotation
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from risc_lab.lab.arena import Arena
from risc_visual.drawing.airframes import PAINT
from risc_visual.drawing.trails import MAX_PIECES

FRAME_ID = "cortex"

WHITE = (1.0, 1.0, 1.0, 1.0)
RED = (1.0, 0.0, 0.0, 1.0)
GREEN = (0.0, 1.0, 0.0, 1.0)
ORANGE = (1.0, 0.4, 0.0, 1.0)
PENDULUM = (1.0, 0.6, 0.0)
_OTHER_LANDMARK = (1.0, 1.0, 1.0, 0.4)
_WAYPOINT = (1.0, 1.0, 1.0)
_BARE_RGB = (0.75, 0.75, 0.75)
_LOST_RGBA = (0.6, 0.6, 0.6, 0.4)
_TYPES = {
    "ellipsoid": Marker.SPHERE,
    "cylinder": Marker.CYLINDER,
    "lines": Marker.LINE_LIST,
    "arrow": Marker.ARROW,
}
_NO_TURN = Quaternion(0.0, 0.0, 0.0, 1.0)
LABEL_ABOVE_M = 0.3  # a name is so far above what it names (below a reference)
_BEHIND_M = 0.8
_TEXT_M = 0.3  # height of a text that stands alone
_LINE_M = 0.2  # height of one that is a line among others
_LEAST_M = 1e-3  # diameter of what rviz could not draw, were it smaller
FLOWN_M, DESIRED_M = 0.04, 0.02  # widths of paths: the desired one is seen on the one flown
_OLDEST_ALPHA = 0.25  # of a path's oldest piece; the newest is opaque


# The values of a message are shared where they repeat: a message is written once and only read after that.
@functools.lru_cache(maxsize=1024)
def _rgba(red, green, blue, alpha):
    return ColorRGBA(red, green, blue, alpha)


@functools.lru_cache(maxsize=1024)
def _vector(x, y, z):
    return Vector3(x, y, z)


@functools.lru_cache(maxsize=64)
def _duration(seconds):
    return genpy.Duration.from_sec(seconds)


def header(stamp=None, frame_id=FRAME_ID):
    """Header, in the frame cortex if nothing else is said; without a stamp rviz takes the frame as it is now."""
    return Header(stamp=stamp or genpy.Time(), frame_id=frame_id)


def marker(
    head, ns, marker_id, shape, position_m, size_m, rgba, lifetime_s, turn=_NO_TURN, points_m=(), text="", action=0
):
    """One marker. shape: a type of Marker; turn: geometry_msgs/Quaternion, marker axes to cortex."""
    return Marker(
        header=head,
        ns=ns,
        id=marker_id,
        type=shape,
        action=action,
        pose=Pose(Point(*position_m), turn),
        scale=_vector(*size_m),
        color=_rgba(*rgba),
        lifetime=_duration(lifetime_s),
        frame_locked=False,
        points=[Point(*point) for point in points_m],
        colors=[],
        text=text,
        mesh_resource="",
        mesh_use_embedded_materials=False,
    )


def text_marker(head, ns, marker_id, text, position_m, height_m, rgba, lifetime_s):
    """A text that faces the viewer, centred at a position."""
    size_m = (0.0, 0.0, height_m)
    return marker(head, ns, marker_id, Marker.TEXT_VIEW_FACING, position_m, size_m, rgba, lifetime_s, text=text)


# ---------------------------------------------------------------- arena


def net_markers(net, lifetime_s):
    """The net: four panels (ids 0..3) and the edges of the box (id 4)."""
    head = header()
    panels = [
        marker(head, "Net", k, Marker.CUBE, centre_m, size_m, (1.0, 1.0, 1.0, 0.1), lifetime_s)
        for k, (centre_m, size_m) in enumerate(net.walls())
    ]
    width_m = (2.0 * net.thickness_m, 0.0, 0.0)
    edges = net.edges().tolist()
    grey = (1.0, 1.0, 1.0, 0.4)
    lines = marker(head, "Net", 4, Marker.LINE_LIST, (0.0, 0.0, 0.0), width_m, grey, lifetime_s, points_m=edges)
    return panels + [lines]


def grid_markers(grid, lifetime_s):
    """Numbers along the edges of the floor, ids in the order of `Grid.labels`."""
    head = header()
    return [
        text_marker(head, "grid", k, text, position_m, grid.text_height_m, (1.0, 1.0, 1.0, 0.3), lifetime_s)
        for k, (text, position_m) in enumerate(grid.labels())
    ]


def camera_markers(cameras, lifetime_s):
    """Motion capture cameras: housings (ids 0..n-1), lenses (n..2n-1) and the corners of what each sees (2n..3n-1)."""
    head = header()
    n = len(cameras)
    found = []
    for k, camera in enumerate(cameras):
        rotation = camera.rotation_to_cortex()
        turn = Quaternion(*Rotation.from_matrix(rotation).as_quat().tolist())
        lens_m = (camera.position_m + rotation @ [0.10, 0.0, 0.0]).tolist()
        corners = [(0.5, 0.2, 0.15), (0.5, -0.2, 0.15), (0.5, -0.2, -0.15), (0.5, 0.2, -0.15)]
        rays = [end for corner in corners for end in ((0.0, 0.0, 0.0), corner)]
        rim = [end for a, b in zip(corners, corners[1:] + corners[:1]) for end in (a, b)]
        at_m = camera.position_m
        found += [
            marker(head, "Camera", k, Marker.CUBE, at_m, (0.14, 0.10, 0.10), (1.0, 1.0, 1.0, 0.6), lifetime_s, turn),
            marker(
                head, "Camera", n + k, Marker.SPHERE, lens_m, (0.08, 0.08, 0.08), (1.0, 0.2, 0.2, 0.8), lifetime_s, turn
            ),
            marker(
                head,
                "Camera",
                2 * n + k,
                Marker.LINE_LIST,
                at_m,
                (0.006, 0.0, 0.0),
                (1.0, 1.0, 1.0, 0.25),
                lifetime_s,
                turn,
                rays + rim,
            ),
        ]
    return found


# ---------------------------------------------------------------- motion capture


def body_markers(head, bodies, lifetime_s):
    """The markers of every body as one list of spheres: ns = template. Markers that nobody sees are left out.

    bodies: list of (name, list of positions (3,) [m]).
    """
    return [
        marker(head, name, 1, Marker.SPHERE_LIST, (0.0, 0.0, 0.0), (0.03, 0.03, 0.03), WHITE, lifetime_s, points_m=seen)
        for name, seen in ((name, [p for p in positions_m if is_known(p)]) for name, positions_m in bodies)
        if seen
    ]


def is_known(position_m):
    """False for what stands for 'not seen': NaN, or the 10 km of the original release."""
    return all(math.isfinite(value) and abs(value) < 1000.0 for value in position_m)


def vehicle_markers(head, views, lifetime_s):
    """Every vehicle's parts: ns = name, ids from 1. One that is lost is a grey ghost where it was last seen."""
    found = []
    for view in views:
        turn = Quaternion(*view.quaternion)
        for k, part in enumerate(view.parts, start=1):
            rgba = _LOST_RGBA if view.lost else (view.colour if part.colour == PAINT else _BARE_RGB) + (part.alpha,)
            centre_m = _turned(view.quaternion, part.centre_m, view.position_m)
            shape = _TYPES[part.shape]
            found.append(
                marker(head, view.name, k, shape, centre_m, part.size_m, rgba, lifetime_s, turn, part.points_m)
            )
    return found


def vehicle_labels(head, views, alpha, lifetime_s, levels=None):
    """Every vehicle's name above it: ns = name, id = index + 1.

    levels: dict name -> level of the safety ladder, e.g. "LAND", of those vehicles whose safety is not content.
    """
    found = []
    for view in views:
        x, y, z = view.position_m
        text = view.name + (" (lost)" if view.lost else "")
        rgba = (1.0, 1.0, 1.0, alpha)
        if levels and view.name in levels:
            text, rgba = "%s: %s" % (text, levels[view.name]), RED[:3] + (alpha,)
        found.append(
            text_marker(head, view.name, view.index + 1, text, (x, y, z + LABEL_ABOVE_M), 0.17, rgba, lifetime_s)
        )
    return found


def pendulum_markers(head, name, tip_m, foot_m, lifetime_s):
    """Tip of a pendulum, and the rod to the vehicle at foot_m (None: no vehicle carries it)."""
    found = [marker(head, name, 1, Marker.SPHERE, tip_m, (0.076, 0.076, 0.076), PENDULUM + (1.0,), lifetime_s)]
    if foot_m is not None:
        ends, width_m = [foot_m, tip_m], (0.02, 0.0, 0.0)
        origin = (0.0, 0.0, 0.0)
        rgba = PENDULUM + (0.7,)
        found.append(marker(head, name, 2, Marker.LINE_STRIP, origin, width_m, rgba, lifetime_s, points_m=ends))
    return found


def pendulum_label(head, name, tip_m, alpha, lifetime_s):
    """Name of a pendulum above its tip."""
    x, y, z = tip_m
    return text_marker(head, name, 1, name, (x, y, z + LABEL_ABOVE_M), 0.17, (1.0, 1.0, 1.0, alpha), lifetime_s)


def landmark_markers(head, landmarks, lifetime_s, colours):
    """Landmarks as spheres: ns = name. landmarks: list of (name, position (3,) [m]); colours: dict name -> rgba."""
    size_m = (0.17, 0.17, 0.17)
    return [
        marker(head, name, 1, Marker.SPHERE, at_m, size_m, colours.get(name, _OTHER_LANDMARK), lifetime_s)
        for name, at_m in landmarks
        if is_known(at_m)
    ]


def landmark_labels(head, landmarks, alpha, lifetime_s):
    """Their names above them: ns = name."""
    return [
        text_marker(head, name, 1, name, (x, y, z + LABEL_ABOVE_M), 0.17, (1.0, 1.0, 1.0, alpha), lifetime_s)
        for name, (x, y, z) in landmarks
        if is_known((x, y, z))
    ]


def covariance_marker(head, position_m, variances_m2, lifetime_s, number=0):
    """Uncertainty of a position: ellipsoid with a diameter of three standard deviations along each axis.

    number: which vehicle's, from 1; 0 for a laboratory with one vehicle.
    """
    size_m = tuple(max(_LEAST_M, 3.0 * math.sqrt(variance)) for variance in variances_m2)
    return marker(head, "covariance", number, Marker.SPHERE, position_m, size_m, (1.0, 0.0, 0.0, 0.2), lifetime_s)


# ---------------------------------------------------------------- bearings


def ray_markers(head, observer, numbered, alpha, lifetime_s):
    """Rays of one picture as lines from the camera: ns = observer, for vehicles that are seen `<observer>/vehicles`.

    head: of the picture: its stamp, frame that of the camera. numbered: list of (number, rays.Ray); the number is the
    id, the same for the same thing at all times.
    """
    return [
        marker(
            head,
            "%s/vehicles" % observer if ray.is_vehicle else observer,
            number,
            Marker.LINE_LIST,
            (0.0, 0.0, 0.0),
            (ray.width_m, 0.0, 0.0),
            ray.rgb + (alpha,),
            lifetime_s,
            points_m=((0.0, 0.0, 0.0), ray.end_m),
        )
        for number, ray in numbered
    ]


def ray_labels(head, observer, numbered, alpha, lifetime_s):
    """Names of what is seen, at the ends of the rays: ns = `<observer>/names`. Arguments as those of `ray_markers`."""
    ns = "%s/names" % observer
    return [
        text_marker(head, ns, number, ray.name, ray.end_m, 0.17, ray.rgb + (alpha,), lifetime_s)
        for number, ray in numbered
    ]


def gone_marker(ns, marker_id):
    """Makes rviz forget a marker that has expired, and what it said of it when it could not place it."""
    return Marker(header=header(), ns=ns, id=marker_id, action=Marker.DELETE)


# ---------------------------------------------------------------- texts


def mode_marker(head, line, name, autonomous, safety, lifetime_s):
    """Who flies the vehicle: a line of text beside the arena.

    line: which one (0 is nearest the arena); name: "" for a laboratory with one vehicle; safety: what the vehicle's
    safety says when it is not content, else "".
    """
    text = safety or ("Autonomous" if autonomous else "Manual")
    rgba = RED if safety else GREEN if autonomous else ORANGE
    return _status_marker(head, "controller_status", (-3.0, -2.0), line, -1.0, name, text, rgba, lifetime_s)


def battery_marker(head, line, name, percent, lifetime_s):
    """Charge of a vehicle's battery: a line of text beside the arena, from red (empty) to green (full)."""
    full = min(1.0, max(0.0, percent / 100.0))
    rgba = (min(1.0, 2.0 - 2.0 * full), min(1.0, 2.0 * full), 0.0, 1.0)
    text = "%.0f%%" % percent if name else "Battery: %.0f%%" % percent
    return _status_marker(head, "battery_status", (3.0, -2.5), line, 1.0, name, text, rgba, lifetime_s)


def _status_marker(head, ns, corner_m, line, outwards, name, text, rgba, lifetime_s):
    """One line of a list beside the arena, at a corner of the floor.

    Lines follow each other along x and along z, both + or - as `outwards`: so they are apart in a view from above
    and in one from the side, and do not cancel in one from behind (-x), where the saved view is.
    """
    height_m = _LINE_M if name else _TEXT_M
    offset_m = outwards * 1.3 * height_m * line
    position_m = (corner_m[0] + offset_m, corner_m[1], offset_m)
    text = "%s: %s" % (name, text) if name else text
    return text_marker(head, ns, line, text, position_m, height_m, rgba, lifetime_s)


# ---------------------------------------------------------------- paths


def trail_markers(head, ns, index, pieces, rgb, width_m, lifetime_s):
    """Pieces of one path (`Trail.to_send`) as line strips that pale with age; ids are this path's own."""
    return [
        marker(
            head,
            ns,
            index * MAX_PIECES + slot,
            Marker.LINE_STRIP,
            (0.0, 0.0, 0.0),
            (width_m, 0.0, 0.0),
            # in steps, so that the shared colour objects stay few
            rgb + (round(1.0 - (1.0 - _OLDEST_ALPHA) * min(1.0, age), 2),),
            lifetime_s,
            points_m=points_m,
        )
        for slot, points_m, age in pieces
    ]


def reference_markers(head, index, name, position_m, named, lifetime_s):
    """A reference that its vehicle is not at, or that stands still: a ball, and a name if `named`."""
    x, y, z = position_m
    found = [marker(head, "traj_point", index, Marker.SPHERE, position_m, (0.1, 0.1, 0.1), ORANGE, lifetime_s)]
    if named:
        found.append(text_marker(head, "traj_name", index, name, (x, y, z - LABEL_ABOVE_M), 0.17, ORANGE, lifetime_s))
    return found


def waypoint_markers(head, index, waypoints, alpha, lifetime_s):
    """Waypoints as balls: ns = name, id from the index. waypoints: list of waypoints.Waypoint."""
    size_m = (0.17, 0.17, 0.17)
    return [
        marker(head, item.ns, index[item.key], Marker.SPHERE, item.position_m, size_m, _WAYPOINT + (alpha,), lifetime_s)
        for item in waypoints
    ]


def heading_markers(head, index, waypoints, alpha, lifetime_s):
    """Where the nose is to point there, as arrows: ns and id as `waypoint_markers`."""
    size_m = (0.255, 0.07, 0.07)
    found = []
    for item in waypoints:
        half_rad = -0.5 * item.heading_rad  # headings are + clockwise from above, turns about z the other way
        turn = Quaternion(0.0, 0.0, math.sin(half_rad), math.cos(half_rad))
        rgba = _WAYPOINT + (alpha,)
        found.append(
            marker(head, item.ns, index[item.key], Marker.ARROW, item.position_m, size_m, rgba, lifetime_s, turn)
        )
    return found


def waypoint_labels(head, index, waypoints, alpha, lifetime_s):
    """Names of the vehicles that are to go there: ns and id as `waypoint_markers`."""
    found = []
    for item in waypoints:
        x, y, z = item.position_m
        at_m, rgba = (x, y, z + LABEL_ABOVE_M), _WAYPOINT + (alpha,)
        found.append(text_marker(head, item.ns, index[item.key], item.name, at_m, 0.17, rgba, lifetime_s))
    return found


def title_marker(head, text, lifetime_s, arena=Arena()):
    """What is flown: a text behind the far wall, where it covers no vehicle, seen from behind or from above."""
    at_m = (arena.half_x_m + _BEHIND_M, 0.0, arena.height_m)
    return text_marker(head, "trajectory_name", 0, text, at_m, _TEXT_M, ORANGE, lifetime_s)


def _turned(quaternion, vector, origin):
    """origin + the vector turned by the quaternion (x, y, z, w); plain floats: numpy costs more for a single one."""
    if vector == (0.0, 0.0, 0.0):
        return origin
    x, y, z, w = quaternion
    a, b, c = vector
    s, t, u = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return (
        origin[0] + a + w * s + y * u - z * t,
        origin[1] + b + w * t + z * s - x * u,
        origin[2] + c + w * u + x * t - y * s,
    )
