"""Vehicles made of primitives, in the sizes of their types."""

from typing import NamedTuple

import numpy as np
from visualization_msgs.msg import Marker

from risc_lab.lab.vehicle_types import DEFAULT_TYPE, load_vehicle_type


class Part(NamedTuple):
    """One primitive of an airframe. Body axes: x nose, y right wing, z belly; origin at the vehicle's centre."""

    shape: int  # type of Marker; the axes of all are the body axes, cylinders are upright
    painted: bool  # in the vehicle's own colour, else grey
    alpha: float
    size_m: tuple[float, float, float]  # scale of a Marker of this type
    centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    points_m: tuple[tuple[float, float, float], ...] = ()  # lines: ends in turn; arrow: tail and tip


def parts_of(type_name=DEFAULT_TYPE):
    """Parts of a vehicle of this type; those of an AR.Drone when the type is unknown or has no size."""
    try:
        size = load_vehicle_type(type_name).airframe
    except ValueError:
        size = None
    return _quadrotor(size or load_vehicle_type(DEFAULT_TYPE).airframe)


def _quadrotor(size):
    """Parts of an `Airframe`: hull, arms, nose, rotors (front pair painted, to show where the nose is)."""
    arm_m, rotor_m, hull_m = size.arm_m, size.rotor_m, size.hull_m
    corner = arm_m * np.sqrt(0.5)
    hubs = [(corner, corner), (corner, -corner), (-corner, -corner), (-corner, corner)]
    above, nose = -0.5 * hull_m[2], 0.5 * hull_m[0]
    ends = tuple((x, y, above / 2) for x, y in (hubs[0], hubs[2], hubs[1], hubs[3]))
    tip = ((nose, 0.0, 0.0), (nose + 0.8 * rotor_m, 0.0, 0.0))
    rotor = rotor_m, rotor_m, 0.012
    return (
        Part(Marker.SPHERE, True, 1.0, hull_m),
        Part(Marker.LINE_LIST, False, 1.0, (0.06 * arm_m + 0.01, 0.0, 0.0), points_m=ends),
        Part(Marker.ARROW, True, 1.0, (0.02, 0.05, 0.07), points_m=tip),
        *(Part(Marker.CYLINDER, x > 0.0, 0.6, rotor, (x, y, above)) for x, y in hubs),
    )
