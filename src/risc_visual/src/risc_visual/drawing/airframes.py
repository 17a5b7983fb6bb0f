"""Vehicles made of primitives, one drawing per type. Needs no ROS."""

from dataclasses import dataclass

import numpy as np

PAINT = "paint"  # the vehicle's own colour
BARE = "bare"  # that of the material: grey


@dataclass(frozen=True)
class Part:
    """One primitive of an airframe. Body axes: x nose, y right wing, z belly; origin at the vehicle's centre.

    A part's own axes are the body axes: ellipsoids and cylinders (upright, along z) need no rotation of their own.
    """

    shape: str  # "ellipsoid", "cylinder", "lines" or "arrow"
    colour: str  # PAINT or BARE
    alpha: float
    # ellipsoid, cylinder: diameters along x, y, z. lines: width, 0, 0. arrow: shaft and head diameter, head length.
    size_m: tuple[float, float, float]
    centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    points_m: tuple[tuple[float, float, float], ...] = ()  # lines: ends in turn; arrow: tail and tip


def quadrotor(arm_m, rotor_m, hull_m):
    """Parts of a quadrotor in x configuration: hull, arms, nose, rotors (front pair painted: so the nose is seen).

    arm_m: centre to rotor axis; rotor_m: rotor diameter; hull_m: (length, width, height).
    """
    corner = arm_m * np.sqrt(0.5)
    hubs = [(corner, corner), (corner, -corner), (-corner, -corner), (-corner, corner)]
    above = -0.5 * hull_m[2]
    ends = tuple((x, y, above / 2) for x, y in (hubs[0], hubs[2], hubs[1], hubs[3]))
    nose = 0.5 * hull_m[0]
    return (
        Part("ellipsoid", PAINT, 1.0, hull_m),
        Part("lines", BARE, 1.0, (0.06 * arm_m + 0.01, 0.0, 0.0), points_m=ends),
        Part("arrow", PAINT, 1.0, (0.02, 0.05, 0.07), points_m=((nose, 0.0, 0.0), (nose + 0.8 * rotor_m, 0.0, 0.0))),
    ) + tuple(
        Part("cylinder", PAINT if x > 0.0 else BARE, 0.6, (rotor_m, rotor_m, 0.012), (x, y, above)) for x, y in hubs
    )


AIRFRAMES = {
    "ardrone": quadrotor(arm_m=0.178, rotor_m=0.20, hull_m=(0.29, 0.12, 0.07)),
    "iris": quadrotor(arm_m=0.275, rotor_m=0.25, hull_m=(0.22, 0.14, 0.09)),
}
DEFAULT_AIRFRAME = "ardrone"

# Told apart from each other on a dark ground, and from what has a meaning: red (flown), green (desired).
_COLOURS = (
    (0.30, 0.70, 1.00),
    (1.00, 0.80, 0.25),
    (0.75, 0.55, 1.00),
    (0.25, 0.90, 0.80),
    (1.00, 0.60, 0.75),
    (0.80, 0.85, 0.55),
    (0.85, 0.85, 0.90),
    (0.90, 0.65, 0.45),
)


def vehicle_colour(index):
    """(r, g, b) of the vehicle with this index; they repeat after eight."""
    return _COLOURS[index % len(_COLOURS)]
