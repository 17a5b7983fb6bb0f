"""Reference at any time near now, with jerk and snap, from samples of position, velocity and acceleration.

/trajectory carries no jerk and no snap, and only the present; a controller that looks ahead over the command delay
needs both. A polynomial of degree 5, fitted to three samples and their derivatives (nine conditions), extrapolates
0.14 s of the courses to a micrometre and 0.34 s to 0.02 mm, and stamps that are a microsecond beside the time a sample
was computed for cost no more than that. (The exact fit of degree 8 would amplify such a microsecond to metres.)
"""

from enum import IntEnum

import numpy as np

from risc_lab.clock import ClockGuard, Step
from risc_lab.compiled import compiled


class Order(IntEnum):
    """First axis of a reference: the derivatives. Samples have the first three."""

    POSITION, VELOCITY, ACCELERATION, JERK, SNAP = range(5)


class Axis(IntEnum):
    """Last axis of a reference: metres in cortex axes, and the yaw in radians, + clockwise from above."""

    X, Y, Z, PSI = range(4)


ORDERS = len(Order)
_SAMPLE_ORDERS = 3
_NODES = 3
_DEGREES = (0, 2, 3, 5)  # of the polynomial through so many samples: of one, its own acceleration
_NODE_SPACING_S = 0.1
_KEEP_S = (_NODES - 1) * _NODE_SPACING_S + 0.02
_ROWS = 512  # > _KEEP_S of samples at 2 kHz
_SHORT_SPAN_S = 0.1  # less than this is too short for three samples and a degree of 5: two and a constant jerk,
_MIN_SPAN_S = 0.02  # and less than this even for that: the newest sample alone
# A step between two samples of one smooth path obeys the trapezoidal rule to the sixth decimal. A jump, a stamp that
# is not the time the sample was computed for, or an acceleration that is not the velocity's derivative does not.
_SAME_S = 1e-12  # [s] spacings of samples that differ by less are the same: their fit is known
_TOLERANCE_1_S = 0.02  # [m/s, m/s^2] error of position and of velocity per second of step
# [d, p]: factor of t^(p - d) in the d-th derivative of t^p
_POWERS = range(max(_DEGREES) + 1)
_DERIVATIVE = np.array([[np.prod(np.arange(p, p - d, -1.0)) for p in _POWERS] for d in _POWERS])


class ReferenceBuffer:
    """Samples of the references of a fixed set of vehicles, all with the same stamps.

    Axes: the last one is (x, y, z, psi): metres in any fixed frame, and radians.
    """

    def __init__(self, order=Order.SNAP):
        """order: the highest derivative that `at` gives; beyond that of the polynomial it is 0."""
        self._orders = order + 1
        self._guard = ClockGuard()
        self._stamps_s = np.empty(_ROWS)  # a ring: sample k is in row k % _ROWS
        self._ends = np.empty(2, dtype=np.int64)  # k of the oldest and of the newest
        self._spacing_s = np.full(_NODES, np.nan)  # of samples to the newest, of which the fit is
        self._fit = np.empty((max(_DEGREES) + 1, _NODES * _SAMPLE_ORDERS))
        self._resize((_SAMPLE_ORDERS, 0, len(Axis)))
        self.push(0.0, self._samples[0])  # loads what is compiled
        self.at(np.zeros(1))
        self.clear()

    def _resize(self, shape):
        self._samples = np.zeros((_ROWS,) + shape)
        self.clear()

    def clear(self):
        """Forget all samples."""
        self._ends[:] = 0, -1
        self._guard.forget()

    @property
    def newest_s(self):
        """Stamp of the newest sample [s], -inf when there is none."""
        return self._guard.newest_s

    def push(self, stamp_s, sample):
        """Add a sample (3, n, 4). A jump, another set of vehicles or a new clock forgets what was before.

        Returns False, and takes nothing, for a stamp that does not advance (see `ClockGuard`) or a number that is not
        finite.
        """
        stamp_s, sample = float(stamp_s), np.array(sample, dtype=float, order="C")  # as it was compiled for
        step = self._guard.look(stamp_s) if _is_finite(sample) else Step.REFUSED
        if step is Step.REFUSED:
            return False
        if sample.shape != self._samples.shape[1:]:
            self._resize(sample.shape)
            self._guard.look(stamp_s)
        _push(stamp_s, sample, step is Step.ADVANCES, self._stamps_s, self._samples, self._ends)
        return True

    def at(self, times_s):
        """(k, orders, n, 4) value and derivatives at times (k,); jerk and snap are 0 where only one sample is known.

        Raises ValueError when there is no sample.
        """
        if self.newest_s == -np.inf:
            raise ValueError("no reference has arrived")
        times_s = np.asarray(times_s, dtype=float)
        result = np.empty((len(times_s), self._orders) + self._samples.shape[2:])
        _at(times_s, self._stamps_s, self._samples, self._ends, self._spacing_s, self._fit, result)
        return result


@compiled
def _is_finite(sample):
    """Whether all numbers of a sample are."""
    return np.isfinite(sample).all()


@compiled
def _push(stamp_s, sample, same_clock, stamps_s, samples, ends):
    """Add a sample. same_clock: what is known has times of the same clock; see `ReferenceBuffer.push`."""
    last, k = ends[1] % _ROWS, ends[1] + 1
    row = k % _ROWS
    known = same_clock and ends[0] <= ends[1]
    stamps_s[row] = stamp_s
    for i in range(sample.shape[1]):
        for order in range(sample.shape[0]):
            for axis in range(sample.shape[2]):
                samples[row, order, i, axis] = sample[order, i, axis]
        if known:
            turned = sample[Order.POSITION, i, Axis.PSI] - samples[last, Order.POSITION, i, Axis.PSI]
            samples[row, Order.POSITION, i, Axis.PSI] -= 2.0 * np.pi * np.rint(turned / (2.0 * np.pi))
    oldest = ends[0] if known and _continues(stamp_s - stamps_s[last], samples[last], samples[row]) else k
    while stamp_s - stamps_s[oldest % _ROWS] > _KEEP_S or k - oldest >= _ROWS:
        oldest += 1
    ends[0], ends[1] = oldest, k


@compiled
def _continues(step_s, before, sample):
    """True when a sample follows from the one before by a step of one smooth path."""
    if step_s > _KEEP_S:
        return False
    worst = 0.0
    for i in range(sample.shape[1]):
        for axis in range(sample.shape[2]):
            p_0, v_0, a_0 = before[0, i, axis], before[1, i, axis], before[2, i, axis]
            p_1, v_1, a_1 = sample[0, i, axis], sample[1, i, axis], sample[2, i, axis]
            # Hermite's rule for the position and the trapezoid for the velocity, both on the numbers of one step
            velocity_error = v_1 - v_0 - 0.5 * step_s * (a_1 + a_0)
            position_error = p_1 - p_0 - 0.5 * step_s * (v_1 + v_0) + step_s * step_s / 12.0 * (a_1 - a_0)
            worst = max(worst, abs(velocity_error), abs(position_error))
    return worst < _TOLERANCE_1_S * step_s


@compiled
def _at(times_s, stamps_s, samples, ends, spacing_s, fit, result):
    """Fill the result (k, orders, n, 4); see `ReferenceBuffer.at`.

    Times are from -1/2 to 1/2 on the nodes, which conditions the fit well, and with them the d-th derivatives count
    scale^d.
    """
    nodes = np.empty(_NODES, dtype=np.int64)
    count = _find_nodes(stamps_s, ends, nodes)
    size = _DEGREES[count] + 1
    newest_s = stamps_s[nodes[0]]
    span_s = newest_s - stamps_s[nodes[count - 1]]
    middle_s, scale_s = newest_s - 0.5 * span_s, span_s if count > 1 else 1.0
    if not _is_known(stamps_s, nodes, count, spacing_s):
        _fit_nodes((stamps_s[nodes[:count]] - middle_s) / scale_s, scale_s, size, fit)
    orders = result.shape[1]
    wanted = _basis((times_s - middle_s) / scale_s, orders, size)
    result[:] = 0.0
    for k in range(len(times_s)):
        per_order = 1.0
        for d in range(orders):
            for node in range(count):
                for order in range(_SAMPLE_ORDERS):
                    weight = 0.0
                    for p in range(d, size):
                        weight += wanted[k * orders + d, p] * fit[p, node * _SAMPLE_ORDERS + order]
                    weight *= per_order
                    sample = samples[nodes[node], order]
                    for i in range(sample.shape[0]):
                        for axis in range(sample.shape[1]):
                            result[k, d, i, axis] += weight * sample[i, axis]
            per_order /= scale_s


@compiled
def _is_known(stamps_s, nodes, count, spacing_s):
    """Whether the nodes lie as those that are noted; notes them."""
    is_known = True
    for k in range(_NODES):
        new_s = stamps_s[nodes[k]] - stamps_s[nodes[0]] if k < count else -np.inf
        is_known &= new_s == spacing_s[k] or abs(new_s - spacing_s[k]) < _SAME_S
        spacing_s[k] = new_s
    return is_known


@compiled
def _fit_nodes(times, scale_s, size, fit):
    """Fill the fit (size, samples _SAMPLE_ORDERS): coefficients of the polynomial by values and derivatives at times.

    Conditions C c = data on the coefficients c: they are (C'C)^-1 C' data. Times count in units of scale_s.
    """
    C = _basis(times, _SAMPLE_ORDERS, size)
    found = np.linalg.solve(C.T @ C, C.T)
    for row in range(found.shape[0]):
        for column in range(found.shape[1]):
            fit[row, column] = found[row, column] * scale_s ** (column % _SAMPLE_ORDERS)


@compiled
def _find_nodes(stamps_s, ends, nodes):
    """Fill `nodes` with the rows of up to three samples about _NODE_SPACING_S apart, the newest first. How many."""
    oldest, newest = ends[0], ends[1]
    newest_s = stamps_s[newest % _ROWS]
    span_s = newest_s - stamps_s[oldest % _ROWS]
    nodes[0] = newest % _ROWS
    if span_s < _MIN_SPAN_S:
        return 1
    wanted = _NODES if span_s >= _SHORT_SPAN_S else 2
    spacing_s = min(_NODE_SPACING_S, span_s / (wanted - 1))
    count = 1
    for k in range(newest - 1, oldest - 1, -1):
        if stamps_s[k % _ROWS] <= newest_s - count * spacing_s + 1e-6:
            nodes[count] = k % _ROWS
            count += 1
            if count == wanted:
                break
    return count


@compiled
def _basis(times, orders, size):
    """(k orders, size): row k orders + d is the d-th derivatives of 1, t, t^2, ... at time k."""
    basis = np.zeros((len(times) * orders, size))
    for k in range(len(times)):
        for d in range(orders):
            for p in range(d, size):
                basis[k * orders + d, p] = _DERIVATIVE[d, p] * times[k] ** (p - d)
    return basis
