"""Sliding-window polynomial least squares on real time stamps (thesis eqs 4.1-4.2).

A polynomial of a chosen order is fitted to the newest samples of every channel and read off at the newest
sample: its value (a smoothed signal) and its slope (the rate). Order 1 over 50 samples at 200 Hz is the
thesis' estimator, delayed by half its window; order 2 has no such delay.

Noise. The estimates are linear in the samples, so white noise of standard deviation sigma gives

    std(estimate) = sigma * ||w||,      w the weights of the samples,

which for the slope of a line through N samples dt apart is  sigma * sqrt(12 / (N (N^2 - 1))) / dt,  and for
the slope of a parabola at its newest sample about four times that. The line's slope lags by (N - 1) dt / 2.
"""

import math
from typing import NamedTuple

import numpy as np

from risc_lab.compiled import compiled, record, with_row

MAX_ORDER = 4
# Weights are reused while the stamps match the pattern that they were made for this closely. At 1 m/s the
# velocity is off by 0.4 mm/s then (parabola, 50 samples at 200 Hz): a twentieth of the noise of 2 mm markers.
UNIFORM_TOLERANCE_S = 50e-6
_DISTINCT = 1e-12  # a pivot below this part of its moment: the times of the samples are not distinct

FIT = record(
    ("window_s", float),
    ("ramp_s", float),  # a line is fitted to samples that span less
    ("max_gap_s", float),
    ("order", int),
    ("capacity", int),  # samples
    ("frames", int),  # pushed so far
    ("weighed", int),  # number of samples that the shared weights are for; 0 = none
    ("samples", int),  # of the fit,
    ("span_s", float),  # from the oldest to the newest of them
    ("moments", float, (2 * MAX_ORDER + 1,)),  # sums of the powers of the scaled times
    ("normal", float, (MAX_ORDER + 1, MAX_ORDER + 1)),  # the normal equations
    ("polynomials", float, (MAX_ORDER + 1, 2)),  # weight of a sample as polynomial in its time: for value, for slope
)
BODY = record(
    ("last_s", float),  # stamp of the newest sample
    ("gapless", int),  # [samples] run of consecutive frames, newest last
    ("samples", int),  # used in the last estimate
    ("span_s", float),  # from the oldest to the newest of them
)


class Window(NamedTuple):
    """Samples of all bodies and what was last estimated from them. Arrays of `Windows` have one more
    axis, the first: the windows.

    A ring of `capacity` samples. Each is held twice, `capacity` apart, so that the newest ones are one stretch.
    """

    fit: np.ndarray  # (1,) FIT
    bodies: np.ndarray  # (bodies,) BODY
    stamps_s: np.ndarray  # (2 capacity,)
    present: np.ndarray  # (bodies, 2 capacity) bool
    values: np.ndarray  # (bodies, 2 capacity, channels) [unit]
    # (5, capacity): ages [s] that the shared weights are for, shared weights for value and slope [1/s], the same two of
    # one body
    weights: np.ndarray
    estimates: np.ndarray  # (bodies, 2, channels) value [unit], slope [unit/s]


_OF_BODIES = ("bodies", "present", "values", "estimates")  # with an axis of bodies


class Windows:
    """Values and slopes of many channels of many bodies, all sampled by the same frames, through several windows.

    A body may miss a frame (its other samples still count, at their own times); after more than `max_gap_s`
    without a sample its window starts afresh, so that no estimate ever spans a gap. While a body's window is
    shorter than `ramp` of the full one, a line is fitted instead of a higher order: a parabola through a
    short window amplifies noise too much.

    `arrays` is what `push_samples` and `estimate_newest` work on, a window at a time: Window(*[a[k] for a in arrays]).
    """

    def __init__(self, kinds, channels, max_gap_s, max_rate_hz=500.0, ramp=0.6):
        """kinds: [(length [s], order 1..4), ...].   channels: per body.   max_rate_hz: highest frame rate [Hz]."""
        k, capacity = len(kinds), math.ceil(max(window_s for window_s, _ in kinds) * max_rate_hz) + 1
        fit = np.zeros((k, 1), dtype=FIT)
        fit["window_s"][:, 0], fit["order"][:, 0] = zip(*kinds)
        fit["ramp_s"], fit["max_gap_s"], fit["capacity"] = ramp * fit["window_s"], max_gap_s, capacity
        self.arrays = Window(
            fit,
            np.zeros((k, 0), dtype=BODY),
            np.zeros((k, 2 * capacity)),
            np.zeros((k, 0, 2 * capacity), dtype=bool),
            np.zeros((k, 0, 2 * capacity, channels)),
            np.zeros((k, 5, capacity)),
            np.zeros((k, 0, 2, channels)),
        )

    def add_body(self):
        """Add one body without samples, at the end."""
        grown = {name: with_row(getattr(self.arrays, name), axis=1) for name in _OF_BODIES}
        grown["bodies"]["last_s"][:, -1] = -np.inf
        self.arrays = self.arrays._replace(**grown)

    def reset(self):
        """Forget every sample."""
        self.arrays.fit["frames"] = 0
        self.arrays.bodies["last_s"] = -np.inf
        self.arrays.bodies["gapless"] = 0
        self.arrays.present[:] = False


@compiled
def push_samples(window, stamp_s, values, present, anew):
    """Add one frame at stamp_s [s], later than the frame before.

    values: (bodies, channels) [unit]; present: (bodies,) bool: the body has a sample, else its values are ignored;
    anew: (bodies,) bool: its window starts afresh with this frame.
    """
    fit = window.fit[0]
    slot = fit.frames % fit.capacity
    fit.frames += 1
    window.stamps_s[slot] = window.stamps_s[slot + fit.capacity] = stamp_s
    for i in range(len(present)):
        body, here = window.bodies[i], present[i]
        if not here:
            body.gapless = 0
        else:
            if anew[i] or stamp_s - body.last_s > fit.max_gap_s:
                window.present[i, :] = False
                body.gapless = 0
            body.gapless += 1
            body.last_s = stamp_s
        for k in (slot, slot + fit.capacity):
            window.present[i, k] = here
            for channel in range(values.shape[1]):
                window.values[i, k, channel] = values[i, channel] if here else 0.0


@compiled
def estimate_newest(window, wanted):
    """Fit the bodies that are wanted ((bodies,) bool) at the newest frame, in which each of them has a sample.

    Fills window.estimates, and samples and span_s of window.bodies. Bodies that have every sample of the window share
    their weights; when a wanted body misses any, each body gets weights of its own.
    """
    start, end = _newest_stretch(window)
    complete = wanted.any()  # without a body no weights are computed, so none may be recorded
    for i in range(len(wanted)):
        if wanted[i] and window.bodies[i].gapless < end - start:
            complete = False
    known = complete and _are_weighed(window, start, end)
    weights = window.weights[1:3] if complete else window.weights[3:5]
    for i in range(len(wanted)):
        if wanted[i]:
            if not known:
                _weigh(window.fit[0], window.stamps_s[start:end], window.present[i, start:end], weights)
                known = complete
            body = window.bodies[i]
            body.samples, body.span_s = window.fit[0].samples, window.fit[0].span_s
            for channel in range(window.values.shape[2]):
                value = slope = 0.0
                for k in range(end - start):
                    sample = window.values[i, start + k, channel]
                    value += weights[0, k] * sample
                    slope += weights[1, k] * sample
                window.estimates[i, 0, channel] = value
                window.estimates[i, 1, channel] = slope


@compiled
def _newest_stretch(window):
    """(start, end) of the window's samples in the ring."""
    fit = window.fit[0]
    stamps_s = window.stamps_s
    end = (fit.frames - 1) % fit.capacity + fit.capacity + 1
    held = min(fit.frames, fit.capacity)
    # Half a frame of slack, or jitter would have the sample at the window's edge come and go.
    frame_s = stamps_s[end - 1] - stamps_s[end - 2] if held > 1 else 0.0
    slack_s = min(0.5 * frame_s, 0.25 * fit.window_s)
    oldest_s = stamps_s[end - 1] - fit.window_s + slack_s
    start = end - 1
    while start > end - held and stamps_s[start - 1] >= oldest_s:
        start -= 1
    return start, end


@compiled
def _are_weighed(window, start, end):
    """Whether the shared weights are for this pattern of stamps; if not, records it: they are computed next."""
    fit = window.fit[0]
    samples, newest_s = end - start, window.stamps_s[end - 1]
    known = fit.weighed == samples
    for k in range(samples):
        if known and abs(newest_s - window.stamps_s[start + k] - window.weights[0, k]) > UNIFORM_TOLERANCE_S:
            known = False
    if not known:
        fit.weighed = samples
        for k in range(samples):
            window.weights[0, k] = newest_s - window.stamps_s[start + k]
    fit.samples, fit.span_s = samples, newest_s - window.stamps_s[start]
    return known


@compiled
def _weigh(fit, stamps_s, present, weights):
    """Weights that turn samples into the fitted polynomial's value and slope at the last stamp.

    stamps_s: (n,) [s], rising; present: (n,) bool: at which there is a sample, always at the last.   Fills weights
    (2, >= n): for the value, for the slope [1/s], 0 without sample; and samples and span_s of fit. The order is less
    than wanted where the span is short, or where there are too few distinct times.
    Deviation from eq 4.1: times count from the newest sample and are scaled; the estimate is unchanged.
    """
    newest_s = stamps_s[-1]
    fit.samples, fit.moments[:] = 0, 0.0
    for k in range(len(stamps_s)):
        if present[k]:
            if fit.samples == 0:
                fit.span_s = newest_s - stamps_s[k]
            fit.samples += 1
            u, power = (newest_s - stamps_s[k]) / -fit.window_s, 1.0
            for j in range(len(fit.moments)):
                fit.moments[j] += power
                power *= u
    order = min(fit.order if fit.span_s >= fit.ramp_s else 1, fit.samples - 1)
    while not _solve(fit, order):
        order -= 1
    for k in range(len(stamps_s)):
        value = slope = 0.0
        if present[k]:
            u = (newest_s - stamps_s[k]) / -fit.window_s
            for j in range(order, -1, -1):
                value = value * u + fit.polynomials[j, 0]
                slope = slope * u + fit.polynomials[j, 1]
        weights[0, k], weights[1, k] = value, slope


@compiled
def _solve(fit, order):
    """Polynomials whose values at the samples' times are the weights; False if the normal equations are singular.

    The value is coefficient 0 of the fitted polynomial, the slope coefficient 1 over the scale of time: rows 0 and 1 of
    the inverse of the normal equations. Gaussian elimination; the matrix is positive definite, so it needs no pivoting.
    """
    A, x = fit.normal, fit.polynomials
    for j in range(order + 1):
        for k in range(order + 1):
            A[j, k] = fit.moments[j + k]
        x[j, 0] = 1.0 if j == 0 else 0.0
        x[j, 1] = 1.0 / fit.window_s if j == 1 else 0.0
    for j in range(order + 1):
        if not A[j, j] > _DISTINCT * fit.moments[2 * j]:
            return False
        for i in range(j + 1, order + 1):
            factor = A[i, j] / A[j, j]
            for k in range(j, order + 1):
                A[i, k] -= factor * A[j, k]
            for side in range(2):
                x[i, side] -= factor * x[j, side]
    for j in range(order, -1, -1):
        for side in range(2):
            for k in range(j + 1, order + 1):
                x[j, side] -= A[j, k] * x[k, side]
            x[j, side] /= A[j, j]
    return True
