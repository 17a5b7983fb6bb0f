"""What a vehicle does that its model does not know: its level, gain and lag of its tilt, and what pushes it. With its
roll, pitch and their rates.

Kalman filters on what motion capture says and the commands in force, for each axis:

- tilt: angle, its rate, level, gain and lag: the attitude loop is angle'' = wn^2 (driven - angle) - 2 zeta wn angle',
  driven = (1 + gain) command + level + lag (command of LAG_S before - command). So a lag of 1 is LAG_S: of a slower or
  better damped loop as of a later link, which are much the same below their bandwidth. Rates by differencing noisy
  angles are noisy or late; the model of the attitude loop knows them better. How well gain and lag are known goes by
  what is commanded, so this filter carries its covariance.
- way: position, velocity and the push, an acceleration by which both go otherwise than the tilt explains: wind, drag,
  mass, thrust. It is along north and east, whichever way the vehicle turns. The gains are the steady-state ones for the
  interval between two measurements.

A place or a tilt that the vehicle cannot have come to is not believed (exchanged names, say): nothing is learnt of it,
and when it stays, the filters start there.
"""

import math

import numpy as np
from scipy.linalg import solve_discrete_are

from risc_control.delay_prediction import LOOP_STEP, STEP_S, acceleration, discretised, loop_steps, loops
from risc_control.vehicles import clipped
from risc_lab.command_history import Channel
from risc_lab.compiled import compiled, record

LAG_STEPS = 20  # of STEP_S
LAG_S = LAG_STEPS * STEP_S
_MAX_GAP_S = 0.1  # a longer gap between measurements restarts the filters
_TABLE_S = 0.0005  # resolution of their step
_GAIN_EVERY = 10  # of these steps: so finely do the gains of the way go by the interval
_RATE_RAD_S, _LEVEL_RAD = 1.0, 0.01  # standard deviations of what is not known at first
_FORGET_S = 300.0  # a gain and a lag that no command shows are forgotten with this time constant
_LEVEL_MAX_RAD, _GAIN_MAX, _LAG_MAX, _PUSH_MAX_M_S2 = 0.1, 0.3, 1.2, 3.0  # more is something else
_FALSE_M, _FALSE_RAD = 0.04, 0.15  # from what is predicted for the next frame
_FALSE_S = 0.2  # what is false for longer is true

# Of a way along one axis, by what was measured: on the place, its rate, and the push.
_WAY_GAIN = record("place rate push")
_AS_MEASURED = 1.0, -1.0, 0.0  # no push is learnt: place and velocity are those that were measured
# Of a type, by the steps of _TABLE_S since the measurement before.
STEP = record(("phi", LOOP_STEP), ("theta", LOOP_STEP), ("way", _WAY_GAIN))
# How much is not known: variance of a measured angle; of what disturbs rate and level, per second; of gain and lag.
_UNKNOWN = record("angle_rad2 rate_per_s level_per_s gain lag")

_N = 5  # angle, rate, level, gain, lag
_TILT = record("angle_rad rate_rad_s level_rad gain lag", ("P", float, (_N, _N)))
_WAY = record("m m_s push_m_s2 tilt_m_s2")  # tilt_m_s2: what tilt and drag explained when it was seen last
# Of a vehicle. time_s: of the newest measurement; true_s: of the newest that was believed.
OBSERVED = record(("phi", _TILT), ("theta", _TILT), ("north", _WAY), ("east", _WAY), "time_s true_s")


def unseen(n):
    """(n,) OBSERVED of vehicles of which nothing is known."""
    observed = np.zeros(n, OBSERVED)
    observed["time_s"] = observed["true_s"] = -np.inf
    return observed


def observer(vehicle_types, params):
    """((k, steps) STEP of k VehicleTypes, _UNKNOWN), for `observe`.

    params: has angle_noise_rad, position_noise_m: standard deviations of what is measured; tilt_disturbance_rad_s2:
    density of what the model of the attitude loop does not know, as an angular acceleration [rad/s^2/sqrt(Hz)];
    level_rad_s, push_m_s3: densities by which level [rad/s/sqrt(Hz)] and push [m/s^3/sqrt(Hz)] change; gain_spread,
    lag_spread_s: standard deviations of gain and lag. With 0 of one of the last four it is not learnt.
    """
    A, b = (np.stack(part)[:, : Channel.CLIMB] for part in zip(*map(loops, vehicle_types)))
    times_s = _TABLE_S * np.arange(1, round(_MAX_GAP_S / _TABLE_S) + 1)
    every = np.repeat(A[:, None], len(times_s), axis=1), np.repeat(b[:, None], len(times_s), axis=1)
    table = loop_steps(*discretised(*every, times_s[:, None, None, None]))
    steps = np.zeros(table.shape[:2], STEP)
    steps["phi"], steps["theta"] = table[..., 0], table[..., 1]
    steps["way"] = _AS_MEASURED
    if params.push_m_s3 > 0.0:
        steps["way"] = _way_gains(times_s, params.position_noise_m, params.push_m_s3)
    unknown = np.zeros(1, _UNKNOWN)
    deviations = params.angle_noise_rad, params.tilt_disturbance_rad_s2, params.level_rad_s, params.gain_spread
    unknown[0] = tuple(value**2 for value in (*deviations, params.lag_spread_s / LAG_S))
    return steps, unknown


def _way_gains(times_s, noise_m, push_m_s3):
    """(steps,) _WAY_GAIN of place'' = push, where the push is disturbed with this density."""
    gains = np.zeros(len(times_s), _WAY_GAIN)
    for first in range(0, len(times_s), _GAIN_EVERY):
        Phi, _ = discretised(np.eye(3, k=1), np.zeros(3), times_s[first + _GAIN_EVERY - 1])
        Q = np.diag([0.0, 0.0, push_m_s3**2 * times_s[first + _GAIN_EVERY - 1]]) + 1e-15 * np.eye(3)
        P = solve_discrete_are(Phi.T, np.eye(3)[:, :1], Q, [[noise_m**2]])
        gains[first : first + _GAIN_EVERY] = tuple(P[:, 0] / (P[0, 0] + noise_m**2))
    return gains


@compiled
def forget(observed, unknown):
    """Level, gain and lag of a vehicle are not those that were learnt: it stood, or did not obey the commands."""
    for tilt in (observed.phi, observed.theta):
        tilt.level_rad = tilt.gain = tilt.lag = 0.0
        tilt.P[2:, :] = tilt.P[:, 2:] = 0.0
        tilt.P[2, 2] = _LEVEL_RAD**2 if unknown.level_per_s > 0.0 else 0.0
        tilt.P[3, 3], tilt.P[4, 4] = unknown.gain, unknown.lag


@compiled
def observe(observed, time_s, tilt, way, command, earlier, psi_rad, climb_m_s, plant, steps, unknown):
    """Bring a vehicle's OBSERVED to time_s by what was measured.

    tilt: (phi, theta, phi', theta') and way: (north, east, their rates); the rates to start with.
    command: in force since the last measurement; earlier: LAG_S before.  steps, unknown: see `observer`.
    """
    since_s = time_s - observed.time_s
    j = np.rint(since_s / _TABLE_S)
    observed.time_s = time_s
    if j == 0.0:
        return
    phi, theta, north, east = observed.phi, observed.theta, observed.north, observed.east
    if 1.0 <= j <= len(steps):
        step = steps[int(j) - 1]
        _step_tilt(phi, step.phi, command[Channel.PHI], earlier[Channel.PHI], since_s, unknown)
        _step_tilt(theta, step.theta, command[Channel.THETA], earlier[Channel.THETA], since_s, unknown)
        tilt_north, tilt_east = _explained(observed, psi_rad, climb_m_s, command, plant)
        _step_way(north, tilt_north, since_s)
        _step_way(east, tilt_east, since_s)
        is_near = math.hypot(way[0] - north.m, way[1] - east.m) < _FALSE_M
        if is_near and max(abs(tilt[0] - phi.angle_rad), abs(tilt[1] - theta.angle_rad)) < _FALSE_RAD:
            _correct_tilt(phi, tilt[0], unknown)
            _correct_tilt(theta, tilt[1], unknown)
            _correct_way(north, way[0], way[2], step.way)
            _correct_way(east, way[1], way[3], step.way)
            observed.true_s = time_s
            return
        if time_s - observed.true_s <= _FALSE_S:
            return
    if observed.true_s == -np.inf:
        forget(observed, unknown)
    phi.angle_rad, theta.angle_rad, phi.rate_rad_s, theta.rate_rad_s = tilt
    north.m, east.m, north.m_s, east.m_s = way
    _begin(phi, unknown)
    _begin(theta, unknown)
    north.tilt_m_s2, east.tilt_m_s2 = _explained(observed, psi_rad, climb_m_s, command, plant)
    observed.true_s = time_s


@compiled
def driven(tilt, command, earlier):
    """Angle that an axis goes to under a command and that of LAG_S before."""
    return (1.0 + tilt.gain) * command + tilt.level_rad + tilt.lag * (earlier - command)


@compiled
def _begin(tilt, unknown):
    """Angle and rate are those that were measured; what was learnt stays."""
    tilt.P[:2, :] = tilt.P[:, :2] = 0.0
    tilt.P[0, 0], tilt.P[1, 1] = unknown.angle_rad2, _RATE_RAD_S**2


@compiled
def _step_tilt(tilt, loop, command, earlier, step_s, unknown):
    """An axis' tilt, and its covariance, a step later."""
    to_rad, P = driven(tilt, command, earlier), tilt.P
    angle_rad, rate_rad_s = tilt.angle_rad, tilt.rate_rad_s
    tilt.angle_rad = loop.f11 * angle_rad + loop.f12 * rate_rad_s + loop.g1 * to_rad
    tilt.rate_rad_s = loop.f21 * angle_rad + loop.f22 * rate_rad_s + loop.g2 * to_rad
    changes = earlier - command
    for k in range(_N):  # P = F P F'; the learnt part of F's first two rows: (g1, g2) (1 command changes)
        to_angle = loop.f11 * P[0, k] + loop.f12 * P[1, k]
        to_rate = loop.f21 * P[0, k] + loop.f22 * P[1, k]
        learnt = P[2, k] + command * P[3, k] + changes * P[4, k]
        P[0, k], P[1, k] = to_angle + loop.g1 * learnt, to_rate + loop.g2 * learnt
    for k in range(_N):
        to_angle = loop.f11 * P[k, 0] + loop.f12 * P[k, 1]
        to_rate = loop.f21 * P[k, 0] + loop.f22 * P[k, 1]
        learnt = P[k, 2] + command * P[k, 3] + changes * P[k, 4]
        P[k, 0], P[k, 1] = to_angle + loop.g1 * learnt, to_rate + loop.g2 * learnt
    P[1, 1] += unknown.rate_per_s * step_s
    P[2, 2] += unknown.level_per_s * step_s
    keep = 1.0 - step_s / _FORGET_S
    tilt.gain *= keep
    tilt.lag *= keep
    P[3:, :] *= keep
    P[:, 3:] *= keep
    P[3, 3] += (1.0 - keep * keep) * unknown.gain
    P[4, 4] += (1.0 - keep * keep) * unknown.lag


@compiled
def _correct_tilt(tilt, angle_rad, unknown):
    """By a measured angle."""
    P, off_rad = tilt.P, angle_rad - tilt.angle_rad
    by = 1.0 / (P[0, 0] + unknown.angle_rad2)
    tilt.angle_rad += P[0, 0] * by * off_rad
    tilt.rate_rad_s += P[1, 0] * by * off_rad
    tilt.level_rad = clipped(tilt.level_rad + P[2, 0] * by * off_rad, _LEVEL_MAX_RAD)
    tilt.gain = clipped(tilt.gain + P[3, 0] * by * off_rad, _GAIN_MAX)
    tilt.lag = clipped(tilt.lag + P[4, 0] * by * off_rad, _LAG_MAX)
    for row in range(_N - 1, -1, -1):  # P - P_0 P_0' / (P_00 + R), below and on the diagonal, the first column last
        for k in range(row, -1, -1):
            P[row, k] -= by * P[row, 0] * P[k, 0]
    for row in range(_N):  # rounding must not make it lopsided
        for k in range(row):
            P[k, row] = P[row, k]


@compiled
def _explained(observed, psi_rad, climb_m_s, command, plant):
    """Acceleration (north, east) [m/s^2] by tilt and drag."""
    tilt = observed.phi.angle_rad, observed.theta.angle_rad
    north, east, _ = acceleration(tilt[0], tilt[1], psi_rad, climb_m_s, command, plant)
    return north - plant.drag_1_s * observed.north.m_s, east - plant.drag_1_s * observed.east.m_s


@compiled
def _step_way(way, tilt_m_s2, step_s):
    """An axis' way, a step later, at whose end tilt and drag explain this acceleration."""
    m_s2 = way.push_m_s2 + 0.5 * (way.tilt_m_s2 + tilt_m_s2)
    way.m += step_s * way.m_s + 0.5 * step_s * step_s * m_s2
    way.m_s += step_s * m_s2
    way.tilt_m_s2 = tilt_m_s2


@compiled
def _correct_way(way, place_m, rate_m_s, gain):
    """By a measured place."""
    off_m = place_m - way.m
    way.m += gain.place * off_m
    way.m_s = rate_m_s if gain.rate < 0.0 else way.m_s + gain.rate * off_m
    way.push_m_s2 = clipped(way.push_m_s2 + gain.push * off_m, _PUSH_MAX_M_S2)
