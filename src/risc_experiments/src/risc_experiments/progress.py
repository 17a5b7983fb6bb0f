"""What a person sees while a flight runs: one line that is renewed, or a line now and then into a file."""

import shutil
import sys
import time


class Progress:
    """Shows phase, time, errors and mocap rate of a running flight."""

    def __init__(self, stream=None, plain_period_s=5.0):
        self._stream = stream or sys.stderr
        self._live = self._stream.isatty()
        self._period_s = 0.25 if self._live else plain_period_s
        self._begin_s = time.monotonic()
        self._last_s = -float("inf")
        self._last_phase = None

    def show(self, phase, detail=""):
        """Renew the line; a new phase always shows, the rest now and then."""
        now_s = time.monotonic()
        if phase == self._last_phase and now_s - self._last_s < self._period_s:
            return
        self._last_s, self._last_phase = now_s, phase
        text = ("%5.1f s  %-10s  %s" % (now_s - self._begin_s, phase, detail)).rstrip()
        if self._live:  # a line that wraps cannot be renewed
            text = "\r\033[K" + text[: shutil.get_terminal_size().columns - 1]
        self._stream.write(text if self._live else text + "\n")
        self._stream.flush()

    def say(self, text):
        """Print a line of its own that stays."""
        self._stream.write(("\r\033[K" if self._live else "") + text + "\n")
        self._stream.flush()


def flight_detail(errors_mm, rate_hz):
    """Per-vehicle position errors [mm] (None: unknown) and the rate of the mocap stream [Hz] as text."""
    parts = ["%s %s" % (name, "   -" if error is None else "%4.0f" % error) for name, error in errors_mm.items()]
    if parts:
        parts[-1] += " mm"
    parts.append("mocap %s" % ("-" if rate_hz is None else "%.0f Hz" % rate_hz))
    return "  ".join(parts)
