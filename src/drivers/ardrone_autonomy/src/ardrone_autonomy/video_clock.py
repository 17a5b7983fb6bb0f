"""Exposure time of a picture on our clock, from the aircraft's millisecond clock. Pure: no clock of its own.

A picture is received some time after its exposure, because of encoding, radio and TCP. This delay has a minimum (the
latency) and is sometimes much larger, when the radio stalls and several pictures arrive at once.  The header carries
the time of the aircraft, so per picture

    offset = received - aircraft's time = difference of the clocks + latency + (time that the picture was held up, >= 0)

and the least offset belongs to the pictures that were not held up.  With it,

    exposure = aircraft's time + least offset - latency

has the jitter of the aircraft's clock (1 ms) instead of the network's.  The least offset rises by MAX_DRIFT per second,
so that it can follow an aircraft whose clock is slower than ours; a faster one lowers it by itself.

The latency cannot be measured here.  Without it (0) the result is the time at which the picture would have been
received if nothing had held it up; with it, the time of exposure.
"""

MAX_DRIFT = 3e-4  # [s/s] crystals stay well below
HELD_UP_S = 0.05  # a picture whose offset is further above the least offset does not support it
# After this long without support the aircraft's clock was set back or stopped. That is rare; a network or computer that
# is too busy for seconds is common, and must not shift the stamps.
PATIENCE_S = 30.0
LEAST_STEP_S = 1e-3  # between two results: the resolution of the aircraft's clock

_WRAP_MS = 1 << 32


class ExposureClock:
    """Estimates exposure times. Must be fed every picture that arrives, including those that are not shown.

    latency_s: from exposure to reception when nothing holds the picture up [s], >= 0.
    """

    def __init__(self, latency_s=0.0):
        self.restarts = 0  # of the aircraft's clock
        self._latency_s = latency_s
        self._timestamp_ms = None  # of the last picture
        self._elapsed_ms = 0  # aircraft's time since the first picture, without wrap
        self._last_received_s = 0.0
        self._offset_s = 0.0  # the least offset
        self._unsupported = None  # (since when, least offset since then)
        self._last_s = float("-inf")  # newest result

    def exposure_s(self, timestamp_ms, received_s):
        """Return the time of exposure on the clock of received_s, at most received_s - latency_s.

        timestamp_ms: of the PaVE header, wraps at 2**32.  received_s: monotonic, not decreasing.  The results
        increase from picture to picture, unless the pictures arrive in less than LEAST_STEP_S.
        """
        step_ms = 0 if self._timestamp_ms is None else (timestamp_ms - self._timestamp_ms) % _WRAP_MS
        if 0 < step_ms < _WRAP_MS // 2:
            self._elapsed_ms += step_ms
            self._offset_s += MAX_DRIFT * (received_s - self._last_received_s)
        else:  # the first picture, or the aircraft's clock has restarted
            self.restarts += self._timestamp_ms is not None
            self._elapsed_ms, self._offset_s, self._unsupported = 0, received_s, None
        self._timestamp_ms, self._last_received_s = timestamp_ms, received_s
        offset_s = received_s - 1e-3 * self._elapsed_ms
        self._offset_s = min(self._offset_s, offset_s)
        self._check_support(offset_s, received_s)
        exposure_s = 1e-3 * self._elapsed_ms + self._offset_s
        self._last_s = min(max(exposure_s, self._last_s + LEAST_STEP_S), received_s)
        return self._last_s - self._latency_s

    def _check_support(self, offset_s, received_s):
        if offset_s - self._offset_s <= HELD_UP_S:
            self._unsupported = None
            return
        since_s, least_s = self._unsupported or (received_s, offset_s)
        self._unsupported = since_s, min(least_s, offset_s)
        if received_s - since_s > PATIENCE_S:
            self._offset_s = self._unsupported[1]
            self._unsupported = None
            self.restarts += 1
