"""Height of a vehicle on sticks that is not seen: by the model of its climb, and by its own reports. No ROS.

The height and climb rate that it reports come from a barometer, which drifts: they are used relative to their offsets
while it was seen.
"""

import math
from collections import deque

from risc_lab.limits import within

_FEELS_S, _FELT_S = 0.5, 3.0  # of reports while it is seen: least duration to use them; time constant of their zeros
_FELT_GAP_S = 0.25  # longest gap between reports
_LATE_S = 0.3  # they may be later than usual by up to this:
_NOISE_M, _NOISE_M_S = 0.15, 0.1  # only their excess over the model's range of that time and their noise counts,
_FELT_M, _FELT_M_S = 0.8, 1.0  # and they are not believed if it is this large
_FELT_1_S = 1.0  # gain of the correction of the height
_CLIMB_1_S, _CLIMB_M_S2 = 2.0, 1.0  # control of the modelled climb rate: gain, limit;
_HEIGHT_1_S, _HEIGHT_M_S = 1.0, 0.3  # and of the height


class BlindHeight:
    """One vehicle. Heights are above the floor."""

    def __init__(self, observer):
        """observer: its ClimbObserver, which is corrected, too."""
        self.height_m = 0.0  # as it was seen, or by the model since
        self._held_m = 0.0
        self._observer = observer
        self._lately = deque(maxlen=32)  # by the model: (time, height, climb rate)
        self._felt, self._felt_s = None, -math.inf  # newest (height, climb rate) that it reported; when it had them
        self._zeros, self._zeros_s = (0.0, 0.0), 0.0  # their offsets while it was seen; averaged over how long [s]

    def see(self, height_m):
        """It was seen at this height."""
        self.height_m = self._held_m = height_m
        self._lately.clear()

    def hold_here(self):
        """Hold the present height."""
        self._held_m = self.height_m

    def feel(self, height_m, climb_m_s, measured_s, seen, obeys):
        """It reports its height, above a zero of its own, and climb rate, both at measured_s.

        seen: (height, climb rate) of that time by motion capture; None: not seen.  obeys: it takes our commands.
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
        """Upward acceleration [m/s^2] to command now for a climb rate; None: to hold the height. step_s: since the last
        call.
        """
        self._observer.advance(now_s)
        has_m_s = self._observer.climb_m_s
        self.height_m += step_s * has_m_s
        self._lately.append((now_s, self.height_m, has_m_s))
        if climb_m_s is None:
            climb_m_s = within(_HEIGHT_1_S * (self._held_m - self.height_m), _HEIGHT_M_S)
        return within(_CLIMB_1_S * (climb_m_s - has_m_s), _CLIMB_M_S2)


def _beyond(value, known, noise):
    """By how much a value is above or below the range of `known`, widened by the noise."""
    return value - min(max(value, min(known) - noise), max(known) + noise)
