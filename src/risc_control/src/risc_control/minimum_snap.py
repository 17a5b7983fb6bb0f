"""Minimum-snap paths through waypoints: polynomials of degree 7.

Between two waypoints each coordinate is the polynomial that has given values and three given derivatives at both ends.
The derivatives at the waypoints are those for which the integral of the squared snap is least: a linear system in which
each waypoint is coupled to its neighbours only. The path is continuous to the sixth derivative.

The times between waypoints are those that minimise that integral for a given total time; its gradient is taken with the
derivatives fixed, since the integral is at its minimum with respect to them.

The polynomial of a piece is one of the fraction u of its duration, 0 to 1, lowest power first.
"""

import math
from functools import partial

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from scipy.optimize import minimize
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

COEFFICIENTS = 8  # of a piece and a coordinate
_DERIVATIVES = 4  # at a waypoint: the position to the jerk
_POWERS = np.arange(_DERIVATIVES)
_FRACTIONS = np.linspace(0.0, 1.0, 33)  # of a piece, where its speed is sampled
_SNAP = 4
_SPREAD = math.log(7.0)  # limit of the logarithms of times: larger ratios to the seventh power lose all precision


def _unit_piece():
    """((8, 8) coefficients for each of the end values (value to jerk at 0, then at 1), (8, 8) their squared snap)."""
    at_ends = np.zeros((2, _DERIVATIVES, COEFFICIENTS))
    for k in range(COEFFICIENTS):
        unit = np.eye(COEFFICIENTS)[k]
        for d in range(_DERIVATIVES):
            at_ends[:, d, k] = polyval(np.array([0.0, 1.0]), polyder(unit, d) if d else unit)
    basis = np.linalg.inv(at_ends.reshape(COEFFICIENTS, COEFFICIENTS))
    snaps = polyder(basis, _SNAP)  # (4, 8)
    powers = np.add.outer(np.arange(len(snaps)), np.arange(len(snaps))) + 1.0
    return basis, snaps.T @ (1.0 / powers) @ snaps


_BASIS, _COST = _unit_piece()


def pieces(points, durations_s, closed):
    """(m, 8, c) coefficients of the path through points (n, c) with times between them (m,).

    closed: m = n and the last piece leads back to the first point; else m = n - 1 and the path rests at both ends.
    """
    ends = _end_values(points, durations_s, closed)
    return np.einsum("ke,mec->mkc", _BASIS, _scales(durations_s)[..., None] * ends)


def reversed_pieces(coefficients):
    """The same pieces (m, 8, c) flown back, the last one first."""
    back = np.zeros((COEFFICIENTS, COEFFICIENTS))  # u -> 1 - u
    for k in range(COEFFICIENTS):
        for j in range(k + 1):
            back[j, k] = math.comb(k, j) * (-1) ** j
    return np.einsum("jk,mkc->mjc", back, coefficients[::-1])


def best_durations(points, closed):
    """(m,) times between points (n, c) of the path with the least snap for a given total time; their sum is 1.

    Two neighbours must not coincide.
    """
    others = np.roll(points, -1, axis=0) if closed else points[1:]
    first = 0.5 * np.log(np.linalg.norm(others - points[: len(others)], axis=1))
    first = np.clip(first - first.mean(), -_SPREAD, _SPREAD)
    limits = [(-_SPREAD, _SPREAD)] * len(first)
    found = minimize(partial(_cost, points=points, closed=closed), first, jac=True, method="L-BFGS-B", bounds=limits)
    durations = np.exp(found.x)
    return durations / durations.sum()


def greatest_speed(coefficients, durations_s):
    """Greatest speed along pieces (m, 8, c) that take durations_s (m,)."""
    slopes = [polyval(_FRACTIONS, polyder(piece)) / duration_s for piece, duration_s in zip(coefficients, durations_s)]
    return max(float(np.linalg.norm(slope, axis=0).max()) for slope in slopes)


def _scales(durations_s):
    """(m, 8) factors of the end values for derivatives by the fraction of a piece."""
    return np.tile(durations_s[:, None] ** _POWERS, 2)


def _cost(logarithms, points, closed):
    """(logarithm of the squared snap, for a total time of 1; its gradient) by logarithms of times (m,)."""
    durations = np.exp(logarithms)
    scaled = _scales(durations)[..., None] * _end_values(points, durations, closed)  # (m, 8, c)
    each = np.einsum("mec,ef,mfc->m", scaled, _COST, scaled) / durations ** (2 * _SNAP - 1)
    slopes = 2.0 * np.einsum("mec,ef,mfc->m", np.tile(_POWERS, 2)[:, None] * scaled, _COST, scaled)
    slopes = slopes / durations ** (2 * _SNAP - 1) - (2 * _SNAP - 1) * each  # by the logarithm of the time
    total, whole = each.sum(), durations.sum()
    return math.log(total) + (2 * _SNAP - 1) * math.log(whole), slopes / total + (2 * _SNAP - 1) * durations / whole


def _end_values(points, durations_s, closed):
    """(m, 8, c) values to jerks at the start and at the end of each piece, of the minimum-snap path."""
    n, m = len(points), len(durations_s)
    begin = np.arange(m)
    nodes = np.stack([begin, (begin + 1) % n], axis=1)
    places = (_DERIVATIVES * nodes[:, :, None] + _POWERS).reshape(m, COEFFICIENTS)
    scales = _scales(durations_s)
    blocks = scales[:, :, None] * _COST * scales[:, None, :] / durations_s[:, None, None] ** (2 * _SNAP - 1)
    rows, columns = (np.broadcast_to(place, blocks.shape).ravel() for place in (places[:, :, None], places[:, None]))
    size = _DERIVATIVES * n
    system = coo_matrix((blocks.ravel(), (rows, columns)), shape=(size, size)).tocsc()
    free = np.arange(size) % _DERIVATIVES > 0
    if not closed:
        free[:_DERIVATIVES] = free[-_DERIVATIVES:] = False  # at rest
    values = np.zeros((size, points.shape[1]))
    values[::_DERIVATIVES] = points
    if free.any():
        values[free] = splu(system[free][:, free]).solve(-(system[free] @ values))
    return values[places]
