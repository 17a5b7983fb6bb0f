"""Sliding-window polynomial least squares on real time stamps (thesis eqs 4.1-4.2).

A polynomial of a chosen order is fitted to the newest samples of every channel and read off at the newest
sample: its value (a smoothed signal) and its slope (the rate). Order 1 over 50 samples at 200 Hz is the
thesis' estimator, delayed by half its window; order 2 has no such delay.

Noise. The estimates are linear in the samples, so white noise of standard deviation sigma gives

    std(estimate) = sigma * ||w||,      w the weights of `endpoint_weights`,

which for the slope of a line through N samples dt apart is  sigma * sqrt(12 / (N (N^2 - 1))) / dt,  and for
the slope of a parabola at its newest sample about four times that. The line's slope lags by (N - 1) dt / 2.
"""

import math

import numpy as np

MAX_ORDER = 4
_HANKEL = [np.add.outer(np.arange(order + 1), np.arange(order + 1)) for order in range(MAX_ORDER + 1)]


def endpoint_weights(ages_s, orders, present=None, scale_s=None):
    """Weights that turn samples into the fitted polynomial's value and slope at age zero.

    ages_s: (n,) age of each sample [s], >= 0, age 0 being the moment to evaluate at.
    orders: polynomial order 0..4, an int; or, together with `present`, a (bodies,) int array.
    present: None (every sample counts, one set of weights), or (n, bodies) bool: which samples each body has.
    scale_s: time that the ages are divided by for conditioning; default the largest age.
    Returns (2, n), or (bodies, 2, n) with `present`: row 0 the value [unit], row 1 the slope [unit/s].
    Raises ValueError if there are not order + 1 distinct samples.
    Deviation from eq 4.1: times count from the newest sample and are scaled; the estimate is unchanged.
    """
    ages_s = np.asarray(ages_s, dtype=float)
    if scale_s is None:
        scale_s = float(ages_s.max()) if ages_s.size and ages_s.max() > 0.0 else 1.0
    highest = orders if present is None else int(orders.max())
    u = ages_s * (-1.0 / scale_s)
    powers = np.ones((2 * highest + 1, u.size))
    for k in range(1, 2 * highest + 1):
        np.multiply(powers[k - 1], u, out=powers[k])
    basis = powers[: highest + 1]
    hankel = _HANKEL[highest]
    selector = np.zeros((highest + 1, 2))  # the value is coefficient 0, the slope coefficient 1
    selector[0, 0] = 1.0
    if highest > 0:
        selector[1, 1] = 1.0 / scale_s
    try:
        if present is None:
            return np.linalg.solve(powers.sum(axis=1)[hankel], selector).T @ basis
        moments = (powers @ present).T  # (bodies, 2 * highest + 1)
        gram = moments[:, hankel]
        rhs = np.repeat(selector[None], moments.shape[0], axis=0)
        unused = np.arange(highest + 1)[None, :] > np.asarray(orders)[:, None]
        if unused.any():  # lower order for this body: pin the higher coefficients to 0
            gram[unused[:, :, None] | unused[:, None, :]] = 0.0
            body, k = np.nonzero(unused)
            gram[body, k, k] = 1.0
            rhs[body, k] = 0.0
        return (np.linalg.solve(gram, rhs).transpose(0, 2, 1) @ basis) * present.T[:, None, :]
    except np.linalg.LinAlgError as error:
        raise ValueError(
            "a polynomial of order %s needs order + 1 samples at distinct times, got %d samples"
            % (highest, ages_s.size)
        ) from error


def slope_noise_gain(samples, spacing_s, order=1):
    """Standard deviation of the slope at the newest sample per unit of sample noise [1/s].

    Equals sqrt(12 / (N (N^2 - 1))) / spacing_s for order 1 and N = samples.
    """
    weights = endpoint_weights(np.arange(samples - 1, -1, -1) * spacing_s, order)
    return float(np.linalg.norm(weights[1]))


class SlidingFit(object):
    """Value and slope of many channels of many bodies, all sampled by the same frames.

    A body may miss a frame (its other samples still count, at their own times); after more than `max_gap_s`
    without a sample its window starts afresh, so that no estimate ever spans a gap. While a body's window is
    shorter than `ramp` of the full one, a line is fitted instead of a higher order: a parabola through a
    short window amplifies noise too much.
    """

    # Weights are reused while the stamps sit this well on the pattern that the weights were made for. At 1 m/s the
    # velocity is off by 0.4 mm/s then (parabola, 50 samples at 200 Hz): a twentieth of the noise of 2 mm markers.
    UNIFORM_TOLERANCE_S = 50e-6

    def __init__(self, window_s, order, channels, max_gap_s, max_rate_hz=500.0, ramp=0.6):
        """window_s [s], order 1..4, channels per body, max_gap_s [s], max_rate_hz: highest frame rate [Hz]."""
        if not 1 <= order <= MAX_ORDER:
            raise ValueError("order must be 1 to %d, got %r" % (MAX_ORDER, order))
        if not (window_s > 0.0 and max_gap_s > 0.0 and max_rate_hz > 0.0):
            raise ValueError(
                "window_s, max_gap_s and max_rate_hz must be positive, got %r, %r, %r"
                % (window_s, max_gap_s, max_rate_hz)
            )
        self.window_s = float(window_s)
        self.order = int(order)
        self._channels = int(channels)
        self._max_gap_s = float(max_gap_s)
        self._ramp_s = float(ramp) * self.window_s
        self._capacity = int(math.ceil(window_s * max_rate_hz)) + 1
        slots = 8 * self._capacity  # the window slides through the buffer and is moved back when it ends
        self._stamps_s = np.zeros(slots)
        self._values = np.zeros((slots, 0, self._channels))
        self._present = np.zeros((slots, 0), dtype=bool)
        self._last_s = np.zeros(0)
        self._gapless = np.zeros(0, dtype=int)  # [samples] each body's run of consecutive frames, newest last
        self._end = 0
        self._weights = None
        self._weights_ages_s = None

    @property
    def bodies(self):
        """How many bodies there are."""
        return self._present.shape[1]

    def add_body(self):
        """Add one body without samples; returns its index."""
        slots = self._stamps_s.size
        self._values = np.concatenate([self._values, np.zeros((slots, 1, self._channels))], axis=1)
        self._present = np.concatenate([self._present, np.zeros((slots, 1), dtype=bool)], axis=1)
        self._last_s = np.append(self._last_s, -np.inf)
        self._gapless = np.append(self._gapless, 0)
        return self.bodies - 1

    def reset(self):
        """Forget every sample."""
        self._present[:] = False
        self._last_s[:] = -np.inf
        self._gapless[:] = 0
        self._end = 0

    def gapped(self, stamp_s):
        """(bodies,) bool: whose window a sample at stamp_s [s] would start afresh (too old or empty)."""
        return stamp_s - self._last_s > self._max_gap_s

    def push(self, stamp_s, values, present=None):
        """Add one frame at stamp_s [s], later than the frame before.

        values: (bodies, channels) [unit]; rows of absent bodies are ignored and may be NaN.
        present: (bodies,) bool, None = all. Raises ValueError if time does not advance.
        """
        end = self._end
        if end and stamp_s <= self._stamps_s[end - 1]:
            raise ValueError("stamps must increase, got %r after %r" % (stamp_s, self._stamps_s[end - 1]))
        if end == self._stamps_s.size:
            keep = self._capacity - 1
            for buffer in (self._stamps_s, self._values, self._present):
                buffer[:keep] = buffer[end - keep : end]
            end = keep
        gapped = self.gapped(stamp_s)
        if present is None:
            self._values[end] = values
            self._present[end] = True
        else:
            self._values[end] = np.where(present[:, None], values, 0.0)
            self._present[end] = present
            gapped &= present
        if gapped.any():
            self._present[:end, gapped] = False
            self._gapless[gapped] = 0
        if present is None:
            self._gapless += 1
            self._last_s[:] = stamp_s
        else:
            self._gapless = np.where(present, self._gapless + 1, 0)
            self._last_s[present] = stamp_s
        self._stamps_s[end] = stamp_s
        self._end = end + 1

    def estimate(self, bodies=None):
        """Fit all, or the given, bodies at the newest frame. Each must have a sample in that frame.

        bodies: index array or None. Returns value (bodies, channels) [unit], slope (bodies, channels) [unit/s]
        (zero from a single sample), samples (bodies,) used and span_s (bodies,) from oldest to newest used.
        Raises ValueError if there is no frame, or a body has no sample in the newest one.
        """
        end = self._end
        if end == 0:
            raise ValueError("no frame to estimate from: push one first")
        newest_s = self._stamps_s[end - 1]
        start = max(0, end - self._capacity)
        # Half a frame of slack, or jitter would have the sample at the window's edge come and go.
        frame_s = newest_s - self._stamps_s[end - 2] if end - start > 1 else 0.0
        slack_s = min(0.5 * frame_s, 0.25 * self.window_s)
        start += int(np.searchsorted(self._stamps_s[start:end], newest_s - self.window_s + slack_s))
        ages_s = newest_s - self._stamps_s[start:end]
        n = end - start
        values = self._values[start:end]
        gapless = self._gapless
        if bodies is not None:
            values = values[:, bodies]
            gapless = gapless[bodies]
        if gapless.size == 0:
            empty = np.zeros((0, self._channels))
            return empty, empty, np.zeros(0, dtype=int), np.zeros(0)
        fewest = gapless.min()
        if fewest == 0:
            raise ValueError("a body without a sample in the newest frame cannot be estimated there")
        if fewest >= n:
            estimates = self._shared_weights(ages_s) @ values.reshape(n, -1)
            estimates = estimates.reshape(2, gapless.size, self._channels)
            return (estimates[0], estimates[1], np.full(gapless.size, n), np.full(gapless.size, ages_s[0]))
        present = self._present[start:end]
        if bodies is not None:
            present = present[:, bodies]
        samples = present.sum(axis=0)
        spans_s = ages_s[present.argmax(axis=0)]
        orders = np.minimum(np.where(spans_s >= self._ramp_s, self.order, 1), samples - 1)
        weights = endpoint_weights(ages_s, orders, present, self.window_s)
        estimates = weights @ values.transpose(1, 0, 2)
        return estimates[:, 0], estimates[:, 1], samples, spans_s

    def _shared_weights(self, ages_s):
        """(2, n) weights for bodies that have every sample; remade only when the pattern of stamps changes."""
        known = self._weights_ages_s
        if known is None or known.size != ages_s.size or np.abs(ages_s - known).max() > self.UNIFORM_TOLERANCE_S:
            order = min(self.order if ages_s[0] >= self._ramp_s else 1, ages_s.size - 1)
            self._weights = endpoint_weights(ages_s, order, scale_s=self.window_s)
            self._weights_ages_s = ages_s
        return self._weights
