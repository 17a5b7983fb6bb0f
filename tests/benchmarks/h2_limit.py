"""The best accuracy in gusts of any controller: the H2-optimal one, which knows plant, delay, noise and spectrum.

Near hover each axis of a vehicle is linear, and so are the best estimator and the best controller of it (separation):

    p' = v,   v' = g tilt - drag v + push,   tilt'' = wn^2 (command - tilt) - 2 zeta wn tilt'     forward, to the left
    p' = v,   v' = command - damping v + push                                                     up
    push' = -push / tau + white noise                                                             the gust

Every frame measures position and tilt; the steady Kalman filter estimates them best. A command takes effect one delay
after its frame's exposure, and is held until the next one, 1/rate later. The commands before it are known, so the delay
costs only what gusts do meanwhile: the filter's state is predicted to the time of the command, which is equivalent to a
chain of registers and works for delays of any length. The gain is optimal for the sampled loop: its cost is the mean of
E[p^2] over all times, also those between commands, with almost no weight on the command. The reference is feasible and
known ahead, so it adds no error.

Without a weight commands are as large as needed, beyond what any vehicle can follow: a bound that no controller beats.
With a weight that keeps their RMS within a part of the full scale, it is the bound for linear controllers whose
commands a vehicle can follow. Both trust their plant so much that they have almost no margins: `trade` gives the cost
of margins. Not included is what real controllers lose by plants that differ from their type, and by courses that tilt.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm, matrix_balance, solve_discrete_are, solve_discrete_lyapunov
from scipy.optimize import brentq

from risc_lab.frames import GRAVITY_M_S2

_INSTANTS = 16  # between two commands, at which the error is evaluated
_LEAST_WEIGHT, _MOST_WEIGHT = 1e-16, 1e4  # [s^4] of a squared command, an acceleration, over that of a squared position
_TRADE_S = 1.6, 1.8, 2.0, 2.5, 3.0, 4.0, 6.0  # largest |S|
_TRADE_WEIGHTS, _TRADE_DOUBTS = np.geomspace(1e-5, 1.0, 16), (0.0, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.3)
_DECAY_S = 8.0  # of a pulse


class Axis(NamedTuple):
    """x' = A x + b u + g w with white noise w of density 1; x[0] is the position [m], u [m/s^2].

    Each frame measures H x + white noise of covariance R.
    """

    full_scale_m_s2: float  # of u
    A: np.ndarray  # (n, n)
    b: np.ndarray  # (n,)
    g: np.ndarray  # (n,)
    H: np.ndarray  # (m, n)
    R: np.ndarray  # (m, m), positive definite


def gust_limit_m(vehicle_type, pose_covariance, gust_m_s2, gust_time_s, latency_s=0.0, frame_s=0.005, sigmas=0.0):
    """Least RMSE of the position [m], all three axes together, of a vehicle of this VehicleType in gusts.

    pose_covariance: (6, 6) of what motion capture measures in a frame, as `risc_estimation.pose_fit.Poses.covariances`
    gives it for a vehicle that is level and heads along x.   gust_m_s2: 1 sigma of the acceleration that gusts give the
    vehicle along each axis, first-order Gauss-Markov with the correlation gust_time_s.   latency_s: from the exposure
    of a frame to its command, without the type's command_delay_s and, on average, half a frame.   frame_s: from one
    frame to the next.   sigmas: so many times the RMS of a command stay within its full scale; 0: commands may be of
    any size.
    0 without gusts: then a known vehicle needs no feedback. Raises ValueError for impossible numbers.
    """
    if min(gust_m_s2, latency_s, sigmas) < 0.0 or not min(gust_time_s, frame_s) > 0.0:
        numbers = gust_m_s2, latency_s, sigmas, gust_time_s, frame_s
        text = "gust_m_s2, latency_s and sigmas must be >= 0, gust_time_s and frame_s > 0, got %r"
        raise ValueError(text % (numbers,))
    if gust_m_s2 == 0.0:
        return 0.0
    times, errors_m = _times(vehicle_type, latency_s, frame_s), []
    for axis in axes_of(vehicle_type, pose_covariance, gust_m_s2, gust_time_s):
        most_m_s2 = axis.full_scale_m_s2 / sigmas if sigmas else math.inf
        errors_m.append(_least(axis, times, most_m_s2))
    return math.hypot(*errors_m)


def _least(axis, times, most_m_s2):
    """Least RMS of x[0] with a command whose RMS is at most most_m_s2. times: last arguments of `rms`."""

    def found(log_weight):
        return rms(axis, optimal_gain(axis, times[1], 10.0**log_weight), *times)

    low, high = math.log10(_LEAST_WEIGHT), math.log10(_MOST_WEIGHT)
    if found(low)[1] > most_m_s2:
        low = brentq(lambda log_weight: math.log(found(log_weight)[1] / most_m_s2), low, high, xtol=1e-3)
    return found(low)[0]


def axes_of(vehicle_type, pose_covariance, gust_m_s2, gust_time_s):
    """[Axis] forward, to the left, up; arguments as of `gust_limit_m`. u: what a command settles at, or begins with."""
    C, drag_1_s = np.asarray(pose_covariance, dtype=float), vehicle_type.drag_n_s_m / vehicle_type.mass_kg
    gust = -1.0 / gust_time_s, gust_m_s2 * math.sqrt(2.0 / gust_time_s)  # pole; density [m/s^3/sqrt(Hz)]
    axes = []
    # a turn about y tilts the thrust forward, a negative turn about x to the left
    for loop, position, turn, sense in (vehicle_type.pitch, 0, 4, 1.0), (vehicle_type.roll, 1, 3, -1.0):
        wn, zeta = loop.natural_frequency_rad_s, loop.damping_ratio
        A, b, g = np.zeros((5, 5)), np.zeros(5), np.zeros(5)
        A[0, 1] = A[1, 4] = A[2, 3] = 1.0
        A[1, 1:3] = -drag_1_s, GRAVITY_M_S2
        A[3, 2:4] = -wn * wn, -2.0 * zeta * wn
        b[3], (A[4, 4], g[4]) = wn * wn / GRAVITY_M_S2, gust
        H = np.zeros((2, 5))
        H[0, 0], H[1, 2] = 1.0, sense
        full_scale_m_s2 = GRAVITY_M_S2 * loop.gain * vehicle_type.tilt_max_rad
        axes.append(Axis(full_scale_m_s2, A, b, g, H, C[np.ix_([position, turn], [position, turn])]))
    damping_1_s = drag_1_s if vehicle_type.takes_thrust else drag_1_s + 1.0 / vehicle_type.climb_time_constant_s
    A, b, g = np.array([[0.0, 1.0, 0.0], [0.0, -damping_1_s, 1.0], [0.0, 0.0, 0.0]]), np.eye(3)[1], np.zeros(3)
    A[2, 2], g[2] = gust
    full_scale_m_s2 = vehicle_type.climb_max_m_s / vehicle_type.climb_time_constant_s
    return [*axes, Axis(full_scale_m_s2, A, b, g, np.eye(1, 3), C[2:3, 2:3])]


def optimal_gain(axis, hold_s, weight=_LEAST_WEIGHT):
    """(n,) K of the command -K x that makes the mean of x[0]^2 + weight u^2 least, of commands held for hold_s [s]."""
    Phi, Gamma, _ = _over(axis, hold_s)
    c, d, _ = _error(axis, hold_s)
    Q, S, R = c.T @ c / _INSTANTS, c.T @ d / _INSTANTS, d @ d / _INSTANTS + weight
    X = solve_discrete_are(Phi, Gamma[:, None], Q, np.array([[R]]), s=S[:, None])
    return (Gamma @ X @ Phi + S) / (R + Gamma @ X @ Gamma)


def rms(axis, K, delay_s, hold_s, frame_s):
    """(RMS of x[0] of an Axis, RMS of u), over all time, with u = -K times the best estimate of x at its start.

    delay_s: from a frame to the start of its command.   hold_s: from a command to the next.
    frame_s: from a frame to the next.   Raises ValueError for a K that does not stabilise the axis.
    """
    H, R = axis.H, axis.R
    Phi, _, W = _over(axis, frame_s)
    P = solve_discrete_are(Phi.T, H.T, W, R)
    P = P - P @ H.T @ np.linalg.solve(H @ P @ H.T + R, H @ P)  # after the frame
    Phi, _, W = _over(axis, delay_s)
    P = Phi @ P @ Phi.T + W  # when its command begins
    Phi, Gamma, W = _over(axis, hold_s)
    loop, scale = matrix_balance(Phi - np.outer(Gamma, K), permute=False)
    if not np.abs(np.linalg.eigvals(loop)).max() < 1.0:
        raise ValueError("the loop with this gain is not stable: %r" % (K,))
    told = np.linalg.solve(scale, np.linalg.solve(scale, Phi @ P @ Phi.T + W - P).T)  # covariance of what a frame adds
    known = scale @ solve_discrete_lyapunov(loop, told) @ scale.T  # covariance of the estimate
    c, d, w = _error(axis, hold_s)
    moved = c - np.outer(d, K)
    errors = np.einsum("ti,ij,tj->t", moved, known, moved) + np.einsum("ti,ij,tj->t", c, P, c) + w
    return math.sqrt(errors.mean()), math.sqrt(K @ known @ K)


def sampled_loop(axis, K, doubt, delay_s, hold_s, frame_s):
    """(RMS of x[0], largest |S|) of the loop with this K, and a filter that assumes more noise than there is.

    doubt: density of white noise on u [m/s^2/sqrt(Hz)] that the filter assumes and that is not there: it makes the loop
    more robust, and the filter less accurate (loop transfer recovery).   |S|: broken at the command, up to half the
    rate of the commands, as `risc_experiments.loop_margins` finds it in flights: from the commands that follow a pulse,
    one command long, that filter and predictor do not know.   Frames and delay are rounded, to whole parts of a hold
    and to frames; the rest is as in `rms`. Raises ValueError for a loop that is not stable.
    """
    n, H, frames = len(axis.b), axis.H, max(1, round(hold_s / frame_s))  # of a hold
    late = round(delay_s * frames / hold_s)  # frames
    Phi, Gamma, W = _over(axis, hold_s / frames)
    R = axis.R * frame_s * frames / hold_s  # the same noise in total
    P = solve_discrete_are(Phi.T, H.T, W + doubt**2 * hold_s / frames * np.outer(axis.b, axis.b), R)
    L = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)

    # state: x, its estimate, the command in force, those of the frames to come until the newest
    size, now, newest = 2 * n + late + 1, 2 * n, 2 * n + late
    x, known, ahead = slice(0, n), slice(n, 2 * n), np.zeros((n, size))
    see, command, move = np.eye(size), np.eye(size), np.eye(size, k=1)
    see[known, x], see[known, known] = L @ H, np.eye(n) - L @ H
    ahead[:, known] = np.eye(n)
    for k in range(now, newest):
        ahead = Phi @ ahead
        ahead[:, k] += Gamma
    command[newest] = -K @ ahead
    move[:now] = 0.0
    move[x, x] = move[known, known] = Phi
    move[x, now] = move[known, now] = Gamma
    move[newest, newest] = 1.0
    noise, pulse = np.zeros((size, size)), np.zeros(size)
    noise[x, x], noise[known, known], pulse[x] = W, L @ R @ L.T, Gamma

    turn, covariance, steps = np.eye(size), np.zeros((size, size)), []
    for k in range(frames):
        decide = command if k == 0 else np.eye(size)
        step, moved = move @ decide @ see, move @ decide
        moved_noise = moved[:, known] @ noise[known, known] @ moved[:, known].T
        moved_noise[x, x] += W
        steps.append((step, moved_noise, decide @ see))
        turn, covariance = step @ turn, step @ covariance @ step.T + moved_noise
    if not np.abs(np.linalg.eigvals(turn)).max() < 1.0:
        raise ValueError("the loop with this gain and doubt is not stable: %r, %r" % (K, doubt))
    covariance, variances = solve_discrete_lyapunov(turn, covariance), []
    for step, moved_noise, _ in steps:
        variances.append(covariance[0, 0])
        covariance = step @ covariance @ step.T + moved_noise

    first = late % frames  # in which a command comes into force
    state, answers = np.zeros(size), []
    for k in range(first, first + round(_DECAY_S / hold_s) * frames):
        step, _, decided = steps[k % frames]
        if (k - first) % frames == 0:
            answers.append(decided[now] @ state)
        state = step @ state + (pulse if k - first < frames else 0.0)
    frequencies_rad_s = np.geomspace(0.1, math.pi / hold_s, 300)
    turns = np.exp(-1j * hold_s * np.outer(frequencies_rad_s, np.arange(len(answers))))
    return math.sqrt(np.mean(variances)), float(np.abs(1.0 + turns @ answers).max())


def trade(vehicle_type, pose_covariance, gust_m_s2, gust_time_s, latency_s=0.0, frame_s=0.005):
    """[(largest |S| in any axis, least RMSE [m])]: the cost of margins.

    Of controllers with two tuning parameters, weight of the command and doubt of the filter; others may do better.
    Infinite RMSE where no controller has such margins. Arguments as for `gust_limit_m`.
    """
    times, fronts = _times(vehicle_type, latency_s, frame_s), []
    for axis in axes_of(vehicle_type, pose_covariance, gust_m_s2, gust_time_s):
        gains = [optimal_gain(axis, times[1], weight) for weight in _TRADE_WEIGHTS]
        loops = [sampled_loop(axis, K, doubt, *times) for K in gains for doubt in _TRADE_DOUBTS]
        fronts.append([min((error for error, s in loops if s <= most), default=math.inf) for most in _TRADE_S])
    return [(most, math.hypot(*errors)) for most, errors in zip(_TRADE_S, zip(*fronts))]


def _times(vehicle_type, latency_s, frame_s):
    """(delay_s, hold_s, frame_s) as `rms` takes them."""
    return latency_s + 0.5 * frame_s + vehicle_type.command_delay_s, 1.0 / vehicle_type.command_rate_hz, frame_s


def _error(axis, hold_s):
    """(c (k, n), d (k,), w (k,)): at k instants of a hold x[0] is c x + d u + noise of variance w; x: at its begin."""
    over = [_over(axis, hold_s * (k + 0.5) / _INSTANTS) for k in range(_INSTANTS)]
    return tuple(np.array(part) for part in zip(*((Phi[0], Gamma[0], W[0, 0]) for Phi, Gamma, W in over)))


def _over(axis, time_s):
    """(Phi, Gamma, W): after a time x is Phi x + Gamma u + noise of covariance W, with u held (Van Loan)."""
    n = len(axis.A)
    F, noise = np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1))
    F[:n, :n], F[:n, n], noise[:n, :n] = axis.A, axis.b, np.outer(axis.g, axis.g)
    both = expm(time_s * np.block([[-F, noise], [np.zeros_like(F), F.T]]))
    Phi = both[n + 1 :, n + 1 :].T
    W = Phi @ both[: n + 1, n + 1 :]
    return Phi[:n, :n], Phi[:n, n], 0.5 * (W + W.T)[:n, :n]
