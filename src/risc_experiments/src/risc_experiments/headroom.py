"""Whether the computer keeps up with motion capture, found out on the ground: before take-off, not after a minute."""

import math
import time

from risc_experiments.processor_use import ProcessorUse

READY_S = 3.5  # [s] that everything runs on the ground before take-off
JUDGED_S = 2.7  # [s] of it that are judged, enough for three reports of a node
RATES_HZ = (200.0, 150.0, 100.0, 75.0, 50.0)  # that are tried, one after the other
MOST_USE = 0.85  # of all cores by the flight: the rest is for take-off, video and the system
MOST_AGE_MS = 30.0  # of the oldest state that the controller answers: beyond, frames wait for processors
_REPORTS = 2  # of a node's diagnostics, once a second, that must say so one after the other


class Headroom:
    """Watches a flight that stands on the ground, ready to take off."""

    def __init__(self, identity):
        """identity: of the flight's processes, as in `processes.Launch`."""
        self._use = ProcessorUse(identity)
        self._since_s = None
        self._is_over = False

    def look(self, watch):
        """Note what the nodes say; to be called again and again while all wait for take-off.

        watch: ros.watch.Watch.  Returns why the computer does not keep up, in a sentence; "" when it does, or as long
        as too little was seen.
        """
        now_s = time.monotonic()
        if self._since_s is None:
            self._since_s = now_s
            self._use.look()
            for reports in (watch.oldest_ms, watch.passed_over):
                reports.clear()  # while programs start, they have little time
        if self._is_over or now_s - self._since_s < JUDGED_S:
            return ""
        self._is_over = True
        self._use.look()
        return judge(self._use.figures(), list(watch.oldest_ms), list(watch.passed_over))


def judge(figures, ages_ms, passed_over):
    """Why a computer does not keep up; "" when it does.

    figures: of ProcessorUse.  ages_ms: of the oldest state that the controller answered, in each of its reports.
    passed_over: frames that the estimator has passed over, in each of its reports.
    """
    taken = ""
    if figures:
        computer, used = figures["computer"], sum(figures["cpu_cores"].values())
        if computer["busiest_other_cores"] >= 0.1:
            taken = "; %s takes %.1f cores" % (computer["busiest_other"], computer["busiest_other_cores"])
        if computer["steal"] >= 0.05:
            taken += "; the host of this virtual machine takes %.0f %%" % (100.0 * computer["steal"])
        if used > MOST_USE * computer["cores"]:
            return "on the ground already the flight takes %.2f of %d cores%s" % (used, computer["cores"], taken)
    latest = passed_over[-_REPORTS - 1 :]
    if len(latest) > _REPORTS and all(after > before for before, after in zip(latest, latest[1:])):
        return "the estimator has no time for every frame (%d passed over)%s" % (latest[-1], taken)
    latest = ages_ms[-_REPORTS:]
    if len(latest) == _REPORTS and min(latest) > MOST_AGE_MS:
        return "the controller answers states that are up to %.0f ms old%s" % (max(latest), taken)
    return ""


def next_rate_hz(rate_hz):
    """The next lower rate to try [Hz]; None when there is none."""
    return next((lower for lower in RATES_HZ if lower < rate_hz - 1.0 and math.isfinite(rate_hz)), None)
