"""What a node reports on /diagnostics."""

import time

import rospy
from diagnostic_updater import Updater

from risc_lab.ros.ticker import Ticker

_PERIOD = "~diagnostic_period"
_PERIOD_S = 1.0
_SILENCE_S = 3.0  # without news after which an input is silent


def make_updater(hardware_id="none"):
    """A diagnostic_updater.Updater for this node that does not query the master.

    An Updater asks for its period again and again while the parameter is not set, and to the master a query counts as
    a registration: a node that is just being replaced by one of the same name would displace that one again.
    """
    if not rospy.has_param(_PERIOD):
        rospy.set_param(_PERIOD, _PERIOD_S)
    updater = Updater()
    updater.setHardwareID(hardware_id)
    return updater


def ticking_updater(hardware_id="none"):
    """An updater that reports once a second by itself."""
    updater = make_updater(hardware_id)
    Ticker(1.0, updater.force_update, "the diagnostics")
    return updater


class Growth:
    """How much counters have grown since they were reported last."""

    def __init__(self):
        self._counts, self._reported_s = {}, time.monotonic()

    def __call__(self, counts):
        """({name: growth}, {name: growth a second [Hz]}) of {name: count}."""
        now_s = time.monotonic()
        elapsed_s = max(now_s - self._reported_s, 1e-3)
        new = {name: count - self._counts.get(name, 0) for name, count in counts.items()}
        self._counts, self._reported_s = dict(counts), now_s
        return new, {name: count / elapsed_s for name, count in new.items()}


def summarise(status, *cases):
    """Set the summary of a status: the first (condition, level, message) whose condition holds."""
    status.summary(*next(case[1:] for case in cases if case[0]))


def add_all(status, values):
    """Add {key: value} to a status."""
    for key, value in values.items():
        status.add(key, str(value))


def is_silent(last_s):
    """Whether an input is silent. last_s: when it was last heard, monotonic clock; None: never."""
    return last_s is None or time.monotonic() - last_s > _SILENCE_S


def age_text(last_s):
    """Time since something last came [s], for a status. last_s: when, monotonic clock; None: never."""
    return "none yet" if last_s is None else "%.2f" % (time.monotonic() - last_s)
