"""Between messages (degrees, risc_msgs) and the values that are drawn (SI units): the only place that does it."""

import math

from std_msgs.msg import Header

from risc_control.failsafe import FailsafeLevel, Rule, Verdict
from risc_msgs.msg import Observed_rois, Risc_roi, Risc_rois
from risc_visual.drawing.cast import Pose
from risc_visual.drawing.waypoints import Waypoint

FRAME_ID = "cortex"


def poses_from_cortex(msg):
    """Cortex -> list of `Pose`."""
    return [
        Pose(
            entry.name,
            entry.visible,
            (entry.x, entry.y, entry.z),
            (math.radians(entry.phi), math.radians(entry.theta), math.radians(entry.psi)),
        )
        for entry in msg.Obj
    ]


def bodies_from_mocap(msg):
    """Mocap_data -> list of (template, list of marker positions (3,) [m])."""
    return [(body.name, [(marker.x, marker.y, marker.z) for marker in body.marker]) for body in msg.Obj]


def landmarks_from_msg(msg):
    """Landmarks -> list of (name, position (3,) [m])."""
    return [(entry.name, (entry.x, entry.y, entry.z)) for entry in msg.Obj]


def references_from_trajectories(msg):
    """Trajectories -> dict name -> (position (3,) [m], speed [m/s])."""
    return {
        entry.name: ((entry.x, entry.y, entry.z), math.sqrt(entry.xdot**2 + entry.ydot**2 + entry.zdot**2))
        for entry in msg.Obj
    }


def verdict_from_msg(msg):
    """Safety -> Verdict, without ages."""
    return Verdict(FailsafeLevel(msg.level), msg.reason, msg.operator, Rule(msg.rule))


def waypoints_from_msg(msg):
    """Waypoints -> list of Waypoint; those whose numbers are none are left out."""
    found, count = [], {}
    for entry in msg.Obj:
        count[entry.name] = count.get(entry.name, 0) + 1
        values = (entry.x, entry.y, entry.z, math.radians(entry.heading))
        if all(map(math.isfinite, values)):
            found.append(Waypoint(entry.name, count[entry.name], values[:3], values[3]))
    return found


def rois_of_picture(header, observer, names, landmarks, others, vehicles):
    """Observed_rois of one picture: every landmark and vehicle that is looked for, seen or not.

    header: of the picture; its stamp is kept. observer: namespace of the vehicle that took it. names, others: of
    landmarks and vehicles; landmarks, vehicles: landmarks.Detections, vehicles.VehicleDetections, best first.
    """
    entry = Risc_rois(observer, _rois(names, landmarks), _rois(others, vehicles))
    return Observed_rois(Header(stamp=header.stamp, frame_id=FRAME_ID), [entry])


def _rois(names, found):
    best = {}
    for item in found:
        best.setdefault(item.name, item)
    return [_roi(name, best.get(name)) for name in names]


def _roi(name, item):
    if item is None:
        return Risc_roi(name, False, 0, 0, 0.0, 0.0, 0.0)
    return Risc_roi(name, True, round(item.x), round(item.y), item.width, item.height, item.angle)
