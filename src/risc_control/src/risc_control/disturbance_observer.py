"""Unmodelled behaviour of a vehicle: level, gain and lag of tilt and climb, drag, and an external acceleration (push).
Its roll, pitch and velocity are estimated with them.

Kalman filters on the measurements of motion capture and the commands in force, for each axis:

- tilt: angle, its rate, level, gain and lag: the attitude loop is angle'' = wn^2 (driven - angle) - 2 zeta wn angle',
  driven = (1 + gain) command + level + lag (command of LAG_S before - command). So a lag of 1 is LAG_S, whether of a
  slower or better damped loop or of a later link, which look much the same below their bandwidth. Rates by differencing
  noisy angles are noisy or late; the model of the attitude loop gives better ones. How well gain and lag are known
  depends on what is commanded, so this filter carries its covariance.
- height: the same for a climb loop that follows a climb rate (not `VehicleType.takes_thrust`),
  height'' = (driven - height') / tau. For a type that is commanded a thrust nothing is learnt here: its vehicle node
  trims the throttle.
- way: position, velocity and the push, the acceleration that tilt and drag do not explain: wind, mass, thrust. It is
  along north and east, whichever way the vehicle turns. The gains are the steady-state ones for the interval between
  two measurements.
- drag: its difference from that of the type, one number for both axes: on a circle it turns faster than the push is
  learnt. It is estimated as a separate bias (B. Friedland, Treatment of bias in recursive filtering, 1969): each way
  carries its sensitivities, i.e. its change per unit of additional drag.

A position or a tilt that the vehicle cannot have reached (exchanged names, say) is not believed: nothing is learnt from
it, and if it persists, the filters restart there.
"""

import math

import numpy as np
from scipy.linalg import solve_discrete_are

from risc_control.delay_prediction import (
    LOOP_STEP,
    STEP_S,
    acceleration,
    discretised,
    loop_steps,
    loops,
    stepped,
)
from risc_control.vehicles import clipped
from risc_lab.command_history import Channel
from risc_lab.compiled import compiled, record

LAG_STEPS = 20  # of STEP_S
LAG_S = LAG_STEPS * STEP_S
_MAX_GAP_S = 0.1  # a longer gap between measurements restarts the filters
_TABLE_S = 0.0005  # resolution of their step
_GAIN_EVERY = 10  # of these steps share the gains of the way
_RATE, _LEVEL = 1.0, 0.01  # initial standard deviations
_FORGET_S = 300.0  # gain, lag and drag decay to 0 with this time constant, unless motion shows them
_LEVEL_MAX, _GAIN_MAX, _LAG_MAX, _PUSH_MAX_M_S2, _DRAG_MAX_1_S = 0.1, 0.3, 1.2, 3.0, 1.0  # more is something else
_FALSE_M, _FALSE_RAD = 0.04, 0.15  # a measurement is false this far from the prediction, in any direction
_FALSE_S = 0.2  # what seems false for longer is true

# Gains of a way along one axis, from a measured position on position, velocity and push. Variances: of the innovation,
# and of the drag, at first.
_WAY_GAIN = record("place rate push variance_m2 drag_1_s2")
_AS_MEASURED = 1.0, -1.0, 0.0, 1.0, 0.0  # no push is learnt: position and velocity are the measured ones
# Of a type, by the number of steps of _TABLE_S since the previous measurement.
STEP = record(("phi", LOOP_STEP), ("theta", LOOP_STEP), ("height", LOOP_STEP), ("way", _WAY_GAIN))
# Variances: of a measured value; of the noise on rate and level, per second; of gain and lag.
_UNKNOWN = record("value rate_per_s level_per_s gain lag")

_N = 5  # value, rate, level, gain, lag
_AXIS = record("value rate level gain lag", ("P", float, (_N, _N)))
# explained_m_s2: acceleration by tilt and drag at the last measurement; then the sensitivities to the drag
_WAY = record("m m_s push_m_s2 explained_m_s2", "place_m_s rate_m push_m_s")
# Of a vehicle. time_s: of the newest measurement; true_s: of the newest that was believed.
# drag_1_s: by how much its drag over mass exceeds that of its type; and the variance of that.
OBSERVED = record(
    ("phi", _AXIS), ("theta", _AXIS), ("height", _AXIS), ("north", _WAY), ("east", _WAY),
    "time_s true_s drag_1_s drag_variance",
)  # fmt: skip


def unseen(n):
    """(n,) OBSERVED of vehicles that were not measured yet."""
    observed = np.zeros(n, OBSERVED)
    observed["time_s"] = observed["true_s"] = -np.inf
    return observed


def observer(vehicle_types, params):
    """((k, steps) STEP, (k, 2) _UNKNOWN of tilt and height) of k VehicleTypes, for `observe`.

    params: has angle_noise_rad, height_noise_m, position_noise_m: standard deviations of the measurements;
    tilt_disturbance_rad_s2, climb_disturbance_m_s2: densities of unmodelled accelerations of the loops
    [rad/s^2/sqrt(Hz), m/s^2/sqrt(Hz)]; level_rad_s, push_m_s3: densities by which level [rad/s/sqrt(Hz)] and push
    [m/s^3/sqrt(Hz)] change, climb_level_m_s2 that by which the zero of the climb rate does; gain_spread, lag_spread_s,
    drag_spread_1_s: standard deviations of gain, lag and drag. Those of the last six that are 0 are not learnt; nor is
    the drag if the push is not.
    """
    A, b = (np.stack(part)[:, : Channel.YAW_RATE] for part in zip(*map(loops, vehicle_types)))
    times_s = _TABLE_S * np.arange(1, round(_MAX_GAP_S / _TABLE_S) + 1)
    every = np.repeat(A[:, None], len(times_s), axis=1), np.repeat(b[:, None], len(times_s), axis=1)
    table = loop_steps(*discretised(*every, times_s[:, None, None, None]))
    steps = np.zeros(table.shape[:2], STEP)
    steps["phi"], steps["theta"], steps["height"] = (table[..., channel] for channel in range(Channel.YAW_RATE))
    steps["way"] = _AS_MEASURED
    if params.push_m_s3 > 0.0:
        steps["way"] = _way_gains(times_s, params.position_noise_m, params.push_m_s3)
        steps["way"]["drag_1_s2"] = params.drag_spread_1_s**2
    learnt = params.gain_spread, params.lag_spread_s / LAG_S
    tilt = params.angle_noise_rad, params.tilt_disturbance_rad_s2, params.level_rad_s, *learnt
    height = params.height_noise_m, params.climb_disturbance_m_s2, params.climb_level_m_s2, *learnt
    unknown = np.tile([tilt, height], (len(vehicle_types), 1, 1))
    for kind, vehicle_type in enumerate(vehicle_types):
        if vehicle_type.takes_thrust:
            unknown[kind, 1, 2:] = 0.0
    return steps, (unknown**2).view(_UNKNOWN)[..., 0]


def _way_gains(times_s, noise_m, push_m_s3):
    """(steps,) _WAY_GAIN of place'' = push, where the push is a random walk of this density."""
    gains = np.zeros(len(times_s), _WAY_GAIN)
    for first in range(0, len(times_s), _GAIN_EVERY):
        Phi, _ = discretised(np.eye(3, k=1), np.zeros(3), times_s[first + _GAIN_EVERY - 1])
        Q = np.diag([0.0, 0.0, push_m_s3**2 * times_s[first + _GAIN_EVERY - 1]]) + 1e-15 * np.eye(3)
        P = solve_discrete_are(Phi.T, np.eye(3)[:, :1], Q, [[noise_m**2]])
        variance_m2 = P[0, 0] + noise_m**2
        gains[first : first + _GAIN_EVERY] = *(P[:, 0] / variance_m2), variance_m2, 0.0
    return gains


@compiled
def forget(observed, unknown):
    """Forget level, gain, lag and drag of a vehicle: it stood, or did not obey the commands."""
    observed.drag_1_s = observed.drag_variance = 0.0
    _forget(observed.phi, unknown[0])
    _forget(observed.theta, unknown[0])
    _forget(observed.height, unknown[1])


@compiled
def _forget(axis, unknown):
    axis.level = axis.gain = axis.lag = 0.0
    axis.P[2:, :] = axis.P[:, 2:] = 0.0
    axis.P[2, 2] = _LEVEL**2 if unknown.level_per_s > 0.0 else 0.0
    axis.P[3, 3], axis.P[4, 4] = unknown.gain, unknown.lag


@compiled
def observe(observed, time_s, tilt, way, command, earlier, psi_rad, plant, steps, unknown):
    """Update a vehicle's OBSERVED to time_s by a measurement.

    tilt: (phi, theta, phi', theta') and way: (north, east, up, their rates); the rates are used only to start. What is
    not finite counts as not measured.
    command: in force since the last measurement; earlier: LAG_S before.  steps, unknown: see `observer`.
    """
    if not math.isfinite(sum(tilt) + sum(way) + psi_rad):
        return
    since_s = time_s - observed.time_s
    j = np.rint(since_s / _TABLE_S)
    observed.time_s = time_s
    if j == 0.0:
        return
    phi, theta, height = observed.phi, observed.theta, observed.height
    north, east = observed.north, observed.east
    if 1.0 <= j <= len(steps):
        step = steps[int(j) - 1]
        _step_axis(phi, step.phi, command[Channel.PHI], earlier[Channel.PHI], since_s, unknown[0])
        _step_axis(theta, step.theta, command[Channel.THETA], earlier[Channel.THETA], since_s, unknown[0])
        _step_axis(height, step.height, command[Channel.CLIMB], earlier[Channel.CLIMB], since_s, unknown[1])
        north_m_s2, east_m_s2 = _explained(observed, psi_rad, command, earlier, plant)
        _step_way(north, north_m_s2, since_s)
        _step_way(east, east_m_s2, since_s)
        _keep_drag(observed, step.way, since_s)
        off_m = math.hypot(math.hypot(way[0] - north.m, way[1] - east.m), way[2] - height.value)
        off_rad = max(abs(tilt[0] - phi.value), abs(tilt[1] - theta.value))
        if off_m < _FALSE_M and off_rad < _FALSE_RAD:
            _correct_axis(phi, tilt[0], unknown[0])
            _correct_axis(theta, tilt[1], unknown[0])
            _correct_axis(height, way[2], unknown[1])
            more_1_s = _correct_drag(observed, way[0] - north.m, way[1] - east.m, step.way, plant)
            _correct_way(north, way[0], way[3], more_1_s, step.way)
            _correct_way(east, way[1], way[4], more_1_s, step.way)
            observed.true_s = time_s
            return
        if time_s - observed.true_s <= _FALSE_S:
            return
    if observed.true_s == -np.inf:
        forget(observed, unknown)
    phi.value, theta.value, phi.rate, theta.rate = tilt
    north.m, east.m, height.value, north.m_s, east.m_s, height.rate = way
    _begin(phi, unknown[0])
    _begin(theta, unknown[0])
    _begin(height, unknown[1])
    north.place_m_s = north.rate_m = north.push_m_s = east.place_m_s = east.rate_m = east.push_m_s = 0.0
    north.explained_m_s2, east.explained_m_s2 = _explained(observed, psi_rad, command, earlier, plant)
    observed.true_s = time_s


@compiled
def driven(axis, command, earlier):
    """Value that the loop of an axis really approaches, under a command and that of LAG_S before."""
    return (1.0 + axis.gain) * command + axis.level + axis.lag * (earlier - command)


@compiled
def _begin(axis, unknown):
    """Restart the covariance of value and rate, which were just measured; what was learnt is kept."""
    axis.P[:2, :] = axis.P[:, :2] = 0.0
    axis.P[0, 0], axis.P[1, 1] = unknown.value, _RATE**2


@compiled
def _step_axis(axis, loop, command, earlier, step_s, unknown):
    """Advance an axis and its covariance by a step. What is no longer to be learnt is forgotten."""
    P, changes = axis.P, earlier - command
    if unknown.level_per_s == 0.0:
        axis.level = 0.0
        P[2, :] = P[:, 2] = 0.0
    elif P[2, 2] == 0.0:  # it is to be learnt again
        P[2, 2] = _LEVEL**2
    if unknown.gain == 0.0:
        axis.gain = 0.0
        P[3, :] = P[:, 3] = 0.0
    elif P[3, 3] == 0.0:
        P[3, 3] = unknown.gain
    if unknown.lag == 0.0:
        axis.lag = 0.0
        P[4, :] = P[:, 4] = 0.0
    elif P[4, 4] == 0.0:
        P[4, 4] = unknown.lag
    axis.value, axis.rate = stepped(loop, axis.value, axis.rate, driven(axis, command, earlier))
    for k in range(_N):  # P = F P F'; the learnt part of F's first two rows: (g1, g2) (1 command changes)
        learnt = P[2, k] + command * P[3, k] + changes * P[4, k]
        P[0, k], P[1, k] = stepped(loop, P[0, k], P[1, k], learnt)
    for k in range(_N):
        learnt = P[k, 2] + command * P[k, 3] + changes * P[k, 4]
        P[k, 0], P[k, 1] = stepped(loop, P[k, 0], P[k, 1], learnt)
    P[1, 1] += unknown.rate_per_s * step_s
    P[2, 2] += unknown.level_per_s * step_s
    keep = 1.0 - step_s / _FORGET_S
    axis.gain *= keep
    axis.lag *= keep
    P[3:, :] *= keep
    P[:, 3:] *= keep
    P[3, 3] += (1.0 - keep * keep) * unknown.gain
    P[4, 4] += (1.0 - keep * keep) * unknown.lag


@compiled
def _correct_axis(axis, measured, unknown):
    """Correct an axis by a measured value."""
    P, off = axis.P, measured - axis.value
    by = 1.0 / (P[0, 0] + unknown.value)
    axis.value += P[0, 0] * by * off
    axis.rate += P[1, 0] * by * off
    axis.level = clipped(axis.level + P[2, 0] * by * off, _LEVEL_MAX)
    axis.gain = clipped(axis.gain + P[3, 0] * by * off, _GAIN_MAX)
    axis.lag = clipped(axis.lag + P[4, 0] * by * off, _LAG_MAX)
    for row in range(_N - 1, -1, -1):  # P - P_0 P_0' / (P_00 + R), below and on the diagonal, the first column last
        for k in range(row, -1, -1):
            P[row, k] -= by * P[row, 0] * P[k, 0]
    for row in range(_N):  # keep it symmetric in spite of rounding
        for k in range(row):
            P[k, row] = P[row, k]


@compiled
def _explained(observed, psi_rad, command, earlier, plant):
    """Acceleration (north, east) [m/s^2] by tilt and drag."""
    phi_rad, theta_rad, climb_m_s = observed.phi.value, observed.theta.value, observed.height.rate
    climb = driven(observed.height, command[Channel.CLIMB], earlier[Channel.CLIMB])
    north, east, _ = acceleration(phi_rad, theta_rad, psi_rad, climb_m_s, climb, plant)
    drag_1_s = plant.drag_1_s + observed.drag_1_s
    return north - drag_1_s * observed.north.m_s, east - drag_1_s * observed.east.m_s


@compiled
def _step_way(way, explained_m_s2, step_s):
    """Advance the way of an axis by a step, at whose end tilt and drag explain this acceleration."""
    half_s2 = 0.5 * step_s * step_s
    by_drag = way.push_m_s - way.m_s  # acceleration per unit of additional drag
    way.place_m_s += step_s * way.rate_m + half_s2 * by_drag
    way.rate_m += step_s * by_drag
    m_s2 = way.push_m_s2 + 0.5 * (way.explained_m_s2 + explained_m_s2)
    way.m += step_s * way.m_s + half_s2 * m_s2
    way.m_s += step_s * m_s2
    way.explained_m_s2 = explained_m_s2


@compiled
def _keep_drag(observed, gain, step_s):
    """Advance the estimate of the drag by a step. It is forgotten if it is no longer to be learnt."""
    if gain.drag_1_s2 == 0.0:
        observed.drag_1_s = observed.drag_variance = 0.0
        return
    if observed.drag_variance == 0.0:
        observed.drag_variance = gain.drag_1_s2
    keep = 1.0 - step_s / _FORGET_S
    observed.drag_1_s *= keep
    observed.drag_variance = keep * keep * observed.drag_variance + (1.0 - keep * keep) * gain.drag_1_s2


@compiled
def _correct_drag(observed, off_north_m, off_east_m, gain, plant):
    """Correct the drag by the errors of the predicted position; return the change. No drag is negative in total."""
    north, east, before_1_s = observed.north, observed.east, observed.drag_1_s
    seen = (north.place_m_s**2 + east.place_m_s**2) / gain.variance_m2
    variance = observed.drag_variance / (1.0 + observed.drag_variance * seen)
    by = variance * (north.place_m_s * off_north_m + east.place_m_s * off_east_m) / gain.variance_m2
    observed.drag_1_s, observed.drag_variance = max(clipped(before_1_s + by, _DRAG_MAX_1_S), -plant.drag_1_s), variance
    return observed.drag_1_s - before_1_s


@compiled
def _correct_way(way, place_m, rate_m_s, more_1_s, gain):
    """Correct a way by a measured position, by which the drag was raised by more_1_s."""
    off_m = place_m - way.m
    way.m += gain.place * off_m
    if gain.rate < 0.0:  # _AS_MEASURED
        way.m_s, way.push_m_s2 = rate_m_s, 0.0
        return
    way.m_s += gain.rate * off_m
    way.push_m_s2 += gain.push * off_m
    by_m_s = way.place_m_s
    way.place_m_s -= gain.place * by_m_s
    way.rate_m -= gain.rate * by_m_s
    way.push_m_s -= gain.push * by_m_s
    way.m += way.place_m_s * more_1_s
    way.m_s += way.rate_m * more_1_s
    way.push_m_s2 = clipped(way.push_m_s2 + way.push_m_s * more_1_s, _PUSH_MAX_M_S2)
