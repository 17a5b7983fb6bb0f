"""The state ahead: where the vehicles will be when a command that is sent now takes effect.

Commands reach a vehicle late (0.1 to 0.3 s of Wi-Fi), so feedback on the present state acts on the past. What the
vehicle does until then is known, though: it follows the commands that are already on their way. Everything here is
vectorised over the vehicles of one controller, which share one command delay.

Frames: positions and velocities are (north, east, up) with the horizontal part as one complex number north + i east;
angles are phi, theta, psi in the NED sense. Commands are what a vehicle settles at (gain of its loops included):
columns `Channel`.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from risc_control.frames import GRAVITY_M_S2

STEP_S = 0.005  # grid of the prediction; one frame of motion capture
MAX_HORIZON_S = 1.0
_HISTORY_ROWS = 2048  # > MAX_HORIZON_S of commands at 1 kHz
_MAX_GAP_S = 0.1  # a longer gap between measurements restarts the tilt observer
_OBSERVER_TABLE_S = 0.0005  # resolution of the observer's step


class Channel(IntEnum):
    """Columns of a command: angles [rad], climb rate [m/s, + up], yaw rate [rad/s, + clockwise]."""

    PHI, THETA, CLIMB, YAW_RATE = range(4)


@dataclass(frozen=True)
class NominalModel:
    """What a controller knows of n vehicles: arrays (n,), or (n, 2) with columns roll, pitch."""

    mass_kg: np.ndarray
    natural_frequency_rad_s: np.ndarray  # (n, 2)
    damping_ratio: np.ndarray  # (n, 2)
    climb_time_constant_s: np.ndarray
    yaw_time_constant_s: np.ndarray
    climb_max_m_s: np.ndarray
    drag_1_s: np.ndarray  # drag over mass

    @classmethod
    def of(cls, vehicle_types):
        """Stacked from a sequence of VehicleType."""

        def column(value):
            return np.array([value(vehicle_type) for vehicle_type in vehicle_types], dtype=float)

        return cls(
            mass_kg=column(lambda t: t.mass_kg),
            natural_frequency_rad_s=column(lambda t: (t.roll.natural_frequency_rad_s, t.pitch.natural_frequency_rad_s)),
            damping_ratio=column(lambda t: (t.roll.damping_ratio, t.pitch.damping_ratio)),
            climb_time_constant_s=column(lambda t: t.climb_time_constant_s),
            yaw_time_constant_s=column(lambda t: t.yaw_rate_time_constant_s),
            climb_max_m_s=column(lambda t: t.climb_max_m_s),
            drag_1_s=column(lambda t: t.drag_n_s_m / t.mass_kg),
        )

    def loops(self):
        """(A (n, 4, 2, 2), b (n, 4, 2)) of the four command loops x' = A x + b command, x = (value, its rate).

        The value of the climb loop is height and that of the yaw loop is yaw: its rate follows the command.
        """
        wn, zeta = self.natural_frequency_rad_s, self.damping_ratio
        n = len(self.mass_kg)
        A, b = np.zeros((n, 4, 2, 2)), np.zeros((n, 4, 2))
        A[:, :, 0, 1] = 1.0
        A[:, :2, 1, 0], A[:, :2, 1, 1], b[:, :2, 1] = -(wn**2), -2.0 * zeta * wn, wn**2
        for channel, tau in ((Channel.CLIMB, self.climb_time_constant_s), (Channel.YAW_RATE, self.yaw_time_constant_s)):
            A[:, channel, 1, 1], b[:, channel, 1] = -1.0 / tau, 1.0 / tau
        return A, b


class Motion(NamedTuple):
    """State of n vehicles: horizontal parts complex (n,) north + i east, all else (n,)."""

    position_m: np.ndarray
    velocity_m_s: np.ndarray
    height_m: np.ndarray
    climb_m_s: np.ndarray
    phi_rad: np.ndarray
    theta_rad: np.ndarray
    psi_rad: np.ndarray
    phi_rate_rad_s: np.ndarray
    theta_rate_rad_s: np.ndarray
    psi_rate_rad_s: np.ndarray


class CommandHistory:
    """What was commanded when: zero-order hold, 0 before the first."""

    def __init__(self, vehicles):
        self._times = np.full(_HISTORY_ROWS, np.inf)
        self._values = np.zeros((_HISTORY_ROWS, vehicles, len(Channel)))
        self.clear()

    def clear(self):
        """Forget everything: no command is under way."""
        self._times[0], self._values[0] = -np.inf, 0.0
        self._count = 1

    def append(self, time_s, command):
        """command (n, 4) holds from time_s on; times must not decrease (an earlier one replaces what came after)."""
        while self._count > 1 and self._times[self._count - 1] >= time_s:
            self._count -= 1
        if self._count == _HISTORY_ROWS:
            kept = _HISTORY_ROWS // 2
            self._times[:kept], self._values[:kept] = self._times[-kept:], self._values[-kept:].copy()
            self._times[0], self._count = -np.inf, kept
        self._times[self._count], self._values[self._count] = time_s, command
        self._count += 1

    def at(self, times_s):
        """(k, n, 4) commands at times (k,)."""
        return self._values[np.searchsorted(self._times[: self._count], times_s, side="right") - 1]


def discretised(A, b, step_s):
    """(Phi (..., m, m), Gamma (..., m)) of x' = A x + b u over one step of constant u: exact, by the exponential."""
    m = A.shape[-1]
    block = np.zeros(A.shape[:-2] + (m + 1, m + 1))
    block[..., :m, :m], block[..., :m, m] = A * step_s, b * step_s
    both = expm(block)
    return both[..., :m, :m], both[..., :m, m]


class TiltObserver:
    """Roll and pitch with their rates, from measured angles and the commands in force: a steady-state Kalman filter.

    Rates by differencing noisy angles are noisy or late; the model of the attitude loop knows them better.
    """

    def __init__(self, model, angle_noise_rad, disturbance_rad_s2, rate_hz=200.0):
        """angle_noise_rad: standard deviation of a measured angle.  disturbance_rad_s2: density of what the model of
        the loop does not know, as an angular acceleration [rad/s^2/sqrt(Hz)]: more trusts the measurement more.
        """
        A, b = (part[:, :2] for part in model.loops())
        steps = np.arange(1, int(_MAX_GAP_S / _OBSERVER_TABLE_S) + 1)
        tables = [discretised(A, b, k * _OBSERVER_TABLE_S) for k in steps]
        self._phi = np.array([phi for phi, _ in tables])  # (steps, n, 2, 2, 2)
        self._gamma = np.array([gamma for _, gamma in tables])  # (steps, n, 2, 2)
        phi, _ = discretised(A, b, 1.0 / rate_hz)
        self._gain = np.zeros(b.shape)
        for index in np.ndindex(b.shape[:2]):
            noise = np.diag([0.0, disturbance_rad_s2**2 / rate_hz])
            measured = np.array([[1.0], [0.0]])
            P = solve_discrete_are(phi[index].T, measured, noise + 1e-15 * np.eye(2), [[angle_noise_rad**2]])
            self._gain[index] = P[:, 0] / (P[0, 0] + angle_noise_rad**2)
        self._state = np.zeros(b.shape)
        self._time_s = np.full(len(b), -np.inf)

    def update(self, time_s, angles_rad, rates_rad_s, command_rad, seen):
        """(angles (n, 2), rates (n, 2)) at time_s: columns roll, pitch.

        angles, rates: measured (n, 2); the rates are used to start with.  command: (n, 2) in force since the last
        update.  seen: (n,) bool, False where there is no measurement; such rows are meaningless until seen again.
        """
        steps = np.rint((time_s - self._time_s) / _OBSERVER_TABLE_S)
        known = (steps >= 1.0) & (steps <= len(self._phi))
        if known.all() and seen.all() and steps[0] == steps[-1] and (steps == steps[0]).all():
            k = int(steps[0]) - 1
            predicted = (
                np.matmul(self._phi[k], self._state[..., None])[..., 0] + self._gamma[k] * command_rad[..., None]
            )
            self._state = predicted + self._gain * (angles_rad - predicted[..., 0])[..., None]
            self._time_s[:] = time_s
        else:
            for i in np.flatnonzero(seen):
                if known[i]:
                    k = int(steps[i]) - 1
                    predicted = np.matmul(self._phi[k, i], self._state[i][..., None])[..., 0]
                    predicted = predicted + self._gamma[k, i] * command_rad[i][:, None]
                    self._state[i] = predicted + self._gain[i] * (angles_rad[i] - predicted[..., 0])[..., None]
                elif steps[i] != 0.0:
                    self._state[i, :, 0], self._state[i, :, 1] = angles_rad[i], rates_rad_s[i]
                self._time_s[i] = time_s
        return self._state[..., 0], self._state[..., 1]


class _Table(NamedTuple):
    """Matrices for a prediction over a fixed number of steps N."""

    mid_s: np.ndarray  # (N,) middle of each step
    free: np.ndarray  # (n, 4, N + 1, 2) response of the value to the initial (value, rate)
    forced: np.ndarray  # (n, 4, N + 1, N) response of the value to the commands
    free_rate: np.ndarray  # (n, 4, 1, 2) response of the rate at the end
    forced_rate: np.ndarray  # (n, 4, 1, N)
    held: np.ndarray  # (N + 1,) column of the command that is in force at each grid point
    climb_free: np.ndarray  # (n, N + 1) response of the climb rate
    climb_forced: np.ndarray  # (n, N + 1, N)
    velocity_weight: np.ndarray  # (N + 1,) integral of a piecewise linear acceleration
    position_weight: np.ndarray  # (N + 1,) its double integral


class Predictor:
    """States ahead by the nominal model: exact linear response of the four command loops, then the motion they cause.

    Tilt and climb rate give the horizontal acceleration (g + a_up) tan(tilt) in the turning yaw frame; it is
    integrated once and twice on a grid of STEP_S. Drag is taken at the initial velocity.
    """

    def __init__(self, model):
        self._model = model
        self._A, self._b = model.loops()
        self._tables = {}

    def prepare(self, horizon_s):
        """Compute the tables for horizons around this one now rather than in flight."""
        for steps in range(-2, 3):
            self._table(max(1, int(round(horizon_s / STEP_S)) + steps))

    def ahead(self, motion, time_s, horizon_s, history, delay_s):
        """(Motion at time_s + horizon_s, vertical acceleration then (n,)).

        motion: Motion at time_s.  history: CommandHistory by the time of sending; a command acts delay_s later.
        Raises ValueError for a horizon that is negative or beyond MAX_HORIZON_S.
        """
        if not 0.0 <= horizon_s <= MAX_HORIZON_S:
            raise ValueError("prediction horizon must be in [0, %g] s, got %r" % (MAX_HORIZON_S, horizon_s))
        steps = max(1, int(round(horizon_s / STEP_S)))
        table = self._table(steps)
        rest_s = horizon_s - steps * STEP_S
        command = history.at(table.mid_s + (time_s - delay_s)).transpose(1, 2, 0)  # (n, 4, N)
        command_column = command[..., None]
        start = np.array(
            [
                [motion.phi_rad, motion.theta_rad, motion.height_m, motion.psi_rad],
                [motion.phi_rate_rad_s, motion.theta_rate_rad_s, motion.climb_m_s, motion.psi_rate_rad_s],
            ]
        ).T[..., None]  # (n, 4, 2, 1)
        values = (np.matmul(table.free, start) + np.matmul(table.forced, command_column))[..., 0]  # (n, 4, N + 1)
        rates = np.matmul(table.free_rate, start) + np.matmul(table.forced_rate, command_column)
        rates = rates[..., 0, 0]  # (n, 4)
        climb = table.climb_free * start[:, 2, 1] + np.matmul(table.climb_forced, command_column[:, 2])[..., 0]
        a_up = command[:, 2].take(table.held, axis=1)
        a_up -= climb
        a_up /= self._model.climb_time_constant_s[:, None]

        tan_tilt = np.tan(values[:, :2])
        forward_right = -tan_tilt[:, 1] + 1j * tan_tilt[:, 0] / np.cos(values[:, 1])
        acceleration = (GRAVITY_M_S2 + a_up) * forward_right * np.exp(1j * values[:, 3])  # (n, N + 1)
        grid_s = steps * STEP_S
        drag = self._model.drag_1_s * motion.velocity_m_s
        velocity = motion.velocity_m_s + acceleration @ table.velocity_weight - grid_s * drag
        position = motion.position_m + grid_s * motion.velocity_m_s
        position = position + acceleration @ table.position_weight - (0.5 * grid_s * grid_s) * drag
        last = values[:, :, -1] + rest_s * rates
        return (
            Motion(
                position + rest_s * velocity,
                velocity + rest_s * (acceleration[:, -1] - drag),
                last[:, 2],
                rates[:, 2] + rest_s * a_up[:, -1],
                last[:, 0],
                last[:, 1],
                last[:, 3],
                rates[:, 0],
                rates[:, 1],
                rates[:, 3],
            ),
            a_up[:, -1],
        )

    def _table(self, steps):
        if steps not in self._tables:
            self._tables[steps] = self._make_table(steps)
        return self._tables[steps]

    def _make_table(self, steps):
        phi, gamma = discretised(self._A, self._b, STEP_S)
        n = len(gamma)
        powers = np.empty((steps + 1, n, 4, 2, 2))
        powers[0] = np.eye(2)
        for k in range(steps):
            powers[k + 1] = np.matmul(phi, powers[k])
        impulse = np.matmul(powers[:-1], gamma[..., None])[..., 0]  # (N, n, 4, 2) state k + 1 steps after a unit step
        forced = np.zeros((n, 4, steps + 1, steps, 2))
        for k in range(1, steps + 1):
            forced[:, :, k, :k] = impulse[:k][::-1].transpose(1, 2, 0, 3)
        remaining_s = STEP_S * np.arange(steps, -1, -1.0)
        velocity_weight = np.full(steps + 1, STEP_S)
        velocity_weight[[0, -1]] = 0.5 * STEP_S
        # integral of (end - t) a(t) with a linear between the grid points
        position_weight = STEP_S * remaining_s
        position_weight[0] = STEP_S * (0.5 * remaining_s[0] - STEP_S / 6.0)
        position_weight[-1] = STEP_S * STEP_S / 6.0
        return _Table(
            mid_s=STEP_S * (np.arange(steps) + 0.5),
            free=np.ascontiguousarray(powers[..., 0, :].transpose(1, 2, 0, 3)),
            forced=np.ascontiguousarray(forced[..., 0]),
            free_rate=powers[-1, :, :, 1:, :].copy(),
            forced_rate=np.ascontiguousarray(forced[:, :, -1:, :, 1]),
            held=np.minimum(np.arange(steps + 1), steps - 1),
            climb_free=np.ascontiguousarray(powers[:, :, Channel.CLIMB, 1, 1].T),
            climb_forced=np.ascontiguousarray(forced[:, Channel.CLIMB, ..., 1]),
            velocity_weight=velocity_weight,
            position_weight=position_weight,
        )


def effective_delay_s(vehicle_type, command_delay_s=None):
    """Mean time [s] from a command leaving the controller to its effect.

    The link's delay, half a command period waiting for the vehicle's next slot, and half a period for which the
    command then holds. command_delay_s overrides the type's link delay. Raises ValueError when it cannot be predicted.
    """
    link_s = vehicle_type.command_delay_s if command_delay_s is None else command_delay_s
    delay_s = link_s + 1.0 / vehicle_type.command_rate_hz
    if not (math.isfinite(link_s) and link_s >= 0.0 and delay_s < 0.8 * MAX_HORIZON_S):
        raise ValueError(
            "command delay must be from 0 to %.2g s, got %r" % (0.8 * MAX_HORIZON_S - delay_s + link_s, link_s)
        )
    return delay_s
