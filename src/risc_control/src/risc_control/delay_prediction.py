"""Prediction of the state to the time when a command that is sent now takes effect.

Commands reach a vehicle late (0.1 to 0.3 s of Wi-Fi), so feedback on the present state acts too late. The motion of the
vehicle until then is known, though: it follows the commands that are already on their way.

Positions and velocities are north, east and up; angles are phi, theta, psi in the NED sense. Commands: see
`risc_lab.command_history.Channel`.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from risc_control.vehicles import CLIMB_LOOP, climb_acceleration, climb_loops
from risc_lab.command_history import ROWS, Channel, last_by
from risc_lab.compiled import compiled, record
from risc_lab.frames import GRAVITY_M_S2

STEP_S = 0.005  # grid of the prediction; one frame of motion capture
MAX_HORIZON_S = 1.0

# One step of a command loop, exact while the command u holds: value+ = f11 value + f12 rate + g1 u,
# rate+ = f21 value + f22 rate + g2 u.
LOOP_STEP = record("f11 f12 f21 f22 g1 g2")

# Model of a vehicle type for the prediction: steps of STEP_S of its loops, and its other numbers.
PLANT = record(
    ("phi", LOOP_STEP),
    ("theta", LOOP_STEP),
    ("height", LOOP_STEP),
    ("psi", LOOP_STEP),
    ("climb", CLIMB_LOOP),
    "yaw_time_constant_s mass_kg",
    "drag_1_s",  # drag over mass
    "delay_s",  # from sending a command to its effect
    "period_s",  # from one command to the next
)


def plants(vehicle_types):
    """(k,) PLANT of k VehicleTypes. Raises ValueError when the delay of one cannot be predicted."""
    found = np.zeros(len(vehicle_types), PLANT)
    for plant, vehicle_type in zip(found, vehicle_types):
        steps = loop_steps(*discretised(*loops(vehicle_type), STEP_S))
        plant.phi, plant.theta, plant.height, plant.psi = steps
        plant.yaw_time_constant_s = vehicle_type.yaw_rate_time_constant_s
        plant.drag_1_s = vehicle_type.drag_n_s_m / vehicle_type.mass_kg
        plant.mass_kg = vehicle_type.mass_kg
        plant.delay_s = effective_delay_s(vehicle_type)
        plant.period_s = 1.0 / vehicle_type.command_rate_hz
    found["climb"] = climb_loops(vehicle_types)
    return found


def effective_delay_s(vehicle_type):
    """Mean time [s] from a command leaving the controller to its effect.

    The link's delay, half a command period waiting for the vehicle's next slot, and half a period for which the
    command then holds. Raises ValueError when it cannot be predicted.
    """
    delay_s = vehicle_type.command_delay_s + 1.0 / vehicle_type.command_rate_hz
    if not 0.0 <= delay_s < 0.8 * MAX_HORIZON_S:
        raise ValueError("command_delay_s and a command period are %.2g s, too long to be predicted over" % delay_s)
    return delay_s


def loops(vehicle_type):
    """(A (4, 2, 2), b (4, 2)) of a type's command loops x' = A x + b command, x = (value, its rate), by `Channel`.

    The value of the climb loop is height and that of the yaw loop is yaw: its rate follows the command.
    """
    A, b = np.zeros((len(Channel), 2, 2)), np.zeros((len(Channel), 2))
    A[:, 0, 1] = 1.0
    for channel, loop in ((Channel.PHI, vehicle_type.roll), (Channel.THETA, vehicle_type.pitch)):
        wn = loop.natural_frequency_rad_s
        A[channel, 1], b[channel, 1] = (-(wn**2), -2.0 * loop.damping_ratio * wn), wn**2
    climb, yaw_1_s = climb_loops([vehicle_type])[0], 1.0 / vehicle_type.yaw_rate_time_constant_s
    A[Channel.CLIMB, 1, 1], b[Channel.CLIMB, 1] = -climb.damping_1_s, climb.gain
    A[Channel.YAW_RATE, 1, 1], b[Channel.YAW_RATE, 1] = -yaw_1_s, yaw_1_s
    return A, b


def discretised(A, b, step_s):
    """(Phi (..., m, m), Gamma (..., m)) of x' = A x + b u over one step of constant u: exact, by the exponential.

    step_s: [s], a number or an array (..., 1, 1).
    """
    m = A.shape[-1]
    block = np.zeros(A.shape[:-2] + (m + 1, m + 1))
    block[..., :m, :m], block[..., :m, m] = A, b
    both = expm(block * step_s)
    return both[..., :m, :m], both[..., :m, m]


def loop_steps(Phi, Gamma):
    """(...) LOOP_STEP of Phi (..., 2, 2) and Gamma (..., 2)."""
    return np.concatenate([Phi.reshape(Phi.shape[:-2] + (4,)), Gamma], axis=-1).view(LOOP_STEP)[..., 0]


@compiled
def stepped(loop, value, rate, command):
    """(value, rate) of a command loop one step on."""
    return (
        loop.f11 * value + loop.f12 * rate + loop.g1 * command,
        loop.f21 * value + loop.f22 * rate + loop.g2 * command,
    )


# --- commands under way ------------------------------------------------------------------------------------------


@compiled
def fill_in_force(sent, own, plant, stamp_s, commands, before=0):
    """Fill commands (before + 1 + steps, 4): those in force in the step of STEP_S before stamp_s, in each step after
    it, and in `before` steps before it.

    sent, own: HISTORY of the commands actually sent to the vehicle, where known, and of those that the controller has
    computed. The former counts up to a command period after its newest entry, when the next one is due. From then on
    (or always, if nothing is reported as sent) each computed command counts as sent half a period later, the mean time
    for which a command has been in force. Each step gets the command that is in force in its middle.
    """
    wait_s = 0.5 * plant.period_s
    known_s = sent.times_s[sent.newest % ROWS] + plant.period_s
    k_sent, k_own = sent.newest, own.newest
    for step in range(len(commands) - 1, -1, -1):
        time_s = stamp_s + STEP_S * (step - before - 0.5) - (plant.delay_s - wait_s)
        if time_s < known_s:
            k_sent = last_by(sent, time_s, k_sent)
            commands[step] = sent.commands[k_sent % ROWS]
        else:
            k_own = last_by(own, time_s - wait_s, k_own)
            commands[step] = own.commands[k_own % ROWS]


# --- the motion ahead --------------------------------------------------------------------------------------------


class Motion(NamedTuple):
    """State of a vehicle."""

    north_m: float
    east_m: float
    up_m: float
    north_m_s: float
    east_m_s: float
    up_m_s: float
    phi_rad: float
    theta_rad: float
    psi_rad: float
    phi_rate_rad_s: float
    theta_rate_rad_s: float
    psi_rate_rad_s: float
    up_m_s2: float  # vertical acceleration; a prediction needs none


@compiled
def steps_of(horizon_s):
    """Number of grid steps nearest to a horizon. Raises ValueError for one that cannot be predicted."""
    if not 0.0 <= horizon_s <= MAX_HORIZON_S:
        raise ValueError("the prediction horizon must be from 0 to 1 s")
    return max(1, int(np.rint(horizon_s / STEP_S)))


@compiled
def acceleration(phi_rad, theta_rad, psi_rad, up_m_s, climb, plant):
    """North, east and up [m/s^2]: the climb loop gives the vertical one, the tilt (g + a_up) tan(tilt) along it."""
    a_up = climb_acceleration(climb, up_m_s, plant.climb)
    a_forward = -(GRAVITY_M_S2 + a_up) * math.tan(theta_rad)
    a_right = (GRAVITY_M_S2 + a_up) * math.tan(phi_rad) / math.cos(theta_rad)
    cos_psi, sin_psi = math.cos(psi_rad), math.sin(psi_rad)
    return cos_psi * a_forward - sin_psi * a_right, sin_psi * a_forward + cos_psi * a_right, a_up


@compiled
def predicted(motion, plant, horizon_s, commands, push_north_m_s2=0.0, push_east_m_s2=0.0, more_drag_1_s=0.0):
    """Motion of a vehicle after horizon_s by the nominal model, with the commands of `fill_in_force`, as they are or
    corrected by `disturbance_observer.driven`.

    push: external acceleration, constant.  more_drag_1_s: additional drag over mass, beyond that of the type.

    The response of the command loops is exact on the grid of STEP_S. The acceleration that they cause is integrated
    once and twice as if it were linear between the grid points. Drag is taken at the initial velocity.
    """
    steps = steps_of(horizon_s)
    dt = STEP_S
    drag_1_s = plant.drag_1_s + more_drag_1_s
    drag_north = drag_1_s * motion.north_m_s - push_north_m_s2
    drag_east = drag_1_s * motion.east_m_s - push_east_m_s2
    north, east, up = motion.north_m, motion.east_m, motion.up_m
    v_north, v_east, v_up = motion.north_m_s, motion.east_m_s, motion.up_m_s
    phi, theta, psi = motion.phi_rad, motion.theta_rad, motion.psi_rad
    phi_rate, theta_rate, psi_rate = motion.phi_rate_rad_s, motion.theta_rate_rad_s, motion.psi_rate_rad_s
    command = commands[1]
    a_north, a_east, a_up = acceleration(phi, theta, psi, v_up, command[Channel.CLIMB], plant)
    for k in range(1, steps + 1):
        phi, phi_rate = stepped(plant.phi, phi, phi_rate, command[Channel.PHI])
        theta, theta_rate = stepped(plant.theta, theta, theta_rate, command[Channel.THETA])
        psi, psi_rate = stepped(plant.psi, psi, psi_rate, command[Channel.YAW_RATE])
        up, v_up = stepped(plant.height, up, v_up, command[Channel.CLIMB])
        command = commands[min(k + 1, steps)]
        before_north, before_east = a_north, a_east
        a_north, a_east, a_up = acceleration(phi, theta, psi, v_up, command[Channel.CLIMB], plant)
        north += dt * v_north + dt * dt * (before_north / 3.0 + a_north / 6.0 - drag_north / 2.0)
        east += dt * v_east + dt * dt * (before_east / 3.0 + a_east / 6.0 - drag_east / 2.0)
        v_north += dt * (0.5 * (before_north + a_north) - drag_north)
        v_east += dt * (0.5 * (before_east + a_east) - drag_east)
    rest_s = horizon_s - steps * STEP_S  # less than half a step, + or -
    return Motion(
        north + rest_s * v_north,
        east + rest_s * v_east,
        up + rest_s * v_up,
        v_north + rest_s * (a_north - drag_north),
        v_east + rest_s * (a_east - drag_east),
        v_up + rest_s * a_up,
        phi + rest_s * phi_rate,
        theta + rest_s * theta_rate,
        psi + rest_s * psi_rate,
        phi_rate,
        theta_rate,
        psi_rate,
        a_up,
    )
