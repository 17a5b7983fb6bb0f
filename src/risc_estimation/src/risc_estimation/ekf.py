"""Extended Kalman filter of a vehicle: its equations (thesis 7.8, 4.4.1, corrected). No ROS; compiled.

States (`DIM`): the twelve of `risc_lab.states.S`, then a disturbance acceleration along cortex x, y and z: thrust,
trim, drag and wind that the nominal model lacks.

Model, with the command that is in force (what the vehicle settles at: roll c1, pitch c2 [rad], climb loop c3, yaw rate
c4 [rad/s]):

    up''    = gain c3 - damping up' + d3                            climb loop of the type
    phi''   = wn^2 (c1 - phi) - 2 zeta wn phi',  theta alike        attitude loops
    psi''   = (c4 - psi') / tau
    x'', y''= (g + a_up) (-tan theta, tan phi / cos theta) turned by psi, less drag, plus d1 and d2
    d'      = -d / tau_d + noise

Where the command is unknown, and near the floor, where a vehicle may stand, accelerations are noise (`free`).

With the innovation y = z - x[rows] and its covariance S = P[rows, rows] + R = L L^T:  W = L^-1 P[rows],
x + W^T L^-1 y,  P - W^T W. Angles in y are wrapped to half a turn. y^T S^-1 y = |L^-1 y|^2 is chi-square distributed.
"""

import math

import numpy as np

from risc_lab.command_history import ROWS, Channel, last_by
from risc_lab.compiled import compiled, record
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.states import AIRBORNE_M, S

DIM = len(S) + 3
STEP_S = 0.005  # longest step of the prediction
_KNOWN_S = 0.3  # an older command does not tell what the vehicle does now
_X, _V, _ANGLES, _RATES, _D = 0, 3, 6, 9, 12

# What the filter knows of a body. Noise: densities, [unit/sqrt(Hz)].
MODEL = record(
    ("follows", bool),  # commands; else (e.g. no vehicle of the fleet) every acceleration is noise
    "roll_1_s2 roll_1_s pitch_1_s2 pitch_1_s yaw_1_s",  # stiffness and damping of the loops
    "climb_gain climb_1_s drag_1_s delay_s",
    "acceleration climb_acceleration roll_noise pitch_noise yaw_noise disturbance disturbance_1_s",
    "free_acceleration free_angular",
)
# surprise: the innovations of position in units of their sigma, smoothed
TRACK = record("stamp_s", ("surprise", float, (3,)), ("x", float, (DIM,)), ("P", float, (DIM, DIM)))
WORK = record(
    ("slope", float, (DIM,)),
    ("mid", float, (DIM,)),
    ("F", float, (DIM, DIM)),
    ("Phi", float, (DIM, DIM)),
    ("A", float, (DIM, DIM)),
    ("L", float, (6, 6)),
    ("W", float, (6, DIM)),
    ("y", float, (6,)),
    ("command", float, (4,)),
)


@compiled
def slope(x, model, command, free, out):
    """Fill out (DIM,) with the time derivative of x."""
    for k in range(3):
        out[_X + k], out[_ANGLES + k], out[_D + k] = x[_V + k], x[_RATES + k], -model.disturbance_1_s * x[_D + k]
        out[_V + k] = out[_RATES + k] = 0.0
    if free:
        return
    climb_m_s2 = model.climb_gain * command[Channel.CLIMB] - model.climb_1_s * x[S.W]
    lift = GRAVITY_M_S2 + climb_m_s2
    forward, right = -lift * math.tan(x[S.THETA]), lift * math.tan(x[S.PHI]) / math.cos(x[S.THETA])
    cos_psi, sin_psi = math.cos(x[S.PSI]), math.sin(x[S.PSI])
    out[S.U] = cos_psi * forward - sin_psi * right - model.drag_1_s * x[S.U] + x[_D]
    out[S.V] = -(sin_psi * forward + cos_psi * right) - model.drag_1_s * x[S.V] + x[_D + 1]
    out[S.W] = climb_m_s2 + x[_D + 2]
    out[S.P] = model.roll_1_s2 * (command[Channel.PHI] - x[S.PHI]) - model.roll_1_s * x[S.P]
    out[S.Q] = model.pitch_1_s2 * (command[Channel.THETA] - x[S.THETA]) - model.pitch_1_s * x[S.Q]
    out[S.R] = model.yaw_1_s * (command[Channel.YAW_RATE] - x[S.R])


@compiled
def jacobian(x, model, command, free, F):
    """Fill F (DIM, DIM) with the derivative of `slope` by x."""
    F[:, :] = 0.0
    for k in range(3):
        F[_X + k, _V + k] = F[_ANGLES + k, _RATES + k] = 1.0
        F[_D + k, _D + k] = -model.disturbance_1_s
    if free:
        return
    lift = GRAVITY_M_S2 + model.climb_gain * command[Channel.CLIMB] - model.climb_1_s * x[S.W]
    tan_phi, tan_theta, cos_theta = math.tan(x[S.PHI]), math.tan(x[S.THETA]), math.cos(x[S.THETA])
    cos_psi, sin_psi = math.cos(x[S.PSI]), math.sin(x[S.PSI])
    forward, right = -tan_theta, tan_phi / cos_theta  # per lift
    by_phi = (1.0 + tan_phi * tan_phi) / cos_theta  # derivative of right
    by_theta = -(1.0 + tan_theta * tan_theta), right * tan_theta  # derivatives of forward and right
    north, east = cos_psi * forward - sin_psi * right, sin_psi * forward + cos_psi * right
    F[S.U, S.U] = F[S.V, S.V] = -model.drag_1_s
    F[S.U, S.W], F[S.V, S.W], F[S.W, S.W] = -model.climb_1_s * north, model.climb_1_s * east, -model.climb_1_s
    F[S.U, S.PHI], F[S.V, S.PHI] = -lift * sin_psi * by_phi, -lift * cos_psi * by_phi
    F[S.U, S.THETA] = lift * (cos_psi * by_theta[0] - sin_psi * by_theta[1])
    F[S.V, S.THETA] = -lift * (sin_psi * by_theta[0] + cos_psi * by_theta[1])
    F[S.U, S.PSI], F[S.V, S.PSI] = -lift * east, -lift * north
    for k in range(3):
        F[_V + k, _D + k] = 1.0
    F[S.P, S.PHI], F[S.P, S.P] = -model.roll_1_s2, -model.roll_1_s
    F[S.Q, S.THETA], F[S.Q, S.Q] = -model.pitch_1_s2, -model.pitch_1_s
    F[S.R, S.R] = -model.yaw_1_s


@compiled
def predict(track, stamp_s, model, sent, work):
    """Bring a TRACK to a later time. sent: HISTORY of the commands sent to its vehicle."""
    span_s = stamp_s - track.stamp_s
    steps = max(1, int(math.ceil(span_s / STEP_S - 1e-6)))
    dt = span_s / steps
    from_s = track.stamp_s - model.delay_s
    for step in range(steps):
        time_s = from_s + (step + 0.5) * dt
        k = last_by(sent, time_s, sent.newest)
        _step(track.x, track.P, model, sent.commands[k % ROWS], _is_free(track.x, time_s, k, model, sent), dt, work)
    track.stamp_s = stamp_s


@compiled
def copy_track(to, track):
    """Copy a TRACK into another one."""
    to.stamp_s, to.surprise[:], to.x[:], to.P[:, :] = track.stamp_s, track.surprise, track.x, track.P


@compiled
def push(track, m_s2, for_s):
    """Add the uncertainty of an unknown push along each axis in the last for_s, which may go on. m_s2: 1 sigma."""
    variance = m_s2 * m_s2
    for k in range(3):
        by = 0.5 * for_s * for_s, for_s, 1.0
        at = _X + k, _V + k, _D + k
        for i in range(3):
            for j in range(3):
                track.P[at[i], at[j]] += by[i] * by[j] * variance


@compiled
def _is_free(x, time_s, k, model, sent):
    """Whether the motion of a body is unknown. time_s: when a command that acts now was sent; k: of that command."""
    return not model.follows or not time_s - sent.times_s[k % ROWS] < _KNOWN_S or x[S.Z] < AIRBORNE_M


@compiled
def acceleration(track, model, sent, work, out):
    """Fill out (3,) with the acceleration at a TRACK [m/s^2] by `slope`, cortex axes; NaN where it is not known."""
    time_s = track.stamp_s - model.delay_s
    k = last_by(sent, time_s, sent.newest)
    free = _is_free(track.x, time_s, k, model, sent)
    slope(track.x, model, sent.commands[k % ROWS], free, work.slope)
    for axis in range(3):
        out[axis] = math.nan if free else work.slope[_V + axis]


@compiled
def _step(x, P, model, command, free, dt, work):
    """One step: x by the midpoint rule, P by the Jacobian there to the second order."""
    rate, mid, F, Phi, A = work.slope, work.mid, work.F, work.Phi, work.A
    slope(x, model, command, free, rate)
    for i in range(DIM):
        mid[i] = x[i] + 0.5 * dt * rate[i]
    slope(mid, model, command, free, rate)
    jacobian(mid, model, command, free, F)
    for i in range(DIM):
        x[i] += dt * rate[i]
    Phi[:, :] = 0.0
    for i in range(DIM):
        Phi[i, i] = 1.0
        for k in range(DIM):
            if F[i, k] != 0.0:
                Phi[i, k] += dt * F[i, k]
                for j in range(DIM):
                    if F[k, j] != 0.0:
                        Phi[i, j] += 0.5 * dt * dt * F[i, k] * F[k, j]
    A[:, :] = 0.0
    for i in range(DIM):
        for k in range(DIM):
            if Phi[i, k] != 0.0:
                for j in range(DIM):
                    A[i, j] += Phi[i, k] * P[k, j]
    P[:, :] = 0.0
    for j in range(DIM):
        for k in range(DIM):
            if Phi[j, k] != 0.0:
                for i in range(j + 1):
                    P[i, j] += A[i, k] * Phi[j, k]
    if free:
        for k in range(3):
            _add_noise(P, _X + k, _V + k, model.free_acceleration, dt)
            _add_noise(P, _ANGLES + k, _RATES + k, model.free_angular, dt)
    else:
        _add_noise(P, S.X, S.U, model.acceleration, dt)
        _add_noise(P, S.Y, S.V, model.acceleration, dt)
        _add_noise(P, S.Z, S.W, model.climb_acceleration, dt)
        _add_noise(P, S.PHI, S.P, model.roll_noise, dt)
        _add_noise(P, S.THETA, S.Q, model.pitch_noise, dt)
        _add_noise(P, S.PSI, S.R, model.yaw_noise, dt)
    for k in range(3):
        P[_D + k, _D + k] += model.disturbance * model.disturbance * dt
    for i in range(DIM):
        for j in range(i):
            P[i, j] = P[j, i]


@compiled
def _add_noise(P, i, j, density, dt):
    """Add the noise of a white second derivative of state i, whose rate is state j > i; above the diagonal."""
    q = density * density * dt
    P[i, i] += q * dt * dt / 3.0
    P[i, j] += q * dt / 2.0
    P[j, j] += q


@compiled
def innovate(track, z, R, rows, first, count, work):
    """|L^-1 y|^2 of entries first to first + count of a measurement z with covariance R; fills work.

    rows: the state that each entry of z measures.  NaN when S is not positive definite.
    """
    L, y, square = work.L, work.y, 0.0
    for i in range(count):
        row = rows[first + i]
        y[i] = z[first + i] - track.x[row]
        if _ANGLES <= row < _RATES:
            y[i] -= 2.0 * math.pi * np.rint(y[i] / (2.0 * math.pi))
    for i in range(count):
        for j in range(i + 1):
            total = track.P[rows[first + i], rows[first + j]] + R[first + i, first + j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = math.sqrt(total) if i == j else total / L[j, j]
        for k in range(i):
            y[i] -= L[i, k] * y[k]
        y[i] /= L[i, i]
        square += y[i] * y[i]
    return square


@compiled
def correct(track, rows, first, count, work):
    """Correct a TRACK with the entries that `innovate` was called for."""
    L, W, y, P = work.L, work.W, work.y, track.P
    for i in range(count):
        for j in range(DIM):
            total = P[rows[first + i], j]
            for k in range(i):
                total -= L[i, k] * W[k, j]
            W[i, j] = total / L[i, i]
    for i in range(count):
        for j in range(DIM):
            track.x[j] += W[i, j] * y[i]
    for i in range(DIM):
        for j in range(i, DIM):
            total = 0.0
            for k in range(count):
                total += W[k, i] * W[k, j]
            P[i, j] -= total
            P[j, i] = P[i, j]
