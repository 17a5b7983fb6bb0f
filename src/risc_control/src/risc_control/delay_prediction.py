"""The state ahead: where the vehicles will be when a command that is sent now takes effect.

Commands reach a vehicle late (0.1 to 0.3 s of Wi-Fi), so feedback on the present state acts on the past. What the
vehicle does until then is known, though: it follows the commands that are already on their way.

Positions and velocities are north, east and up; angles are phi, theta, psi in the NED sense. Commands are what a
vehicle settles at (gain of its loops included): columns `Channel`.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from risc_control.vehicles import CLIMB_LOOP, climb_acceleration, climb_loops
from risc_lab.compiled import compiled, record
from risc_lab.frames import GRAVITY_M_S2

STEP_S = 0.005  # grid of the prediction; one frame of motion capture
MAX_HORIZON_S = 1.0
_HISTORY_ROWS = 2048  # > MAX_HORIZON_S of commands at 1 kHz
_MAX_GAP_S = 0.1  # a longer gap between measurements restarts the tilt observer
_OBSERVER_TABLE_S = 0.0005  # resolution of the observer's step


class Channel(IntEnum):
    """Columns of a command: angles [rad], what the type's CLIMB_LOOP takes [+ up], yaw rate [rad/s, + clockwise]."""

    PHI, THETA, CLIMB, YAW_RATE = range(4)


# One step of a command loop, exact while the command u holds: value+ = f11 value + f12 rate + g1 u,
# rate+ = f21 value + f22 rate + g2 u.
LOOP_STEP = record(("f11", float), ("f12", float), ("f21", float), ("f22", float), ("g1", float), ("g2", float))
TILT_STEP = record(("phi", LOOP_STEP), ("theta", LOOP_STEP))

# What the prediction knows of a vehicle type: steps of STEP_S of its loops, and what moves it.
PLANT = record(
    ("phi", LOOP_STEP),
    ("theta", LOOP_STEP),
    ("height", LOOP_STEP),
    ("psi", LOOP_STEP),
    ("climb", CLIMB_LOOP),
    ("yaw_time_constant_s", float),
    ("drag_1_s", float),  # drag over mass
    ("mass_kg", float),
    ("delay_s", float),  # from sending a command to its effect
)


@dataclass(frozen=True)
class NominalModel:
    """What a controller knows of its vehicles: arrays (k,) over their k types, or (k, 2) with columns roll, pitch."""

    kind: np.ndarray  # (n,) which of the types each vehicle is
    mass_kg: np.ndarray
    natural_frequency_rad_s: np.ndarray  # (k, 2)
    damping_ratio: np.ndarray  # (k, 2)
    climb: np.ndarray  # CLIMB_LOOP
    yaw_time_constant_s: np.ndarray
    drag_1_s: np.ndarray  # drag over mass
    delay_s: np.ndarray  # from sending a command to its effect

    @classmethod
    def of(cls, vehicle_types):
        """Of a sequence of VehicleType, one for each vehicle."""
        different = list(dict.fromkeys(vehicle_types))

        def column(value):
            return np.array([value(vehicle_type) for vehicle_type in different], dtype=float)

        return cls(
            kind=np.array([different.index(vehicle_type) for vehicle_type in vehicle_types], dtype=np.int64),
            mass_kg=column(lambda t: t.mass_kg),
            natural_frequency_rad_s=column(lambda t: (t.roll.natural_frequency_rad_s, t.pitch.natural_frequency_rad_s)),
            damping_ratio=column(lambda t: (t.roll.damping_ratio, t.pitch.damping_ratio)),
            climb=climb_loops(different),
            yaw_time_constant_s=column(lambda t: t.yaw_rate_time_constant_s),
            drag_1_s=column(lambda t: t.drag_n_s_m / t.mass_kg),
            delay_s=column(effective_delay_s),
        )

    def loops(self):
        """(A (k, 4, 2, 2), b (k, 4, 2)) of the four command loops x' = A x + b command, x = (value, its rate).

        The value of the climb loop is height and that of the yaw loop is yaw: its rate follows the command.
        """
        wn, zeta = self.natural_frequency_rad_s, self.damping_ratio
        k = len(self.mass_kg)
        A, b = np.zeros((k, 4, 2, 2)), np.zeros((k, 4, 2))
        A[:, :, 0, 1] = 1.0
        A[:, :2, 1, 0], A[:, :2, 1, 1], b[:, :2, 1] = -(wn**2), -2.0 * zeta * wn, wn**2
        A[:, Channel.CLIMB, 1, 1], b[:, Channel.CLIMB, 1] = -self.climb["damping_1_s"], self.climb["gain"]
        yaw_1_s = 1.0 / self.yaw_time_constant_s
        A[:, Channel.YAW_RATE, 1, 1], b[:, Channel.YAW_RATE, 1] = -yaw_1_s, yaw_1_s
        return A, b

    def plants(self):
        """(k,) PLANT."""
        plants = np.zeros(len(self.mass_kg), PLANT)
        Phi, Gamma = discretised(*self.loops(), STEP_S)
        for channel, name in enumerate(("phi", "theta", "height", "psi")):
            plants[name] = _loop_steps(Phi[:, channel], Gamma[:, channel])
        for name in ("climb", "yaw_time_constant_s", "drag_1_s", "mass_kg", "delay_s"):
            plants[name] = getattr(self, name)
        return plants


def discretised(A, b, step_s):
    """(Phi (..., m, m), Gamma (..., m)) of x' = A x + b u over one step of constant u: exact, by the exponential."""
    m = A.shape[-1]
    block = np.zeros(A.shape[:-2] + (m + 1, m + 1))
    block[..., :m, :m], block[..., :m, m] = A * step_s, b * step_s
    both = expm(block)
    return both[..., :m, :m], both[..., :m, m]


def _loop_steps(Phi, Gamma):
    """(...) LOOP_STEP of Phi (..., 2, 2) and Gamma (..., 2)."""
    return np.concatenate([Phi.reshape(Phi.shape[:-2] + (4,)), Gamma], axis=-1).view(LOOP_STEP)[..., 0]


@compiled
def _stepped(loop, value, rate, command):
    """(value, rate) of a command loop one step on."""
    return (
        loop.f11 * value + loop.f12 * rate + loop.g1 * command,
        loop.f21 * value + loop.f22 * rate + loop.g2 * command,
    )


# --- commands under way ------------------------------------------------------------------------------------------


class CommandHistory:
    """What was commanded when: zero-order hold, 0 before the first."""

    def __init__(self, vehicles):
        self.sent_s = np.empty(_HISTORY_ROWS)  # a ring: command k is in row k % _HISTORY_ROWS
        self.commands = np.zeros((_HISTORY_ROWS, vehicles, len(Channel)))
        self.ends = np.zeros(2, dtype=np.int64)  # k of the oldest and of the newest
        self.clear()

    def clear(self):
        """Forget everything: no command is under way."""
        self.ends[:], self.sent_s[0], self.commands[0] = 0, -np.inf, 0.0

    def append(self, time_s, command):
        """command (n, 4) holds from time_s on; times must not decrease (an earlier one replaces what came after)."""
        append_command(time_s, command, self.sent_s, self.commands, self.ends)

    def at(self, time_s):
        """(n, 4) command in force at a time."""
        k = last_sent(time_s, self.ends[1], self.sent_s, self.ends)
        return self.commands[k % _HISTORY_ROWS].copy()


@compiled
def append_command(time_s, command, sent_s, commands, ends):
    """See `CommandHistory.append`."""
    k = ends[1]
    while k > ends[0] and sent_s[k % _HISTORY_ROWS] >= time_s:
        k -= 1
    k += 1
    sent_s[k % _HISTORY_ROWS] = time_s
    for i in range(commands.shape[1]):
        for channel in range(commands.shape[2]):
            commands[k % _HISTORY_ROWS, i, channel] = command[i, channel]
    ends[0], ends[1] = max(ends[0], k - _HISTORY_ROWS + 1), k


@compiled
def last_sent(time_s, k, sent_s, ends):
    """Number of the last command, of k and those before it, that was sent by time_s."""
    while k > ends[0] and sent_s[k % _HISTORY_ROWS] > time_s:
        k -= 1
    return k


@compiled
def rows_in_force(from_s, steps, sent_s, ends):
    """(1 + steps,) rows of the commands in force in the step of STEP_S before from_s, and in each after it.

    A step has the command that is in force in its middle.
    """
    rows = np.empty(1 + steps, dtype=np.int64)
    k = ends[1]
    for step in range(steps, -1, -1):
        k = last_sent(STEP_S * (step - 0.5) + from_s, k, sent_s, ends)
        rows[step] = k % _HISTORY_ROWS
    return rows


# --- roll and pitch with their rates -----------------------------------------------------------------------------

TILT = record(
    ("phi_rad", float), ("phi_rate_rad_s", float), ("theta_rad", float), ("theta_rate_rad_s", float), ("time_s", float)
)
# Of the Kalman filter: on the angle and its rate, per angle of innovation.
TILT_GAIN = record(("phi", float, (2,)), ("theta", float, (2,)))


class TiltObserver:
    """Roll and pitch with their rates, from measured angles and the commands in force: a steady-state Kalman filter.

    Rates by differencing noisy angles are noisy or late; the model of the attitude loop knows them better.
    """

    def __init__(self, model, angle_noise_rad, disturbance_rad_s2, rate_hz=200.0):
        """angle_noise_rad: standard deviation of a measured angle.  disturbance_rad_s2: density of what the model of
        the loop does not know, as an angular acceleration [rad/s^2/sqrt(Hz)]: more trusts the measurement more.
        """
        A, b = (part[:, :2] for part in model.loops())
        self.steps = _tilt_steps(A, b)  # (k, steps): of 1, 2, ... times _OBSERVER_TABLE_S
        self.gains = np.zeros(len(A), TILT_GAIN)  # (k,)
        Phi, _ = discretised(A, b, 1.0 / rate_hz)
        noise = np.diag([0.0, disturbance_rad_s2**2 / rate_hz])
        for kind, gain in enumerate(self.gains):
            for axis, name in enumerate(TILT_GAIN.names):
                measured = np.array([[1.0], [0.0]])
                P = solve_discrete_are(Phi[kind, axis].T, measured, noise + 1e-15 * np.eye(2), [[angle_noise_rad**2]])
                gain[name] = P[:, 0] / (P[0, 0] + angle_noise_rad**2)
        self.tilts = np.zeros(len(model.kind), TILT)
        self.tilts["time_s"] = -np.inf


def _tilt_steps(A, b):
    """(k, steps) TILT_STEP: Phi(j) = Phi(1)^j, Gamma(j) = Phi(1) Gamma(j - 1) + Gamma(1)."""
    Phi_1, Gamma_1 = discretised(A, b, _OBSERVER_TABLE_S)
    steps = np.zeros((len(A), round(_MAX_GAP_S / _OBSERVER_TABLE_S)), TILT_STEP)
    Phi, Gamma = np.broadcast_to(np.eye(2), A.shape), np.zeros(b.shape)
    for j in range(steps.shape[1]):
        Phi, Gamma = Phi_1 @ Phi, (Phi_1 @ Gamma[..., None])[..., 0] + Gamma_1
        for axis, name in enumerate(TILT_STEP.names):
            steps[name][:, j] = _loop_steps(Phi[:, axis], Gamma[:, axis])
    return steps


@compiled
def observe(tilt, time_s, measured, command, steps, gain):
    """Bring a vehicle's TILT to time_s by what was measured: (phi, theta, phi', theta'); the rates to start with.

    command: in force since the last measurement.  steps, gain: of the vehicle's type, see `TiltObserver`.
    """
    phi_rad, theta_rad, phi_rate_rad_s, theta_rate_rad_s = measured
    j = np.rint((time_s - tilt.time_s) / _OBSERVER_TABLE_S)
    if 1.0 <= j <= len(steps):
        step = steps[int(j) - 1]
        phi, phi_rate = _stepped(step.phi, tilt.phi_rad, tilt.phi_rate_rad_s, command[Channel.PHI])
        theta, theta_rate = _stepped(step.theta, tilt.theta_rad, tilt.theta_rate_rad_s, command[Channel.THETA])
        tilt.phi_rad = phi + gain.phi[0] * (phi_rad - phi)
        tilt.phi_rate_rad_s = phi_rate + gain.phi[1] * (phi_rad - phi)
        tilt.theta_rad = theta + gain.theta[0] * (theta_rad - theta)
        tilt.theta_rate_rad_s = theta_rate + gain.theta[1] * (theta_rad - theta)
    elif j != 0.0:
        tilt.phi_rad, tilt.phi_rate_rad_s = phi_rad, phi_rate_rad_s
        tilt.theta_rad, tilt.theta_rate_rad_s = theta_rad, theta_rate_rad_s
    tilt.time_s = time_s


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
    """Steps of the grid that come next to a horizon. Raises ValueError for one that cannot be predicted."""
    if not 0.0 <= horizon_s <= MAX_HORIZON_S:
        raise ValueError("the prediction horizon must be from 0 to 1 s")
    return max(1, int(np.rint(horizon_s / STEP_S)))


@compiled
def _acceleration(phi_rad, theta_rad, psi_rad, up_m_s, command, plant):
    """North, east and up [m/s^2]: the climb loop gives the vertical one, the tilt (g + a_up) tan(tilt) along it."""
    a_up = climb_acceleration(command[Channel.CLIMB], up_m_s, plant.climb)
    a_forward = -(GRAVITY_M_S2 + a_up) * math.tan(theta_rad)
    a_right = (GRAVITY_M_S2 + a_up) * math.tan(phi_rad) / math.cos(theta_rad)
    cos_psi, sin_psi = math.cos(psi_rad), math.sin(psi_rad)
    return cos_psi * a_forward - sin_psi * a_right, sin_psi * a_forward + cos_psi * a_right, a_up


@compiled
def predicted(motion, plant, horizon_s, commands, rows, vehicle):
    """Motion of a vehicle after horizon_s by the nominal model.

    The response of the command loops is exact on the grid of STEP_S. The acceleration that they cause is integrated
    once and twice as if it were linear between the grid points. Drag is taken at the initial velocity.
    commands, rows: of the history, see `rows_in_force`.
    """
    steps = steps_of(horizon_s)
    dt = STEP_S
    drag_north, drag_east = plant.drag_1_s * motion.north_m_s, plant.drag_1_s * motion.east_m_s
    north, east, up = motion.north_m, motion.east_m, motion.up_m
    v_north, v_east, v_up = motion.north_m_s, motion.east_m_s, motion.up_m_s
    phi, theta, psi = motion.phi_rad, motion.theta_rad, motion.psi_rad
    phi_rate, theta_rate, psi_rate = motion.phi_rate_rad_s, motion.theta_rate_rad_s, motion.psi_rate_rad_s
    command = commands[rows[1], vehicle]
    a_north, a_east, a_up = _acceleration(phi, theta, psi, v_up, command, plant)
    for k in range(1, steps + 1):
        phi, phi_rate = _stepped(plant.phi, phi, phi_rate, command[Channel.PHI])
        theta, theta_rate = _stepped(plant.theta, theta, theta_rate, command[Channel.THETA])
        psi, psi_rate = _stepped(plant.psi, psi, psi_rate, command[Channel.YAW_RATE])
        up, v_up = _stepped(plant.height, up, v_up, command[Channel.CLIMB])
        command = commands[rows[min(k + 1, steps)], vehicle]
        before_north, before_east = a_north, a_east
        a_north, a_east, a_up = _acceleration(phi, theta, psi, v_up, command, plant)
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


def effective_delay_s(vehicle_type):
    """Mean time [s] from a command leaving the controller to its effect.

    The link's delay, half a command period waiting for the vehicle's next slot, and half a period for which the
    command then holds. Raises ValueError when it cannot be predicted.
    """
    delay_s = vehicle_type.command_delay_s + 1.0 / vehicle_type.command_rate_hz
    if not (vehicle_type.command_delay_s >= 0.0 and delay_s < 0.8 * MAX_HORIZON_S):
        raise ValueError(
            "command delay must be from 0 to %.2g s, got %r"
            % (0.8 * MAX_HORIZON_S - 1.0 / vehicle_type.command_rate_hz, vehicle_type.command_delay_s)
        )
    return delay_s
