"""How old a message is when the clock that stamped it is not ours."""

import math


class MessageAges:
    """Ages by stamp, corrected if our clock is behind.

    No message is received before it was sent: an age below zero is a difference of the clocks, and without
    correction every later message would seem that much younger than it is. A clock that is ahead makes messages
    older than they are, which is on the safe side and looks like a slow network, so it stays.
    """

    def __init__(self, memory_s=10.0):
        """memory_s: how long the least age seen counts [s], up to twice that; clocks drift, and may be set."""
        self._memory_s = memory_s
        self._period_s = -math.inf  # when the present period began: the least age counts for one to two periods
        self._least_s = self._before_s = 0.0
        # By how much our clock is behind that of the stamps, at least [s]; 0 when nothing shows that it is.
        self.behind_s = 0.0

    def corrected(self, age_s, now_s):
        """Least possible age [s] of a message when it arrived.

        age_s: its arrival by our clock less its stamp by the sender's [s]. now_s: of our monotonic clock.
        """
        if now_s - self._period_s >= self._memory_s:
            self._period_s, self._before_s, self._least_s = now_s, self._least_s, 0.0
            self.behind_s = -self._before_s
        if age_s < self._least_s:
            self._least_s = age_s
            self.behind_s = -min(age_s, self._before_s)
        return age_s + self.behind_s
