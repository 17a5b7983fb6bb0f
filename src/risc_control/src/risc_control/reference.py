"""Reference at any time near now, with jerk and snap, from samples of position, velocity and acceleration.

/trajectory carries no jerk and no snap, and only the present; a controller that looks ahead over the command delay
needs both. A polynomial of degree 5, fitted to three samples and their derivatives (nine conditions), extrapolates
0.14 s of the courses to a micrometre and 0.34 s to 0.02 mm, and stamps that are a microsecond beside the time a sample
was computed for cost no more than that. (The exact fit of degree 8 would amplify such a microsecond to metres.)
"""

from collections import deque

import numpy as np

ORDERS = 5  # position, velocity, acceleration, jerk, snap
_NODES = 3
_DEGREE = 5
_NODE_SPACING_S = 0.1
_KEEP_S = (_NODES - 1) * _NODE_SPACING_S + 0.02
_SHORT_SPAN_S = 0.1  # less than this is too short for a degree of 5: two samples and a constant jerk,
_SHORT_DEGREE = 3
NEW_CLOCK_S = 1.0
_MIN_SPAN_S = 0.02  # and less than this even for that: the newest sample alone
# A step between two samples of one smooth path obeys the trapezoidal rule to the sixth decimal. A jump, a stamp that
# is not the time the sample was computed for, or an acceleration that is not the velocity's derivative does not.
_TOLERANCE_1_S = 0.02  # [m/s, m/s^2] error of position and of velocity per second of step
_DERIVATIVE = np.array([[np.prod(np.arange(p, p - d, -1.0)) for p in range(_DEGREE + 1)] for d in range(ORDERS)])


class ReferenceBuffer:
    """Samples of the references of a fixed set of vehicles, all with the same stamps.

    Axes: the last one is (x, y, z, psi): metres in any fixed frame, and radians.
    """

    def __init__(self):
        self._samples = deque()  # (stamp [s], (3, n, 4) value, first and second derivative)

    def clear(self):
        """Forget all samples."""
        self._samples.clear()

    @property
    def newest_s(self):
        """Stamp of the newest sample, -inf when there is none."""
        return self._samples[-1][0] if self._samples else -np.inf

    def push(self, stamp_s, sample):
        """Add a sample (3, n, 4). A jump, another set of vehicles or a new clock forgets what was before.

        Returns False, and changes nothing, for a stamp that is not newer or a number that is not finite. A stamp that
        falls back by more than NEW_CLOCK_S is newer: a bag was started again, or the clock was set.
        """
        if stamp_s < self.newest_s - NEW_CLOCK_S and np.isfinite(sample).all():
            self._samples.clear()
        if not stamp_s > self.newest_s or not np.isfinite(sample).all():
            return False
        if self._samples:
            before_s, before = self._samples[-1]
            sample = sample.copy()
            if sample.shape == before.shape:
                turned = sample[0, :, 3] - before[0, :, 3]
                sample[0, :, 3] -= 2.0 * np.pi * np.rint(turned / (2.0 * np.pi))
            if not self._continues(stamp_s - before_s, before, sample):
                self._samples.clear()
        self._samples.append((stamp_s, sample))
        while stamp_s - self._samples[0][0] > _KEEP_S:
            self._samples.popleft()
        return True

    @staticmethod
    def _continues(step_s, before, sample):
        if sample.shape != before.shape or step_s > _KEEP_S:
            return False
        # Hermite's rule for the position and the trapezoid for the velocity, both on the numbers of one step
        velocity_error = sample[1] - before[1] - 0.5 * step_s * (sample[2] + before[2])
        position_error = sample[0] - before[0] - 0.5 * step_s * (sample[1] + before[1])
        position_error += step_s * step_s / 12.0 * (sample[2] - before[2])
        worst = max(np.abs(velocity_error).max(), np.abs(position_error).max())
        return worst < _TOLERANCE_1_S * step_s

    def at(self, times_s):
        """(k, ORDERS, n, 4) value and derivatives at times (k,); jerk and snap are 0 where only one sample is known.

        Raises ValueError when there is no sample.
        """
        if not self._samples:
            raise ValueError("no reference has arrived")
        nodes = self._nodes()
        newest_s, newest = nodes[-1]
        times = np.asarray(times_s) - newest_s
        shape = (len(times), ORDERS) + newest.shape[1:]
        if len(nodes) == 1:
            result = np.zeros(shape)
            t = times[:, None, None]
            result[:, 0] = newest[0] + t * (newest[1] + 0.5 * t * newest[2])
            result[:, 1] = newest[1] + t * newest[2]
            result[:, 2] = newest[2]
            return result
        scale_s = newest_s - nodes[0][0]
        derivative = _DERIVATIVE[:, : (_DEGREE if len(nodes) == _NODES else _SHORT_DEGREE) + 1]
        size = derivative.shape[1]
        conditions = _basis(np.array([(stamp - newest_s) / scale_s for stamp, _ in nodes]), 3, derivative)
        conditions = conditions.reshape(-1, size)
        wanted = _basis(times / scale_s, ORDERS, derivative).reshape(-1, size)
        data = np.array([sample for _, sample in nodes]) * _scales(scale_s, 3)  # (nodes, 3, n, 4)
        fit = np.linalg.solve(conditions.T @ conditions, conditions.T @ data.reshape(len(conditions), -1))
        return (wanted @ fit).reshape(shape) / _scales(scale_s, ORDERS)

    def _nodes(self):
        """Up to three samples about _NODE_SPACING_S apart, oldest first, the newest last."""
        samples = self._samples
        newest_s = samples[-1][0]
        span_s = newest_s - samples[0][0]
        if span_s < _MIN_SPAN_S:
            return [samples[-1]]
        count = _NODES if span_s >= _SHORT_SPAN_S else 2
        spacing_s = min(_NODE_SPACING_S, span_s / (count - 1))
        nodes, wanted_s = [samples[-1]], newest_s - spacing_s
        for i in range(len(samples) - 2, -1, -1):
            if samples[i][0] <= wanted_s + 1e-6:
                nodes.append(samples[i])
                if len(nodes) == count:
                    break
                wanted_s -= spacing_s
        return nodes[::-1]


def _basis(times, orders, derivative):
    """(k, orders, size): the d-th derivatives of the monomials at scaled times."""
    size = derivative.shape[1]
    powers = times[:, None] ** np.arange(size)
    result = np.zeros((len(times), orders, size))
    for d in range(orders):
        result[:, d, d:] = derivative[d, d:] * powers[:, : size - d]
    return result


def _scales(scale_s, orders):
    return (scale_s ** np.arange(orders))[:, None, None]
