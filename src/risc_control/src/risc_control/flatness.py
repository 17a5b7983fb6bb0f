"""Differential flatness of a quadrotor: wanted acceleration -> thrust, roll, pitch, yaw rate (eqs 7.23-7.28).

The acceleration is `f = (f_north, f_east, f_up)` with gravity added to f_up (errata 24): hover is (0, 0, g).
The triple is left-handed; (7.25) needs its third entry down (errata 25), which happens here and nowhere else.
All functions broadcast over leading axes.
"""

from typing import NamedTuple

import numpy as np

from risc_control.frames import GRAVITY_M_S2, rotation_body_to_ned

MIN_UP_M_S2 = 0.3 * GRAVITY_M_S2  # a vehicle that asks for less falls, and its tilt is ill-defined
MIN_COS_TILT = 0.5  # beyond 60 degrees no thrust holds the height: do not ask for more than twice


class FlatInputs(NamedTuple):
    """Inputs of the general quadrotor model (7.23): floats or arrays (...)."""

    thrust_n: np.ndarray
    phi_rad: np.ndarray  # roll, + right wing down
    theta_rad: np.ndarray  # pitch, + nose up
    yaw_rate_rad_s: np.ndarray  # + clockwise from above


def flat_inputs(f_m_s2, psi_rad, yaw_rate_rad_s, mass_kg):
    """FlatInputs that give the acceleration f (..., 3) (north, east, up with gravity) at yaw psi.

    The thrust is (7.24), exact for a vehicle that already has the attitude; see `thrust_at_tilt`.
    Raises ValueError for |f| = 0 (free fall has no attitude) and for numbers that are not finite.
    """
    f = np.asarray(f_m_s2, dtype=float)
    norm = np.sqrt((f * f).sum(axis=-1))
    if not (norm > 0.0).all() or not np.isfinite(norm).all():
        raise ValueError("flatness needs a finite acceleration other than 0 (gravity included), got %s" % (f,))
    north, east, up = f[..., 0] / norm, f[..., 1] / norm, f[..., 2] / norm
    cos_psi, sin_psi = np.cos(psi_rad), np.sin(psi_rad)
    # z = -R(v to v1) b with b the unit vector of the thrust in NED: (north, east, -up)
    z_1 = -(cos_psi * north + sin_psi * east)
    z_2 = sin_psi * north - cos_psi * east
    return FlatInputs(
        mass_kg * norm, np.arcsin(np.minimum(np.maximum(-z_2, -1.0), 1.0)), np.arctan2(z_1, up), yaw_rate_rad_s
    )


def acceleration_of(inputs, psi_rad, mass_kg):
    """The inverse of `flat_inputs`: (..., 3) north, east, up with gravity, of a vehicle that has the attitude."""
    R = rotation_body_to_ned(inputs.phi_rad, inputs.theta_rad, psi_rad)
    return R[..., :, 2] * (-np.asarray(inputs.thrust_n) / mass_kg)[..., None] * np.array([1.0, 1.0, -1.0])


def limit_tilt(f_m_s2, tilt_max_rad):
    """f (..., 3) (north, east, up with gravity) that needs no more tilt than allowed.

    The vertical part is kept, at least MIN_UP_M_S2, and the horizontal part is shortened, so height has priority.
    Returns (limited f, shortened (...) bool).
    """
    f = np.array(f_m_s2, dtype=float)
    f[..., 2] = np.maximum(f[..., 2], MIN_UP_M_S2)
    horizontal = np.hypot(f[..., 0], f[..., 1])
    allowed = f[..., 2] * np.tan(tilt_max_rad)
    shortened = horizontal > allowed
    if shortened.any():
        f[..., :2] *= np.where(shortened, allowed / np.maximum(horizontal, 1e-9), 1.0)[..., None]
    return f, shortened


def thrust_at_tilt(f_up_m_s2, phi_rad, theta_rad, mass_kg):
    """Thrust [N] whose vertical part is f_up (gravity included) at the attitude the vehicle *has*.

    (7.24) assumes the commanded attitude; while the attitude lags it is too large on average and the vehicle floats
    up. Guarded: never more than for a tilt of acos(MIN_COS_TILT).
    """
    return mass_kg * f_up_m_s2 / np.maximum(np.cos(phi_rad) * np.cos(theta_rad), MIN_COS_TILT)
