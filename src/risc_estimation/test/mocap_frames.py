"""Frames of motion capture for tests: from a dict, and as messages."""

import numpy as np


def pack_bodies(bodies):
    """(layout, markers_m) as `PoseFit.update` takes them, from a dict name -> (k, 3) markers [m]."""
    parts = [np.reshape(markers, (-1, 3)) for markers in bodies.values()]
    layout = tuple((name, len(part)) for name, part in zip(bodies, parts))
    return layout, np.concatenate([np.zeros((0, 3)), *parts])


def mocap_message(header, layout, markers_m):
    """Mocap_data of ((name, number of markers), ...) and (markers, 3) of all bodies [m], cortex frame."""
    from risc_lab.ros.fleet_messages import MocapArrays  # with ROS only

    message = MocapArrays(layout)
    message.header = header
    message.markers_m[:] = markers_m
    return message
