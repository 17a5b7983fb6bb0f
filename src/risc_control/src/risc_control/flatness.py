"""Differential flatness of a quadrotor: wanted acceleration -> thrust, roll, pitch, yaw rate (eqs 7.23-7.28).

The acceleration is `f = (f_north, f_east, f_up)` with gravity added to f_up (errata 24): hover is (0, 0, g).
The triple is left-handed; (7.25) needs its third entry down (errata 25), which happens here and nowhere else.
"""

import math
from typing import NamedTuple

from risc_control.vehicles import Command
from risc_lab.compiled import compiled
from risc_lab.frames import GRAVITY_M_S2

MIN_UP_M_S2 = 0.3 * GRAVITY_M_S2  # a vehicle that asks for less falls, and its tilt is ill-defined
MIN_COS_TILT = 0.5  # beyond 60 degrees no thrust holds the height: do not ask for more than twice
_MIN_HORIZONTAL_M_S2 = 1e-9  # less than this has no direction


class Acceleration(NamedTuple):
    """North, east and up with gravity [m/s^2]; at a yaw of 0 the vehicle's forward, right and up."""

    north: float
    east: float
    up: float


@compiled
def flat_inputs(f, psi_rad, yaw_rate_rad_s, mass_kg):
    """`Command`, the inputs of the general quadrotor model (7.23), that gives the `Acceleration` f at yaw psi.

    The thrust is (7.24), exact for a vehicle that already has the attitude; see `thrust_at_tilt`.
    Raises ValueError for |f| = 0 (free fall has no attitude) and for numbers that are not finite.
    """
    norm = math.sqrt(f.north * f.north + f.east * f.east + f.up * f.up)
    if not 0.0 < norm < math.inf:
        raise ValueError("flatness needs a finite acceleration other than 0 (gravity included)")
    cos_psi, sin_psi = math.cos(psi_rad), math.sin(psi_rad)
    # (7.25): z = -R(v to v1) b with b the unit vector of the thrust in NED: (north, east, -up) / norm
    z_1 = -(cos_psi * f.north + sin_psi * f.east) / norm
    z_2 = (sin_psi * f.north - cos_psi * f.east) / norm
    z_3 = f.up / norm
    phi_rad = math.asin(min(max(-z_2, -1.0), 1.0))  # (7.26)
    theta_rad = math.atan2(z_1, z_3)  # (7.27)
    return Command(phi_rad, theta_rad, yaw_rate_rad_s, mass_kg * norm)


@compiled
def limit_tilt(f, tilt_max_rad):
    """(`Acceleration` that needs no more tilt than allowed, whether that shortened f).

    The vertical part is kept, at least MIN_UP_M_S2, and the horizontal part is shortened, so height has priority.
    """
    up = MIN_UP_M_S2 if f.up < MIN_UP_M_S2 else f.up  # NaN stays NaN: `flat_inputs` refuses it
    horizontal, allowed = math.hypot(f.north, f.east), up * math.tan(tilt_max_rad)
    if not horizontal > allowed:
        return Acceleration(f.north, f.east, up), False
    scale = allowed / max(horizontal, _MIN_HORIZONTAL_M_S2)
    return Acceleration(scale * f.north, scale * f.east, up), True


@compiled
def thrust_at_tilt(f_up_m_s2, phi_rad, theta_rad, mass_kg):
    """Thrust [N] whose vertical part is f_up (gravity included) at the attitude the vehicle *has*.

    (7.24) assumes the commanded attitude; while the attitude lags it is too large on average and the vehicle floats
    up. Guarded: never more than for a tilt of acos(MIN_COS_TILT).
    """
    cos_tilt = math.cos(phi_rad) * math.cos(theta_rad)
    return mass_kg * f_up_m_s2 / (MIN_COS_TILT if cos_tilt < MIN_COS_TILT else cos_tilt)
