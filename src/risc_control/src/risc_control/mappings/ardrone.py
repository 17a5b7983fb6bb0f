"""AR.Drone: attitude <-> the fractions of /controls and cmd_vel (thesis 5.1); the thrust's part is in `climb_rate`.

Signs of /controls, as in the original release: + phi moves left, + theta moves forward, + psi turns left. All three
are opposite to the angles phi, theta, psi of the states (+ right, + nose up, + clockwise).

A fraction of 1 asks the vehicle for its full scale (`euler_angle_max`, `control_yaw`). Its attitude loops settle at
`gain` times what they are asked for (1.17 in roll, 1.11 in pitch), so the wanted angle is divided by the gain here,
where an angle becomes a fraction, and nowhere else.
"""

import math
from typing import NamedTuple

import numpy as np

from risc_control.flatness import FlatInputs
from risc_lab.compiled import compiled, record

# What a vehicle reaches at a fraction of 1, in the NED sense.
FULL_SCALE = record(("phi_rad", float), ("theta_rad", float), ("yaw_rate_rad_s", float))


class Fractions(NamedTuple):
    """What /controls carries for an AR.Drone: numbers, or arrays (n,)."""

    phi: float  # [-1, 1] + left
    theta: float  # [-1, 1] + forward
    psi: float  # [-1, 1] + counter-clockwise
    thrust_n: float


def full_scales(vehicle_types, tilt_max_rad=None, yaw_rate_max_rad_s=None):
    """(n,) FULL_SCALE of VehicleTypes. The limits override the types' own (floats or None).

    They must be what the driver has set on the vehicle, or every angle is scaled. Raises ValueError.
    """
    scales = np.zeros(len(vehicle_types), FULL_SCALE)
    for scale, vehicle_type in zip(scales, vehicle_types):
        tilt_rad = _limit(vehicle_type, "tilt_max_rad", tilt_max_rad)
        scale.phi_rad = -vehicle_type.roll.gain * tilt_rad
        scale.theta_rad = -vehicle_type.pitch.gain * tilt_rad
        scale.yaw_rate_rad_s = -_limit(vehicle_type, "yaw_rate_max_rad_s", yaw_rate_max_rad_s)
    return scales


@compiled
def to_fractions(inputs, full_scale):
    """(Fractions limited to [-1, 1], whether that cut the tilt, whether the yaw rate) of one vehicle's FlatInputs.

    Raises ValueError when a number is not finite: such a command must never leave the controller.
    """
    phi = inputs.phi_rad / full_scale.phi_rad
    theta = inputs.theta_rad / full_scale.theta_rad
    psi = inputs.yaw_rate_rad_s / full_scale.yaw_rate_rad_s
    if not math.isfinite(phi + theta + psi + inputs.thrust_n):
        raise ValueError("refusing a command that is not finite")
    fractions = Fractions(clipped(phi, 1.0), clipped(theta, 1.0), clipped(psi, 1.0), inputs.thrust_n)
    return fractions, fractions.phi != phi or fractions.theta != theta, fractions.psi != psi


@compiled
def to_inputs(fractions, full_scale):
    """FlatInputs that the vehicle reaches with these Fractions: the inverse, inside the limits."""
    return FlatInputs(
        fractions.thrust_n,
        fractions.phi * full_scale.phi_rad,
        fractions.theta * full_scale.theta_rad,
        fractions.psi * full_scale.yaw_rate_rad_s,
    )


@compiled
def clipped(value, limit):
    """Value within +-limit; what is not a number stays so."""
    if value > limit:
        return limit
    return -limit if value < -limit else value


def _limit(vehicle_type, name, override):
    value = getattr(vehicle_type, name) if override is None else override
    if not 0.0 < value < math.inf:
        raise ValueError("%s must be positive, got %r" % (name, value))
    return value
