"""Markers as the drawing nodes publish them."""

import genpy
from geometry_msgs.msg import Twist, TwistStamped, Vector3
from std_msgs.msg import Header

from risc_lab.lab.templates import load_templates
from risc_msgs.msg import (
    Cortex,
    Landmark,
    Landmarks,
    Mocap_data,
    Mocap_marker,
    Mocap_markers,
    States,
    Waypoint,
    Waypoints,
)
from risc_visual.drawing.cast import Index
from risc_visual.drawing.params import CortexParams, TrajectoryParams, WaypointParams
from risc_visual.drawing.rays import Ray
from risc_visual.drawing.ros import markers
from risc_visual.drawing.ros.cortex_drawing import CortexDrawing
from risc_visual.drawing.ros.paths import PathDrawing
from risc_visual.drawing.ros.waypoint_drawing import WaypointDrawing
from risc_visual.drawing.scenery import load_scenery
from risc_visual.vision.landmark_config import load_landmarks

STAMP = genpy.Time(100, 5)
HEAD = markers.header(STAMP)
NOW_S = 100.0


def scene(fleet=(), **params):
    """CortexDrawing of a laboratory."""
    return CortexDrawing(CortexParams(**params), fleet, load_templates(), load_landmarks())


def cortex(positions_m, lost=(), psi_deg=30.0, stamp=STAMP):
    """Cortex of {name: position}."""
    states = [
        States(name, name not in lost, *at_m, *[0.0] * 3, 2.0, -3.0, psi_deg, *[0.0] * 3)
        for name, at_m in positions_m.items()
    ]
    return Cortex(Header(stamp=stamp, frame_id="cortex"), states)


def mocap(bodies):
    """Mocap_data of {template: positions of its markers}."""
    found = [Mocap_markers(name, 0.0, [Mocap_marker(*at_m) for at_m in points]) for name, points in bodies.items()]
    return Mocap_data(Header(stamp=STAMP), found)


def landmarks(places_m):
    """Landmarks of {name: position}."""
    return Landmarks(Header(stamp=STAMP), [Landmark(name, *at_m) for name, at_m in places_m.items()])


def twist(position_m, variances_m2):
    """Message of `position_cov`."""
    return TwistStamped(Header(stamp=STAMP), Twist(Vector3(*position_m), Vector3(*variances_m2)))


def waypoints(*entries):
    """Waypoints of (name, x, y, z, heading [deg])."""
    return Waypoints(Obj=[Waypoint(*entry) for entry in entries])


def rays():
    """Two rays with their numbers."""
    return [
        (0, Ray("green", False, (3.5, 1.0, -0.5), 0.04, (0.0, 1.0, 0.0))),
        (4, Ray("risc2", True, (4.0, 0.0, 0.0), 0.04, (1.0, 0.8, 0.25))),
    ]


def path(ns="traj_line", seconds=2.0):
    """The newest markers of the path of the second of two vehicles."""
    params = TrajectoryParams()
    drawing = PathDrawing(ns, markers.GREEN, markers.DESIRED_M, 40.0, params, Index(("a", "b")))
    for k in range(int(seconds * params.rate_hz)):
        head = markers.header(genpy.Time.from_sec(NOW_S + k / params.rate_hz))
        found = drawing.draw(head, {"b": (0.03 * k, 0.0, 1.0)})
    return found


def everything(positions_m=None, lost=(), level=None, tip=True):
    """{topic: markers} of two vehicles, or of those at these positions. level: Verdict of the first one's safety.

    tip: the first one carries a pendulum."""
    positions_m = positions_m or {"Raven": (0.0, 0.5, 1.0), "Kahn": (1.0, 0.5, 1.0)}
    here, drawing, arena, pen = scene(), scene(), load_scenery(), markers.Pen(1.0, HEAD)
    drawing.vehicles(cortex(positions_m), NOW_S)
    if level:
        drawing.note_safety(0, level)
    modes = [drawing.mode(HEAD, k, name, True) for k, name in enumerate(positions_m)]
    seen_m = dict(positions_m, Pendulum_tip=(*next(iter(positions_m.values()))[:2], 2.0)) if tip else positions_m
    vehicles, labels = drawing.vehicles(cortex(seen_m, lost), NOW_S)
    spheres, names = here.landmarks(
        landmarks({"Green_pink": (2.4, 0.9, 1.0), "Pink_blue": (2.4, -0.9, 1.0), "Blue_green": (-2.4, -0.9, 1.0)})
    )
    balls, arrows, way_labels = WaypointDrawing(WaypointParams(), list(positions_m)).waypoints(
        waypoints(("Raven", 1.0, 2.0, 1.0, 20.0)), NOW_S
    )
    return {
        "angle_lines": markers.ray_markers(pen, "risc1", rays(), 0.4, 0.8),
        "Way_Markers": balls,
        "Heading_Markers": arrows,
        "Way_Labels": way_labels,
        "net": markers.net_markers(pen, arena.net),
        "Grid": markers.grid_markers(pen, arena.grid, arena.net),
        "Cameras": markers.camera_markers(pen, arena.cameras),
        "Cortex_Markers": here.bodies(mocap({"Raven": [(0, 0, 1), (0, 0.1, 1)]})),
        "Quad_Markers": vehicles,
        "Quad_Labels": labels,
        "Land_Markers": spheres,
        "Land_Labels": names,
        "Ctrl_Status": modes,
        "Battery_Status": [here.battery(HEAD, k, name, 90.0) for k, name in enumerate(positions_m)],
        "Cov_Quad": [here.covariance(twist((0, 0, 1), (1e-4, 4e-4, 9e-4)), 0)],
        "desired_trajectory": path()
        + [
            pen.ball("traj_point", 0, (0.5, 0.5, 1.0), 0.1, (1.0, 0.4, 0.0, 1.0)),
            pen.label("traj_name", 0, next(iter(positions_m)), (0.5, 0.5, 1.0), (1.0, 0.4, 0.0, 1.0), -1.0),
        ],
        "desired_trajectory_name": [markers.title_marker(pen, "circles3\ncourse")],
    }
