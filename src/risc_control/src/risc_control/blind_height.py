"""Height of a vehicle on sticks that is not seen: by the model of its climb, and by what it says itself. No ROS.

The height and climb rate that it says to have come from a barometer, which drifts: what counts is how they differ from
what they were while it was seen.
"""

import math
from collections import deque

from risc_lab.limits import within

_FEELS_S, _FELT_S = 0.5, 3.0  # of reports while it is seen: from so many on they count; time constant of their zeros
_FELT_GAP_S = 0.25  # between reports at most
_LATE_S = 0.3  # they may be late by so much more than they are as a rule:
_NOISE_M, _NOISE_M_S = 0.15, 0.1  # they count beyond all that was reckoned for then, and beyond their noise,
_FELT_M, _FELT_M_S = 0.8, 1.0  # and are not believed where they are so far from it
_FELT_1_S = 1.0  # of the height that is reckoned, by its error
_CLIMB_1_S, _CLIMB_M_S2 = 2.0, 1.0  # of the climb rate that is reckoned;
_HEIGHT_1_S, _HEIGHT_M_S = 1.0, 0.3  # and of the height


class BlindHeight:
    """One vehicle. Heights are above the floor."""

    def __init__(self, observer):
        """observer: its ClimbObserver, which is corrected, too."""
        self.height_m = 0.0  # as it was seen, or is reckoned since
        self._held_m = 0.0
        self._observer = observer
        self._lately = deque(maxlen=32)  # reckoned: (time, height, climb rate)
        self._felt, self._felt_s = None, -math.inf  # newest (height, climb rate) that it said to have, when it had them
        self._zeros, self._zeros_s = (0.0, 0.0), 0.0  # by which these were too large while it was seen; of how long

    def see(self, height_m):
        """It was seen there."""
        self.height_m = self._held_m = height_m
        self._lately.clear()

    def hold_here(self):
        """The height that is held is that of now."""
        self._held_m = self.height_m

    def feel(self, height_m, climb_m_s, measured_s, seen, obeys):
        """It says that it had this height, by a zero of its own, and climb rate.

        seen: (height, climb rate) for then by motion capture; None: it is not seen.  obeys: it takes our commands.
        """
        if (height_m, climb_m_s) == self._felt or not math.isfinite(height_m + climb_m_s):
            return
        step_s = measured_s - self._felt_s
        self._felt, self._felt_s = (height_m, climb_m_s), measured_s
        if not 0.0 < step_s < _FELT_GAP_S:
            return
        if seen is not None:
            self._zeros_s = min(_FELT_S, self._zeros_s + step_s)
            zeros, share = (height_m - seen[0], climb_m_s - seen[1]), step_s / self._zeros_s
            self._zeros = tuple(old + share * (new - old) for old, new in zip(self._zeros, zeros))
            return
        begins_s = measured_s - _LATE_S
        lately = [then for then in self._lately if then[0] >= begins_s]
        if self._zeros_s >= _FEELS_S and lately and self._lately[0][0] <= begins_s:
            _, heights_m, climbs_m_s = zip(*lately)
            error_m = _beyond(height_m - self._zeros[0], heights_m, _NOISE_M)
            if abs(error_m) < _FELT_M:
                self.height_m += _FELT_1_S * step_s * error_m
            error_m_s = _beyond(climb_m_s - self._zeros[1], climbs_m_s, _NOISE_M_S)
            if abs(error_m_s) < _FELT_M_S and obeys:
                self._observer.correct(error_m_s, step_s)

    def advance(self, now_s, step_s, climb_m_s=None):
        """Upward acceleration [m/s^2] of now, step_s after the last, for a climb rate; None: to hold the height."""
        self._observer.advance(now_s)
        has_m_s = self._observer.climb_m_s
        self.height_m += step_s * has_m_s
        self._lately.append((now_s, self.height_m, has_m_s))
        if climb_m_s is None:
            climb_m_s = within(_HEIGHT_1_S * (self._held_m - self.height_m), _HEIGHT_M_S)
        return within(_CLIMB_1_S * (climb_m_s - has_m_s), _CLIMB_M_S2)


def _beyond(value, known, noise):
    """By how much it is above or below all that is known, and the noise."""
    return value - min(max(value, min(known) - noise), max(known) + noise)
