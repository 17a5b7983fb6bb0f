"""All conversions between frames and angle conventions (thesis 6.1.2; conventions of the message definitions).

Frames
    cortex    x forward, y left, z up; origin on the arena floor. What mocap, the messages, tf and rviz use.
    ned       North = cortex x, East = -cortex y, Down = -cortex z. What the thesis' equations use.
    body      x nose, y right wing, z belly (FRD), origin at the vehicle's centre.
    v, v1, v2 the thesis' vehicle frames: ned axes at the vehicle, then turned by yaw, then by pitch.
    flu       body with x nose, y left, z up: what ROS (REP 103) calls the base frame.

Angles: phi roll, + right wing down; theta pitch, + nose up; psi yaw, + clockwise seen from above.
All functions broadcast over leading axes; vectors are the last axis, matrices the last two. Those at the end are for
compiled code: one vehicle, scalars.
"""

import math

import numpy as np

from risc_lab.compiled import compiled

GRAVITY_M_S2 = 9.80665  # one constant for the whole workspace (thesis ch. 6)

_NOSE_VERTICAL = 1e-9  # cosine of the pitch below which roll and yaw cannot be told apart
_FLIP_Y_Z = np.array([1.0, -1.0, -1.0])


def frd_to_flu(vector_body):
    """(..., 3) vector from forward-right-down body axes to ROS' forward-left-up axes; any unit."""
    return np.asarray(vector_body, dtype=float) * _FLIP_Y_Z


def rotation_body_to_ned(phi_rad, theta_rad, psi_rad):
    """Rotation matrix Rz(psi) Ry(theta) Rx(phi): v_ned = R @ v_body (eq. 6.1). Returns (..., 3, 3)."""
    phi, theta, psi = np.broadcast_arrays(phi_rad, theta_rad, psi_rad)
    cf, sf, ct, st, cp, sp = np.cos(phi), np.sin(phi), np.cos(theta), np.sin(theta), np.cos(psi), np.sin(psi)
    R = np.empty(phi.shape + (3, 3))
    R[..., 0, 0], R[..., 0, 1], R[..., 0, 2] = ct * cp, sf * st * cp - cf * sp, cf * st * cp + sf * sp
    R[..., 1, 0], R[..., 1, 1], R[..., 1, 2] = ct * sp, sf * st * sp + cf * cp, cf * st * sp - sf * cp
    R[..., 2, 0], R[..., 2, 1], R[..., 2, 2] = -st, sf * ct, cf * ct
    return R


def rotation_body_to_cortex(phi_rad, theta_rad, psi_rad):
    """Rotation matrix from body (FRD) to cortex axes: v_cortex = R @ v_body. Returns (..., 3, 3)."""
    return _FLIP_Y_Z[:, None] * rotation_body_to_ned(phi_rad, theta_rad, psi_rad)


def euler_from_body_to_ned(R_body_to_ned):
    """Roll, pitch, yaw [rad] of rotation matrices (..., 3, 3); the inverse of `rotation_body_to_ned`.

    Roll and yaw are in [-pi, pi], pitch in [-pi/2, pi/2]. Never NaN for a proper rotation: with the nose straight
    up or down only psi -+ phi exists; it is returned as yaw, with a roll of zero.
    """
    R = np.asarray(R_body_to_ned, dtype=float)
    cos_theta = np.hypot(R[..., 2, 1], R[..., 2, 2])
    upright = cos_theta > _NOSE_VERTICAL
    phi = np.where(upright, np.arctan2(R[..., 2, 1], R[..., 2, 2]), 0.0)
    theta = np.arctan2(-R[..., 2, 0], cos_theta)
    psi = np.where(upright, np.arctan2(R[..., 1, 0], R[..., 0, 0]), np.arctan2(-R[..., 0, 1], R[..., 1, 1]))
    return phi, theta, psi


def euler_rates_from_body_rates(phi_rad, theta_rad, p_rad_s, q_rad_s, r_rad_s):
    """(phi', theta', psi') [rad/s] from body rates (eq. 6.3). Raises ValueError at pitch +-90 degrees."""
    ct = np.cos(theta_rad)
    if np.any(np.abs(ct) < 1e-9):
        raise ValueError("Euler rates do not exist at a pitch of +-90 degrees (theta_rad = %r)" % (theta_rad,))
    cf, sf = np.cos(phi_rad), np.sin(phi_rad)
    turn = q_rad_s * sf + r_rad_s * cf
    return p_rad_s + turn * np.tan(theta_rad), q_rad_s * cf - r_rad_s * sf, turn / ct


def body_rates_from_euler_rates(phi_rad, theta_rad, phi_dot_rad_s, theta_dot_rad_s, psi_dot_rad_s):
    """(p, q, r) [rad/s] from Euler rates: the inverse of eq. 6.3, defined at any attitude."""
    cf, sf, ct, st = np.cos(phi_rad), np.sin(phi_rad), np.cos(theta_rad), np.sin(theta_rad)
    return (
        phi_dot_rad_s - psi_dot_rad_s * st,
        theta_dot_rad_s * cf + psi_dot_rad_s * ct * sf,
        psi_dot_rad_s * ct * cf - theta_dot_rad_s * sf,
    )


def wrap_angle(angle_rad):
    """Angle [rad] turned by whole revolutions into (-pi, pi]."""
    return np.pi - np.mod(np.pi - np.asarray(angle_rad, dtype=float), 2.0 * np.pi)


# --- for compiled code


@compiled
def euler_of_body_in_cortex(R_body_to_cortex):
    """(phi, theta, psi) [rad] of one rotation matrix (3, 3): the inverse of `rotation_body_to_cortex`.

    As `euler_from_body_to_ned`, whose matrix has rows 1 and 2 of the other sign.
    """
    R = R_body_to_cortex
    cos_theta = math.sqrt(R[2, 1] * R[2, 1] + R[2, 2] * R[2, 2])
    theta = math.atan2(R[2, 0], cos_theta)
    if cos_theta > _NOSE_VERTICAL:
        return math.atan2(-R[2, 1], -R[2, 2]), theta, math.atan2(-R[1, 0], R[0, 0])
    return 0.0, theta, math.atan2(-R[0, 1], -R[1, 1])


@compiled
def wrap_one_angle(angle_rad):
    """As `wrap_angle`, of one angle."""
    return math.pi - (math.pi - angle_rad) % (2.0 * math.pi)
