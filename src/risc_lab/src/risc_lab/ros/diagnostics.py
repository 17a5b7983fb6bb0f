"""What a node tells of itself on /diagnostics."""

import time

import rospy
from diagnostic_updater import Updater

from risc_lab.ros.ticker import Ticker

_PERIOD = "~diagnostic_period"
_PERIOD_S = 1.0
_SILENCE_S = 3.0  # without news after which an input is silent


def make_updater(hardware_id="none"):
    """A diagnostic_updater.Updater for this node that leaves the master alone.

    An Updater asks for its period again and again as long as it is not set, and asking is to the master as good
    as registering: a node that is just being replaced by one of the same name would throw that one out again.
    """
    if not rospy.has_param(_PERIOD):
        rospy.set_param(_PERIOD, _PERIOD_S)
    updater = Updater()
    updater.setHardwareID(hardware_id)
    return updater


def ticking_updater(hardware_id="none"):
    """One that reports once a second by itself."""
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
    """The first of (condition, level, message) whose condition holds is the summary of a status."""
    status.summary(*next(case[1:] for case in cases if case[0]))


def add_all(status, values):
    """{key: value} into a status."""
    for key, value in values.items():
        status.add(key, str(value))


def is_silent(last_s):
    """Whether an input is. last_s: when it was heard last, monotonic clock; None: never."""
    return last_s is None or time.monotonic() - last_s > _SILENCE_S


def age_text(last_s):
    """How long ago something came last [s], for a status. last_s: time of the monotonic clock, None: never."""
    return "none yet" if last_s is None else "%.2f" % (time.monotonic() - last_s)
