"""Between messages (degrees, risc_msgs) and the values that are drawn (SI units): the only place that does it."""

import math

from risc_visual.cast import Pose


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
