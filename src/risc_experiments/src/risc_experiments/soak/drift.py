"""Detects whether a figure grows: robust slopes of time series in bounded memory."""

from typing import NamedTuple

import numpy as np
from scipy import stats

from data_extraction.samples import Samples

CONFIDENCE = 0.95
MOST_SAMPLES = 400  # of a series: a slope is the median of all pairs
LEAST_SAMPLES = 8  # with fewer there is no slope
_LAST = 5  # samples whose median is the newest value
_HOUR_S = 3600.0


class Drift(NamedTuple):
    """How a figure changes. Slopes are per hour; None: too little is known."""

    first: float | None  # median during the warm-up; without a warm-up, of the first samples
    last: float | None  # median of the newest samples
    slope: float | None  # Theil-Sen slope since the warm-up
    low: float | None  # ends of its 95 % interval
    high: float | None
    judged_s: float  # time that the slope covers

    def exceeds(self, most_per_hour, least):
        """Whether the lower end of the slope is above most_per_hour, and amounts to more than least in judged_s."""
        return self.low is not None and self.low > most_per_hour and self.low * self.judged_s / _HOUR_S > least


UNKNOWN = Drift(None, None, None, None, None, 0.0)


class Track:
    """Figures of one thing over time: at most `MOST_SAMPLES` rows, evenly spread over all that were added."""

    def __init__(self, *names):
        self._names = names
        self._samples = Samples(1 + len(names), MOST_SAMPLES)

    def __len__(self):
        return len(self._samples)

    def add(self, time_s, *values):
        """One row; times increase."""
        self._samples.append((time_s, *values))

    def drift(self, name, warm_s):
        """Drift of a figure, which counts from warm_s on."""
        table = self._samples.table()
        return drift(table[:, 0], table[:, 1 + self._names.index(name)], warm_s)


def drift(times_s, values, warm_s):
    """Drift of values (n,) at times (n,), increasing. Non-finite values are left out."""
    known = np.isfinite(values)
    times_s, values = times_s[known], values[known]
    if not len(values):
        return UNKNOWN
    judged = times_s >= warm_s
    before = values[~judged] if not judged.all() else values[:_LAST]
    first, last = float(np.median(before)), float(np.median(values[-_LAST:]))
    if judged.sum() < LEAST_SAMPLES:
        return UNKNOWN._replace(first=first, last=last)
    judged_s = times_s[judged]
    slope, _, low, high = stats.theilslopes(values[judged], judged_s / _HOUR_S, CONFIDENCE)
    return Drift(first, last, float(slope), float(low), float(high), float(judged_s[-1] - judged_s[0]))
