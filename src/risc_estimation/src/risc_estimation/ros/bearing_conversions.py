"""Converts between messages of cameras and bearings (degrees) and values (SI units); nothing else does."""

import math

from risc_estimation.bearings import Bearing, Region
from risc_msgs.msg import Angle, Angles, Observed_angles


def regions_from_msg(rois):
    """List of Risc_roi or of Detection -> list of Region."""
    return [Region(roi.name, roi.visible, roi.x, roi.y) for roi in rois]


def angles_to_msg(bearings):
    """List of Bearing -> list of Angle, degrees."""
    return [
        Angle(item.name, item.visible, math.degrees(item.azimuth_rad), math.degrees(item.elevation_rad))
        for item in bearings
    ]


def bearings_from_msg(angles):
    """List of Angle, degrees -> list of Bearing. The inverse of `angles_to_msg`."""
    return [Bearing(item.name, item.visible, math.radians(item.azim), math.radians(item.elev)) for item in angles]


def observed_angles(header, pictures):
    """[(vehicle, landmarks' Bearings, quads' Bearings)] -> Observed_angles."""
    return Observed_angles(
        header, [Angles(name, angles_to_msg(landmarks), angles_to_msg(quads)) for name, landmarks, quads in pictures]
    )


def states_from_msg(message):
    """Cortex -> {vehicle: (position (3,) [m] cortex, roll pitch yaw (3,) [rad])} of the visible vehicles."""
    return {
        entry.name: (
            (entry.x, entry.y, entry.z),
            (math.radians(entry.phi), math.radians(entry.theta), math.radians(entry.psi)),
        )
        for entry in message.Obj
        if entry.visible
    }
