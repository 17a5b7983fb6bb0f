"""Progress display: one line that is updated on a terminal, or a line now and then in a file."""

import shutil
import sys
import time

_BAR_WIDTH = 24  # characters


class Progress:
    """Shows the phase of a running job, its elapsed time and a detail."""

    def __init__(self, stream=None, plain_period_s=5.0):
        self._stream = stream or sys.stderr
        self._live = self._stream.isatty()
        self._period_s = 0.25 if self._live else plain_period_s
        self._begin_s = time.monotonic()
        self._last_s = -float("inf")
        self._last_phase = None

    def show(self, phase, detail=""):
        """Update the line; a new phase is always shown, other updates now and then."""
        now_s = time.monotonic()
        if phase == self._last_phase and now_s - self._last_s < self._period_s:
            return
        self._last_s, self._last_phase = now_s, phase
        text = ("%5.1f s  %-10s  %s" % (now_s - self._begin_s, phase, detail)).rstrip()
        if self._live:  # a line that wraps cannot be updated
            text = "\r\033[K" + text[: shutil.get_terminal_size().columns - 1]
        self._stream.write(text if self._live else text + "\n")
        self._stream.flush()

    def say(self, text):
        """Print a permanent line."""
        self.clear()
        self._stream.write(text + "\n")
        self._stream.flush()

    def clear(self):
        """Erase the progress line, before something else is printed in its place."""
        if self._live:
            self._stream.write("\r\033[K")
            self._stream.flush()


def bar(fraction):
    """Text of a progress bar: [######..................]  25 %"""
    fraction = min(max(fraction, 0.0), 1.0)
    full = int(fraction * _BAR_WIDTH)
    return "[%s%s] %3.0f %%" % ("#" * full, "." * (_BAR_WIDTH - full), 100.0 * fraction)
