"""What all nodes of risc_visual share: how they run, and what they say of themselves on /diagnostics."""

import sys
import threading
import time

import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from risc_lab.ros.diagnostics import make_updater
from risc_lab.ros.ticker import Ticker

SILENCE_S = 3.0  # without news after which an input is silent


def run(name, make):
    """Make a node, and run it until shutdown; wrong parameters (ValueError) end it with one line."""
    rospy.init_node(name)
    try:
        node = make()
    except ValueError as error:
        rospy.logfatal("%s: %s", name, error)
        sys.exit(1)
    rospy.spin()
    del node


def ticking_updater():
    """A diagnostic_updater.Updater that reports once a second."""
    updater = make_updater("none")
    Ticker(1.0, updater.update, "the diagnostics")
    return updater


class Health:
    """Counts what is drawn per input and reports rates and ages at 1 Hz. No input is a warning, never an error."""

    def __init__(self, name, inputs, optional=False, done="drawn"):
        """inputs: what `drawn` will be called with, and what a healthy laboratory sends; optional: or does not.

        done: what the node does with a message, when that is not drawing.
        """
        self._done = done
        self._lock = threading.Lock()
        self._optional = optional
        self._refused = {}  # why -> how often
        self._drawn = dict.fromkeys(inputs, 0)  # since the last report
        self._last_s = dict.fromkeys(inputs)
        self._reported_s = time.monotonic()
        ticking_updater().add(name, self._diagnose)

    def drawn(self, what):
        """One message of an input has been drawn."""
        with self._lock:
            self._drawn[what] += 1
            self._last_s[what] = time.monotonic()

    def refused(self, why):
        """One message of an input could not be drawn."""
        with self._lock:
            self._refused[why] = self._refused.get(why, 0) + 1

    def _diagnose(self, status):
        with self._lock:
            now_s = time.monotonic()
            drawn, self._drawn = self._drawn, dict.fromkeys(self._drawn, 0)
            elapsed_s, self._reported_s = max(now_s - self._reported_s, 1e-3), now_s
            ages_s = {what: None if last_s is None else now_s - last_s for what, last_s in self._last_s.items()}
            refused = dict(self._refused)
        silent = [what for what, age_s in ages_s.items() if age_s is None or age_s > SILENCE_S]
        level = DiagnosticStatus.WARN if silent and not self._optional else DiagnosticStatus.OK
        status.summary(level, "nothing on " + ", ".join(silent) if silent else "working")
        for what, age_s in ages_s.items():
            status.add("%s from %s [Hz]" % (self._done, what), "%.1f" % (drawn[what] / elapsed_s))
            status.add("age of last %s [s]" % what, "none yet" if age_s is None else "%.2f" % age_s)
        for why, count in refused.items():
            status.add("not %s: %s" % (self._done, why), str(count))
        return status
