"""Reference at any time near now, with as many derivatives as a controller reads, from samples.

/trajectory carries position, velocity and acceleration of the present; a controller that predicts over the command
delay needs jerk and snap, too. A polynomial of degree 5, fitted to three samples and their derivatives (nine
conditions), extrapolates the courses by 0.14 s to a micrometre and by 0.34 s to 0.02 mm. Stamps that are a microsecond
off the time a sample was computed for cost no more than that. (The exact fit of degree 8 would amplify such a
microsecond to metres.)

Samples with more derivatives are Taylor series: the newest one alone gives the reference.
"""

import functools
import math
from bisect import bisect
from collections import deque
from enum import IntEnum
from operator import itemgetter

import numpy as np

from risc_lab.clock_guard import ClockGuard, Step
from risc_lab.compiled import compiled


class Order(IntEnum):
    """First axis of a reference: the derivatives that have names. /trajectory has the first three."""

    POSITION, VELOCITY, ACCELERATION, JERK, SNAP = range(5)


class Axis(IntEnum):
    """Last axis of a reference: metres in cortex axes, and the yaw in radians, + clockwise from above."""

    X, Y, Z, PSI = range(4)


MOST_ORDER = 12  # of a controller
_LEGACY_ORDERS = 3  # of /trajectory
_NODES = 3
_DEGREES = (0, 2, 3, 5)  # of the polynomial, by the number of samples; one: by its own acceleration
_NODE_SPACING_S = 0.1
_KEEP_S = (_NODES - 1) * _NODE_SPACING_S + 0.02
_SHORT_SPAN_S = 0.1  # a shorter span of samples: not three and a degree of 5, but two and a constant jerk;
_MIN_SPAN_S = 0.02  # a shorter one than this: the newest sample alone
_SAME_S = 1e-12  # [s] spacings of samples that differ by less are the same: the fit is reused
# A step between two samples of one smooth path obeys the trapezoidal rule to the sixth decimal. A jump, a stamp that
# is not the time the sample was computed for, or an acceleration that is not the velocity's derivative does not.
_TOLERANCE_1_S = 0.02  # [m/s, m/s^2] error of position and of velocity per second of step


def sample_orders(order):
    """Number of derivatives, the position included, in the samples for a reference to that order.

    Up to snap those of /trajectory. Beyond, as many as the polynomials of ways have that are smooth to that order: with
    fewer the series is not exact where the command takes effect. Raises ValueError for an order > MOST_ORDER.
    """
    if order > MOST_ORDER:
        raise ValueError("references have derivatives to order %d at most, got %d" % (MOST_ORDER, order))
    return _LEGACY_ORDERS if order <= Order.SNAP else 2 * order + 2


class ReferenceBuffer:
    """Samples of the references of a fixed set of vehicles, all with the same stamps.

    Axes: the last one is (x, y, z, psi): metres in any fixed frame, and radians.
    """

    def __init__(self, order=Order.SNAP):
        """order: the highest derivative that `at` returns; those beyond the polynomial's degree are 0."""
        self.sample_orders = sample_orders(order)
        self._orders = order + 1
        self._guard = ClockGuard()
        self._samples = deque()  # (stamp, sample), the newest last
        self._spacing_s = ()  # of the samples that `_fit` is for
        self.known = None  # (n,) bool of the newest sample: the vehicle has a reference; `at` gives NaN for the others
        for stamp_s in (0.0, 0.01):  # loads the compiled code, two samples for that of their comparison
            self.push(stamp_s, np.zeros((self.sample_orders, 1, len(Axis))))
        self.at(np.zeros(1))
        self._guard.forget()

    @property
    def newest_s(self):
        """Stamp of the newest sample [s], -inf when there is none."""
        return self._guard.newest_s

    def push(self, stamp_s, sample):
        """Add a sample (orders, n, 4): 3 orders, or a Taylor series of more. A jump, another set of vehicles or a new
        clock discards earlier samples.

        A vehicle with a number that is not finite has no reference (`known`) until all samples that `at` uses are
        finite again; the others keep theirs. Returns False, and adds nothing, for a stamp that does not advance (see
        `ClockGuard`) or when no vehicle has a reference.
        """
        # In C order, whatever the message's: for another one all functions would be compiled, or loaded, in flight.
        stamp_s, sample = float(stamp_s), np.array(sample, dtype=float, order="C")
        known = np.empty(sample.shape[1], dtype=bool)
        if not _find_finite(sample, known):
            self.known = known
            return False
        step = self._guard.look(stamp_s)
        if step is Step.REFUSED:
            return False
        if self._samples and step is Step.ADVANCES and self._samples[-1][1].shape == sample.shape:
            last_s, last = self._samples[-1]
            if not _continues(stamp_s - last_s, last, sample):
                self._samples.clear()
        else:
            self._samples.clear()
        self._samples.append((stamp_s, sample))
        while stamp_s - self._samples[0][0] > _KEEP_S:
            self._samples.popleft()
        self._fit_polynomial()
        _find_finite(self._polynomial, known)
        self.known = known
        return True

    def at(self, times_s):
        """(k, orders, n, 4) value and derivatives at times (k,); jerk and snap are 0 where only one sample is known.

        Raises ValueError when there is no sample.
        """
        if self.newest_s == -np.inf:
            raise ValueError("no reference has arrived")
        result = np.empty((len(times_s), self._orders) + self._polynomial.shape[1:])
        _evaluate(self._polynomial, np.asarray(times_s, dtype=float), self._middle_s, self._scale_s, result)
        return result

    def _fit_polynomial(self):
        """`_polynomial` (size, n, 4): coefficients, lowest power first, over (time - _middle_s) / _scale_s.

        The samples are at -1/2 to 1/2, which conditions the fit well.
        """
        newest_s, newest = self._samples[-1]
        nodes = self._nodes()
        spacing_s = newest_s - nodes[-1][0]
        self._middle_s, self._scale_s = newest_s - 0.5 * spacing_s, spacing_s or 1.0
        if len(nodes) == 1:
            self._polynomial = newest / _FACTORIALS[: len(newest), None, None]
            return
        since_s = [stamp_s - newest_s for stamp_s, _ in nodes]
        if len(since_s) != len(self._spacing_s) or math.dist(since_s, self._spacing_s) > _SAME_S:
            self._spacing_s, self._fit = since_s, _fit_of(tuple(since_s))
        data = np.concatenate([sample for _, sample in nodes]).reshape(len(nodes) * _LEGACY_ORDERS, -1)
        self._polynomial = self._fit.dot(data).reshape((-1,) + newest.shape[1:])  # faster than @ for small arrays

    def _nodes(self):
        """Up to three samples about _NODE_SPACING_S apart, the newest first."""
        newest_s, newest = self._samples[-1]
        span_s = newest_s - self._samples[0][0]
        nodes = [self._samples[-1]]
        if span_s < _MIN_SPAN_S or len(newest) > _LEGACY_ORDERS:
            return nodes
        wanted = _NODES if span_s >= _SHORT_SPAN_S else 2
        spacing_s = min(_NODE_SPACING_S, span_s / (wanted - 1))
        end = len(self._samples) - 1
        while end > 0 and len(nodes) < wanted:
            end = bisect(self._samples, newest_s - len(nodes) * spacing_s + 1e-6, hi=end, key=itemgetter(0)) - 1
            if end >= 0:
                nodes.append(self._samples[end])
        return nodes


_FACTORIALS = np.array([math.factorial(d) for d in range(171)], dtype=float)  # all that fit in a float


@functools.lru_cache(maxsize=256)  # spacings hardly change in flight, and are the same in the next
def _fit_of(since_s):
    """(size, k * 3): from the values and derivatives of k samples to the coefficients of the polynomial through them.

    since_s: times of the samples since the newest one, which is the first.
    """
    spacing_s = -since_s[-1]
    C = _conditions((np.array(since_s) + 0.5 * spacing_s) / spacing_s, _DEGREES[len(since_s)] + 1)
    scales = spacing_s ** np.arange(_LEGACY_ORDERS)
    return np.linalg.solve(C.T @ C, C.T) * np.tile(scales, len(since_s))


def _conditions(times, size):
    """(len(times) * 3, size): rows of value and derivatives of 1, t, t^2, ... at each of the times."""
    powers = np.arange(size)
    rows = [
        [_FACTORIALS[powers] / _FACTORIALS[np.maximum(powers - d, 0)] * (powers >= d) * t ** np.maximum(powers - d, 0)]
        for t in times
        for d in range(_LEGACY_ORDERS)
    ]
    return np.concatenate(rows)


@compiled
def _find_finite(sample, known):
    """Fill known (n,): all numbers of the vehicle are finite. Return whether any vehicle's are."""
    anyone = False
    for i in range(len(known)):
        known[i] = math.isfinite(sample[:, i].sum())
        anyone |= known[i]
    return anyone


@compiled
def _continues(step_s, before, sample):
    """True if a sample follows from the one before by a step of one smooth path. Unwraps its yaw to that one's turn.

    A vehicle that is not finite in both samples is left out.
    """
    most, smooth = _TOLERANCE_1_S * step_s, step_s <= _KEEP_S
    for i in range(sample.shape[1]):
        if not math.isfinite(sample[:, i].sum() + before[:, i].sum()):
            continue
        turned = sample[0, i, Axis.PSI] - before[0, i, Axis.PSI]
        sample[0, i, Axis.PSI] -= 2.0 * np.pi * np.rint(turned / (2.0 * np.pi))
        for axis in range(sample.shape[2]):
            p_0, v_0, a_0 = before[0, i, axis], before[1, i, axis], before[2, i, axis]
            p_1, v_1, a_1 = sample[0, i, axis], sample[1, i, axis], sample[2, i, axis]
            # Hermite's rule for the position and the trapezoid for the velocity, both on the numbers of one step
            velocity_error = v_1 - v_0 - 0.5 * step_s * (a_1 + a_0)
            position_error = p_1 - p_0 - 0.5 * step_s * (v_1 + v_0) + step_s * step_s / 12.0 * (a_1 - a_0)
            smooth &= abs(velocity_error) < most and abs(position_error) < most  # not so for NaN
    return smooth


@compiled
def _evaluate(polynomial, times_s, middle_s, scale_s, result):
    """Fill the result (k, orders, n, 4): a polynomial (size, n, 4) of (time - middle_s) / scale_s, and its derivatives
    by time.
    """
    size = len(polynomial)
    for k in range(len(times_s)):
        t = (times_s[k] - middle_s) / scale_s
        for d in range(result.shape[1]):
            result[k, d] = 0.0
            for p in range(size - 1, d - 1, -1):  # Horner's rule; t^p has the derivative d p! / (p - d)! t^(p - d)
                factor = 1.0
                for q in range(p - d + 1, p + 1):
                    factor *= q / scale_s
                for i in range(result.shape[2]):
                    for axis in range(result.shape[3]):
                        result[k, d, i, axis] = result[k, d, i, axis] * t + factor * polynomial[p, i, axis]
