"""Exposure time of a picture on our clock, from the aircraft's millisecond clock. Pure: no clock of its own.

A picture is received some time after its exposure, because of encoding, radio and TCP. This delay has a minimum (the
latency) and is sometimes much larger, when the radio stalls and several pictures arrive at once.  The header carries
the time of the aircraft, so per picture

    offset = received - aircraft's time = difference of the clocks + latency + (time that the picture was held up, >= 0)

and the least offset belongs to the pictures that were not held up.  With it,

    exposure = aircraft's time + least offset - latency

has the jitter of the aircraft's clock (1 ms) instead of the network's.  The two clocks have not quite the same rate, so
the least offset is a line: of those that no picture's offset is below, and that rise or fall by at most MAX_DRIFT, the
one that is highest in the middle of the last WINDOW_S (the lower convex hull of the offsets, as in Zhang, Liu and Xia,
"Clock synchronization algorithms for network measurements", 2002).  Thus seconds in which every picture is held up move
no stamp.

The latency cannot be measured here.  Without it (0) the result is the time at which the picture would have been
received if nothing had held it up; with it, the time of exposure.
"""

import collections

import numpy as np

MAX_DRIFT = 3e-4  # [s/s] crystals stay well below
WINDOW_S = 60  # long enough for the clocks' rates to show
HELD_UP_S = 0.05  # a picture whose offset is further above the least offset does not support it
# After this long without support the aircraft's clock was set back or stopped. That is rare; a network or computer that
# is too busy for seconds is common, and must not shift the stamps.
PATIENCE_S = 30.0
LEAST_STEP_S = 1e-3  # between two results: the resolution of the aircraft's clock

_WRAP_MS = 1 << 32
_DRIFTS = np.array(sorted(np.linspace(-MAX_DRIFT, MAX_DRIFT, 121), key=abs))  # 0 first: it wins where all are as good


class ExposureClock:
    """Estimates exposure times. Must be fed every picture that arrives, including those that are not shown.

    latency_s: from exposure to reception when nothing holds the picture up [s], >= 0.
    """

    def __init__(self, latency_s=0.0):
        self.restarts = 0  # of the aircraft's clock
        self._latency_s = latency_s
        self._timestamp_ms = None  # of the last picture
        self._elapsed_ms = 0  # aircraft's time since the first picture, without wrap
        self._least = collections.deque(maxlen=WINDOW_S)  # (received, offset) [s], each the least of its second
        self._line = (0.0, 0.0, 0.0)  # of the least offset: middle [s], height there [s], drift
        self._unsupported_since_s = None
        self._last_s = float("-inf")  # newest result

    def exposure_s(self, timestamp_ms, received_s):
        """Return the time of exposure on the clock of received_s, at most received_s - latency_s.

        timestamp_ms: of the PaVE header, wraps at 2**32.  received_s: monotonic, not decreasing.  The results
        increase from picture to picture, unless the pictures arrive in less than LEAST_STEP_S.
        """
        step_ms = 0 if self._timestamp_ms is None else (timestamp_ms - self._timestamp_ms) % _WRAP_MS
        if 0 < step_ms < _WRAP_MS // 2:
            self._elapsed_ms += step_ms
        else:  # the first picture, or the aircraft's clock has restarted
            self.restarts += self._timestamp_ms is not None
            self._elapsed_ms, self._unsupported_since_s = 0, None
            self._least.clear()
        self._timestamp_ms = timestamp_ms
        offset_s = received_s - 1e-3 * self._elapsed_ms
        self._keep(received_s, offset_s)
        self._check_support(received_s, offset_s)
        exposure_s = 1e-3 * self._elapsed_ms + self._least_offset_s(received_s)
        self._last_s = min(max(exposure_s, self._last_s + LEAST_STEP_S), received_s)
        return self._last_s - self._latency_s

    def _keep(self, received_s, offset_s):
        """Keep the offset if it is the least of its second, and fit the line anew."""
        if self._least and offset_s < self._least_offset_s(received_s) - HELD_UP_S:
            self._least.clear()  # the aircraft's clock was set forward, or all pictures before were held up
        if self._least and int(self._least[-1][0]) == int(received_s):
            if self._least[-1][1] <= offset_s:
                return
            self._least.pop()
        self._least.append((received_s, offset_s))
        self._fit()

    def _fit(self):
        times_s, offsets_s = np.array(self._least).T
        middle_s = 0.5 * (times_s[0] + times_s[-1])
        heights_s = (offsets_s - np.outer(_DRIFTS, times_s - middle_s)).min(axis=1)
        best = np.argmax(heights_s)
        self._line = middle_s, heights_s[best], _DRIFTS[best]

    def _least_offset_s(self, now_s):
        middle_s, height_s, drift = self._line
        return float(height_s + drift * (now_s - middle_s))

    def _check_support(self, received_s, offset_s):
        if offset_s - self._least_offset_s(received_s) <= HELD_UP_S:
            self._unsupported_since_s = None
        elif self._unsupported_since_s is None:
            self._unsupported_since_s = received_s
        elif received_s - self._unsupported_since_s > PATIENCE_S:
            while self._least[0][0] < self._unsupported_since_s:
                self._least.popleft()
            self._fit()
            self._unsupported_since_s = None
            self.restarts += 1
