"""Quadrotor: equations 6.1-6.4 with the on-board loops, compiled: scalar code for one vehicle (see integrator.py).

State (12, n): one row per quantity (enum X), one column per vehicle. Position is North, East, Up; velocity is in body
axes (forward, right, down); angles are NED Euler angles (roll + right wing down, pitch + nose up, yaw + clockwise from
above). Input (9, n): enum U. Parameters of a vehicle: a record that has QUADROTOR_FIELDS among others.

The loops: commanded angle c gives angle'' = wn^2 (gain c + level - angle) - 2 zeta wn angle', level being the error of
the vehicle's own level; yaw rate and vertical speed follow their commands as first-order lags.
"""

import math
from enum import IntEnum

from risc_lab.compiled import compiled
from risc_lab.frames import GRAVITY_M_S2


class X(IntEnum):
    """Rows of the state."""

    P_N = 0  # [m] north
    P_E = 1  # [m] east
    H = 2  # [m] up
    U = 3  # [m/s] body forward
    V = 4  # [m/s] body right
    W = 5  # [m/s] body down
    PHI = 6  # [rad] roll
    THETA = 7  # [rad] pitch
    PSI = 8  # [rad] yaw, not wrapped
    P = 9  # [rad/s] body rates
    Q = 10
    R = 11


class U(IntEnum):
    """Rows of the input."""

    ROLL = 0  # [rad] commanded roll angle
    PITCH = 1  # [rad] commanded pitch angle
    YAW_RATE = 2  # [rad/s] commanded yaw rate, + clockwise from above
    CLIMB = 3  # [m/s] commanded vertical speed, + up
    CLIMB_TRIM = 4  # [m/s^2] added to the vertical acceleration by the slow on-board integral
    MOTORS = 5  # 1: running, the loops are closed; 0: stopped, no thrust and no moments
    WIND_N = 6  # [m/s] velocity of the air
    WIND_E = 7
    WIND_UP = 8


QUADROTOR_FIELDS = (  # floats, see risc_lab.compiled.record; those of the true vehicle: perturbed_plant.PlantParams
    "mass_kg nominal_mass_kg thrust_scale inertia_x_kg_m2 inertia_y_kg_m2 inertia_z_kg_m2",
    "roll_natural_frequency_rad_s roll_damping_ratio roll_gain roll_level_rad",
    "pitch_natural_frequency_rad_s pitch_damping_ratio pitch_gain pitch_level_rad",
    "yaw_rate_time_constant_s climb_time_constant_s drag_n_s_m",
    "climb_scale climb_bias_m_s",  # climb rate as its own sensors measure it: scale * true one + bias
    "thrust_min_n thrust_max_n",  # range of the demanded thrust while the motors run
    "tumble_damping_1_s",  # air damping of the body rates while the motors stand
)


@compiled
def slope(x, inputs, body, x_dot):
    """x_dot (12,) of one vehicle in state x (12,) under inputs (9,). Returns the demanded thrust [N]."""
    thrust_n = climb_thrust(x, inputs, body)
    motion(x, inputs, body, thrust_n, x_dot)
    return thrust_n


@compiled
def climb_thrust(x, inputs, body):
    """The climb loop: thrust [N], within the motors' range, that gives a nominal vehicle the wanted acceleration."""
    sf, cf = math.sin(x[X.PHI]), math.cos(x[X.PHI])
    st, ct = math.sin(x[X.THETA]), math.cos(x[X.THETA])
    climb_m_s = x[X.U] * st - x[X.V] * sf * ct - x[X.W] * cf * ct
    up_m_s2 = (
        (inputs[U.CLIMB] - felt_climb(climb_m_s, body)) / body.climb_time_constant_s
        + inputs[U.CLIMB_TRIM]
        + GRAVITY_M_S2
    )
    return min(max(body.nominal_mass_kg * up_m_s2 / (cf * ct), body.thrust_min_n), body.thrust_max_n)


@compiled
def felt_climb(climb_m_s, body):
    """Climb rate [m/s] as the vehicle's own sensors measure it."""
    return body.climb_scale * climb_m_s + body.climb_bias_m_s


@compiled
def motion(x, inputs, body, thrust_n, x_dot):
    """x_dot (12,) under a demanded thrust [N], with the attitude loops."""
    u, v, w = x[X.U], x[X.V], x[X.W]
    phi, theta, psi = x[X.PHI], x[X.THETA], x[X.PSI]
    p, q, r = x[X.P], x[X.Q], x[X.R]
    sf, cf = math.sin(phi), math.cos(phi)
    st, ct = math.sin(theta), math.cos(theta)
    sp, cp = math.sin(psi), math.cos(psi)
    right_n, right_e = sf * st * cp - cf * sp, sf * st * sp + cf * cp  # north and east parts of the right wing
    down_n, down_e = cf * st * cp + sf * sp, cf * st * sp - sf * cp  # and of the belly's axis

    # 6.1
    x_dot[X.P_N] = u * ct * cp + v * right_n + w * down_n
    x_dot[X.P_E] = u * ct * sp + v * right_e + w * down_e
    x_dot[X.H] = u * st - v * sf * ct - w * cf * ct

    # 6.2, and drag in moving air
    air_n, air_e, air_up = inputs[U.WIND_N], inputs[U.WIND_E], inputs[U.WIND_UP]
    drag_1_s = body.drag_n_s_m / body.mass_kg
    x_dot[X.U] = r * v - q * w - GRAVITY_M_S2 * st
    x_dot[X.V] = p * w - r * u + GRAVITY_M_S2 * ct * sf
    x_dot[X.W] = q * u - p * v + GRAVITY_M_S2 * ct * cf
    x_dot[X.U] += drag_1_s * (air_n * ct * cp + air_e * ct * sp + air_up * st - u)
    x_dot[X.V] += drag_1_s * (air_n * right_n + air_e * right_e - air_up * sf * ct - v)
    x_dot[X.W] += drag_1_s * (air_n * down_n + air_e * down_e - air_up * cf * ct - w)

    # 6.3
    x_dot[X.PHI] = p + (q * sf + r * cf) * st / ct
    x_dot[X.THETA] = q * cf - r * sf
    x_dot[X.PSI] = (q * sf + r * cf) / ct

    # 6.4 (corrected products)
    j_x, j_y, j_z = body.inertia_x_kg_m2, body.inertia_y_kg_m2, body.inertia_z_kg_m2
    x_dot[X.P] = (j_y - j_z) / j_x * q * r
    x_dot[X.Q] = (j_z - j_x) / j_y * p * r
    x_dot[X.R] = (j_x - j_y) / j_z * p * q

    if inputs[U.MOTORS] != 0.0:
        wn, zeta = body.roll_natural_frequency_rad_s, body.roll_damping_ratio
        x_dot[X.P] += wn * wn * (body.roll_gain * inputs[U.ROLL] + body.roll_level_rad - phi) - 2.0 * zeta * wn * p
        wn, zeta = body.pitch_natural_frequency_rad_s, body.pitch_damping_ratio
        x_dot[X.Q] += wn * wn * (body.pitch_gain * inputs[U.PITCH] + body.pitch_level_rad - theta) - 2.0 * zeta * wn * q
        x_dot[X.R] += (inputs[U.YAW_RATE] - r) / body.yaw_rate_time_constant_s
        x_dot[X.W] -= body.thrust_scale * thrust_n / body.mass_kg
    else:
        x_dot[X.P] -= body.tumble_damping_1_s * p
        x_dot[X.Q] -= body.tumble_damping_1_s * q
        x_dot[X.R] -= body.tumble_damping_1_s * r


@compiled
def level_motion(x):
    """Climb rate, and horizontal velocity forward and to the right of the heading [m/s], of a state (12,)."""
    u, v, w, phi, theta = x[X.U], x[X.V], x[X.W], x[X.PHI], x[X.THETA]
    down2 = math.sin(phi) * v + math.cos(phi) * w  # along the down axis of frame vehicle-2
    climb = math.sin(theta) * u - math.cos(theta) * down2
    forward = math.cos(theta) * u + math.sin(theta) * down2
    right = math.cos(phi) * v - math.sin(phi) * w
    return climb, forward, right


@compiled
def push(x, vehicle, north_n, east_n, up_n, x_dot):
    """Add the effect of a force [N] at the vehicle's centre to its x_dot."""
    sf, cf = math.sin(x[X.PHI]), math.cos(x[X.PHI])
    st, ct = math.sin(x[X.THETA]), math.cos(x[X.THETA])
    sp, cp = math.sin(x[X.PSI]), math.cos(x[X.PSI])
    forward_n = north_n * ct * cp + east_n * ct * sp + up_n * st
    right_n = north_n * (sf * st * cp - cf * sp) + east_n * (sf * st * sp + cf * cp) - up_n * sf * ct
    down_n = north_n * (cf * st * cp + sf * sp) + east_n * (cf * st * sp - sf * cp) - up_n * cf * ct
    x_dot[X.U] += forward_n / vehicle.mass_kg
    x_dot[X.V] += right_n / vehicle.mass_kg
    x_dot[X.W] += down_n / vehicle.mass_kg
