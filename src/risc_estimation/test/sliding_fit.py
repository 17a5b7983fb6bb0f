"""One window of `risc_estimation.least_squares`, and its weights, for tests: called with numpy arrays."""

import numpy as np

from risc_estimation.least_squares import FIT, Window, Windows, _weigh, estimate_newest, push_samples


class SlidingFit(Windows):
    def __init__(self, window_s, order, channels, max_gap_s, **more):
        super().__init__([(window_s, order)], channels, max_gap_s, **more)

    @property
    def window(self):
        return Window(*(array[0] for array in self.arrays))

    def push(self, stamp_s, values, present=None):
        present = np.ones(len(self.window.bodies), dtype=bool) if present is None else present
        push_samples(self.window, float(stamp_s), np.array(values, dtype=float), present, np.zeros_like(present))

    def estimate(self, bodies=None):
        """Value and slope (bodies, channels), samples (bodies,) used, span_s (bodies,) of all or given bodies."""
        window = self.window
        bodies = np.arange(len(window.bodies)) if bodies is None else bodies
        wanted = np.zeros(len(window.bodies), dtype=bool)
        wanted[bodies] = True
        estimate_newest(window, wanted)
        found = window.estimates[bodies]
        return found[:, 0], found[:, 1], window.bodies["samples"][bodies], window.bodies["span_s"][bodies]


def endpoint_weights(ages_s, order):
    """(2, n) weights of samples for value and slope at age zero, the last sample."""
    ages_s, weights = np.array(ages_s, dtype=float), np.zeros((2, len(ages_s)))
    fit = np.zeros(1, dtype=FIT)[0]
    fit["window_s"], fit["order"] = float(ages_s.max()) or 1.0, order
    _weigh(fit, -ages_s, np.ones(len(ages_s), dtype=bool), weights)
    return weights


def slope_noise_gain(samples, spacing_s, order=1):
    """Standard deviation of the slope at the newest sample per unit of sample noise [1/s]."""
    return np.linalg.norm(endpoint_weights(np.arange(samples - 1, -1, -1) * spacing_s, order)[1])
