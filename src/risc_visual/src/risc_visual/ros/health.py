"""What a node that draws, or works on pictures, says of itself on /diagnostics."""

import threading
import time

from diagnostic_msgs.msg import DiagnosticStatus

from risc_lab.ros.diagnostics import Growth, make_updater
from risc_lab.ros.ticker import Ticker

_SILENCE_S = 3.0


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
        self._drawn = dict.fromkeys(inputs, 0)
        self._last_s = dict.fromkeys(inputs)
        self._growth = Growth()
        self._updater = make_updater("none")
        self._updater.add(name, self._diagnose)
        Ticker(1.0, self._updater.update, "the diagnostics")

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
            _, rates_hz = self._growth(self._drawn)
            ages_s = {what: None if last_s is None else now_s - last_s for what, last_s in self._last_s.items()}
            refused = dict(self._refused)
        silent = [what for what, age_s in ages_s.items() if age_s is None or age_s > _SILENCE_S]
        if silent:
            level = DiagnosticStatus.OK if self._optional else DiagnosticStatus.WARN
            status.summary(level, "nothing on " + ", ".join(silent))
        else:
            status.summary(DiagnosticStatus.OK, "working")
        for what, age_s in ages_s.items():
            status.add("%s from %s [Hz]" % (self._done, what), "%.1f" % rates_hz[what])
            status.add("age of last %s [s]" % what, "none yet" if age_s is None else "%.2f" % age_s)
        for why, count in refused.items():
            status.add("not %s: %s" % (self._done, why), str(count))
        return status
