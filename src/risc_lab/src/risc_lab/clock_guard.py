"""The common rule for streams of stamps when a clock is set or a bag is played again. No ROS."""

import enum
import math
import sys
from bisect import bisect
from collections import deque
from itertools import pairwise
from statistics import median

AGREEING = 3  # stamps in a row that agree with each other make a new clock
LATE_S = 0.2  # a stamp that is behind by more is not late but of another clock
_REMEMBERED = 64  # stamps: 0.3 s at 200 Hz
_APART = 0.75  # of the usual step: late stamps are at least this far from those seen; another clock's come nearer


class Step(enum.IntEnum):
    """How a stamp continues its stream. Only `REFUSED` is false."""

    REFUSED = 0  # it does not advance, or is not a number: to be ignored
    ADVANCES = 1
    NEW_CLOCK = 2  # it advances on a new clock: earlier times mean nothing now


_REFUSED, _ADVANCES, _NEW_CLOCK = Step  # the members of an enumeration are slow to look up


class ClockGuard:
    """Tells the stamps of one stream that advance from those that do not, and notices when their clock was set.

    One stamp that falls back, or that is far ahead, may be late or corrupt: it is refused. `AGREEING` of them in a row,
    each a step ahead of the one before, mean that a clock was set or a bag restarted: the last of them is accepted, and
    those that follow it. Until then stamps of the old clock are still accepted.

    Stamps that a delay explains do not count towards a new clock, however many: each is up to `LATE_S` old and fills a
    gap between the stamps seen. A clock that was set back repeats times of which stamps were seen.
    """

    def __init__(self, longest_step_s=10.0):
        """longest_step_s: a larger step ahead is not a pause but a jump [s]; infinite for streams that may pause."""
        if not longest_step_s > 0.0:
            raise ValueError("the longest step must be > 0 s, got %r" % (longest_step_s,))
        self._longest_step_s = min(longest_step_s, sys.float_info.max)
        self.forget()

    def forget(self):
        """Start over: the next stamp is the first."""
        self.newest_s = -math.inf  # newest stamp that was accepted [s]
        self._jumped_s = -math.inf  # newest of those refused in a row
        self._agreeing = 0
        self._seen_s = deque(maxlen=_REMEMBERED)  # stamps of this clock, late ones as well

    def look(self, stamp_s):
        """`Step` of a stamp [s] of any clock."""
        step_s = stamp_s - self.newest_s
        if 0.0 < step_s <= self._longest_step_s:
            return self._accept(stamp_s, _ADVANCES)
        if step_s == 0.0 or not math.isfinite(stamp_s):
            return _REFUSED
        if self.newest_s == -math.inf:  # the first
            return self._accept(stamp_s, _ADVANCES)
        jumped_s, self._jumped_s = stamp_s - self._jumped_s, stamp_s
        if jumped_s == 0.0:
            return _REFUSED
        if self._is_late(stamp_s):
            self._seen_s.append(stamp_s)
            return _REFUSED
        follows = self._agreeing > 0 and 0.0 < jumped_s <= self._longest_step_s
        self._agreeing = self._agreeing + 1 if follows else 1
        if self._agreeing < AGREEING:
            return _REFUSED
        self._seen_s.clear()
        return self._accept(stamp_s, _NEW_CLOCK)

    def _accept(self, stamp_s, step):
        self._seen_s.append(stamp_s)
        self.newest_s, self._agreeing = stamp_s, 0
        return step

    def _is_late(self, stamp_s):
        """Whether a stamp that falls back fills a gap."""
        seen_s = sorted(self._seen_s)
        after = bisect(seen_s, stamp_s)
        if not 0 < after < len(seen_s) or self.newest_s - stamp_s > LATE_S:
            return False
        apart_s = min(stamp_s - seen_s[after - 1], seen_s[after] - stamp_s)
        return apart_s >= _APART * median(after_s - before_s for before_s, after_s in pairwise(seen_s))
