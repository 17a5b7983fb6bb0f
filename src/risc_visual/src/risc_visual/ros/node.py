"""The reports of all nodes of risc_visual on /diagnostics."""

import threading
import time

from diagnostic_msgs.msg import DiagnosticStatus

from risc_lab.ros.diagnostics import Growth, age_text, is_silent, ticking_updater


class Health:
    """Counts what is drawn per input and reports rates and ages at 1 Hz. A silent input is a warning, no error."""

    def __init__(self, name, inputs, optional=False, done="drawn"):
        """inputs: names that `drawn` is called with; optional: they may be silent in a healthy laboratory.

        done: what the node does with a message, if not "drawn".
        """
        self._done = done
        self._lock = threading.Lock()
        self._optional = optional
        self._refused = {}  # why -> how often
        self._drawn = dict.fromkeys(inputs, 0)
        self._last_s = dict.fromkeys(inputs)
        self._growth = Growth()
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
            _, rates_hz = self._growth(self._drawn)
            last_s, refused = dict(self._last_s), dict(self._refused)
        silent = [what for what, at_s in last_s.items() if is_silent(at_s)]
        level = DiagnosticStatus.WARN if silent and not self._optional else DiagnosticStatus.OK
        status.summary(level, "nothing on " + ", ".join(silent) if silent else "working")
        for what, at_s in last_s.items():
            status.add("%s from %s [Hz]" % (self._done, what), "%.1f" % rates_hz[what])
            status.add("age of last %s [s]" % what, age_text(at_s))
        for why, count in refused.items():
            status.add("not %s: %s" % (self._done, why), str(count))
        return status
