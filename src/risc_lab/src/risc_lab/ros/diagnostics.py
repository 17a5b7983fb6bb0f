"""What a node tells of itself on /diagnostics."""

import time

import rospy
from diagnostic_updater import Updater

_PERIOD = "~diagnostic_period"
_PERIOD_S = 1.0


def make_updater(hardware_id):
    """A diagnostic_updater.Updater for this node that leaves the master alone.

    An Updater asks for its period again and again as long as nobody has set it, and asking is to the master as good
    as registering: a node that is just being replaced by one of the same name would throw that one out again.
    """
    if not rospy.has_param(_PERIOD):
        rospy.set_param(_PERIOD, _PERIOD_S)
    updater = Updater()
    updater.setHardwareID(hardware_id)
    return updater


class Rates:
    """Counts of what happens, and how often it has happened lately. Not locked."""

    def __init__(self, *what):
        self.counts = dict.fromkeys(what, 0)
        self._before, self._before_s = dict(self.counts), time.monotonic()

    def lately(self):
        """{what: times a second since the last call}."""
        now_s = time.monotonic()
        elapsed_s, self._before_s = max(now_s - self._before_s, 1e-3), now_s
        before, self._before = self._before, dict(self.counts)
        return {what: (count - before.get(what, 0)) / elapsed_s for what, count in self.counts.items()}
