"""What happens to a stream of stamps when a clock is set, or a bag is played again: one rule for everybody. No ROS."""

import enum
import math
import sys

AGREEING = 3  # stamps in a row that agree with each other make a new clock


class Step(enum.IntEnum):
    """What a stamp is to its stream. Only `REFUSED` is false."""

    REFUSED = 0  # it does not advance, or is no number; as if it had not come
    ADVANCES = 1
    NEW_CLOCK = 2  # it advances on a new clock: what is known from before has times that mean nothing now


_REFUSED, _ADVANCES, _NEW_CLOCK = Step  # the members of an enumeration are slow to look up


class ClockGuard:
    """Tells the stamps of one stream that advance from those that do not, and notices when their clock was set.

    One stamp that falls back, or that is far ahead, may be a straggler or damage. It is refused. `AGREEING` of them in
    a row, each a step ahead of the one before, are a clock that was set or a bag that begins again: the last of them is
    accepted, and what follows it. Until then a stamp of the old clock goes on with that.
    """

    def __init__(self, longest_step_s=10.0):
        """longest_step_s: a larger step ahead is no silence but a jump [s]; infinite for streams that may pause."""
        if not longest_step_s > 0.0:
            raise ValueError("the longest step must be > 0 s, got %r" % (longest_step_s,))
        self._longest_step_s = min(longest_step_s, sys.float_info.max)
        self.forget()

    def forget(self):
        """The next stamp is the first."""
        self.newest_s = -math.inf  # newest stamp that was accepted [s]
        self._jumped_s = -math.inf  # newest of those in a row that were not
        self._agreeing = 0

    def look(self, stamp_s):
        """`Step` of a stamp [s] of any clock."""
        step_s = stamp_s - self.newest_s
        if 0.0 < step_s <= self._longest_step_s:
            self.newest_s, self._agreeing = stamp_s, 0
            return _ADVANCES
        if step_s == 0.0 or not math.isfinite(stamp_s):
            return _REFUSED
        if step_s == math.inf:  # the first
            self.newest_s = stamp_s
            return _ADVANCES
        jumped_s = stamp_s - self._jumped_s
        if jumped_s == 0.0:
            return _REFUSED
        follows = self._agreeing > 0 and 0.0 < jumped_s <= self._longest_step_s
        self._agreeing = self._agreeing + 1 if follows else 1
        self._jumped_s = stamp_s
        if self._agreeing < AGREEING:
            return _REFUSED
        self.newest_s, self._agreeing = stamp_s, 0
        return _NEW_CLOCK
