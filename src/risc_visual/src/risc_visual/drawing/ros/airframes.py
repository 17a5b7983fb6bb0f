"""Vehicles made of primitives, one drawing per type."""

from typing import NamedTuple

import numpy as np
from visualization_msgs.msg import Marker


class Part(NamedTuple):
    """One primitive of an airframe. Body axes: x nose, y right wing, z belly; origin at the vehicle's centre."""

    shape: int  # type of Marker; the axes of all are the body axes, cylinders are upright
    painted: bool  # in the vehicle's own colour, else grey
    alpha: float
    size_m: tuple[float, float, float]  # scale of a Marker of this type
    centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    points_m: tuple[tuple[float, float, float], ...] = ()  # lines: ends in turn; arrow: tail and tip


def quadrotor(arm_m, rotor_m, hull_m):
    """Parts of a quadrotor in x configuration: hull, arms, nose, rotors (front pair painted: so the nose is seen).

    arm_m: centre to rotor axis; rotor_m: rotor diameter; hull_m: (length, width, height).
    """
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


AIRFRAMES = {
    "ardrone": quadrotor(arm_m=0.178, rotor_m=0.20, hull_m=(0.29, 0.12, 0.07)),
    "iris": quadrotor(arm_m=0.275, rotor_m=0.25, hull_m=(0.22, 0.14, 0.09)),
}
DEFAULT_AIRFRAME = "ardrone"
