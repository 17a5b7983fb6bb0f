"""Checks whether the computer keeps up with motion capture: before take-off, and after a flight missed its limits."""

import time

from risc_experiments.processor_use import ProcessorUse

READY_S = 4.2  # [s] that everything runs on the ground before take-off
JUDGED_S = 3.3  # [s] of READY_S that are judged: enough for the _REPORTS that must agree
RATES_HZ = (200.0, 150.0, 100.0, 75.0, 50.0)  # tried one after the other; the last leaves room for two lost frames
MOST_USE = 0.85  # fraction of all cores that the flight may use: the rest is for take-off, video and the system
MOST_AGE_MS = 30.0  # of the oldest state that the controller answers: above this, frames wait for a processor
MOST_PASSED_OVER = 0.005  # fraction of the frames that may be skipped: one in 200 may be a hiccup
_REPORTS = 3  # of a node, one a second, that must agree: a one-second disturbance affects two
_LEAST_CORES = 0.1  # smaller loads are not mentioned
_LEAST_STEAL = 0.05


class Headroom:
    """Watches a flight that stands on the ground, ready to take off."""

    def __init__(self, identity):
        """identity: of the flight's processes, as in `launching.Launch`."""
        self._use = ProcessorUse(identity)
        self._since_s = None
        self._is_over = False

    def look(self, watch):
        """Evaluate the reports of the nodes; to be called repeatedly while all wait for take-off.

        watch: ros.watch.Watch.  Returns why the computer does not keep up, in a sentence; "" when it does, or while
        there is too little data.
        """
        now_s = time.monotonic()
        if self._since_s is None:
            self._since_s = now_s
            self._use.look()
            watch.oldest_ms.clear()  # while programs start, they have little time
            while len(watch.passed_over) > 1:
                watch.passed_over.popleft()
        if self._is_over or now_s - self._since_s < JUDGED_S:
            return ""
        self._is_over = True
        self._use.look()
        return judge(self._use.figures(), list(watch.oldest_ms), list(watch.passed_over))


def judge(figures, ages_ms, passed_over):
    """Why a computer does not keep up; "" when it does.

    figures: of ProcessorUse.  ages_ms: of the oldest state that the controller answered, in each of its reports.
    passed_over: count of frames that the estimator has skipped, in each report, from the last one before the check on.
    """
    if figures and sum(figures["cpu_cores"].values()) > MOST_USE * figures["computer"]["cores"]:
        return "; ".join(["on the ground already " + _flight(figures), *_others(figures)])
    problem = ""
    latest = passed_over[-_REPORTS - 1 :]
    if len(latest) > _REPORTS and all(after > before for before, after in zip(latest, latest[1:])):
        problem = "the estimator had no time for every frame (%d passed over)" % (latest[-1] - latest[0])
    latest = ages_ms[-_REPORTS:]
    if not problem and len(latest) == _REPORTS and min(latest) > MOST_AGE_MS:
        problem = "the controller answered states that were up to %.0f ms old" % max(latest)
    return "; ".join([problem, *(_others(figures) if figures else ())]) if problem else ""


def verdict(result):
    """Say in a sentence, with figures, whether a flight that missed its limits had enough processor time.

    A busy computer is not blamed if nothing was late: flight programs have priority.  result: summary of the flight.
    Returns "" when nothing was measured.
    """
    mocap, age_ms, lab_ms = result["mocap"], result["latency_ms"]["datagram_to_controls"]["p99"], result["lab_late_ms"]
    measured = []  # (whether it is too much, text)
    if mocap["frames_received"]:
        share = mocap["frames_passed_over"] / mocap["frames_received"]
        measured.append((share > MOST_PASSED_OVER, "%d frames passed over" % mocap["frames_passed_over"]))
    if age_ms is not None:
        measured.append((age_ms > MOST_AGE_MS, "controls up to %.0f ms after the frame" % age_ms))
    if result["on_schedule"] is not None:
        text = "the virtual lab up to %.0f ms late, its pictures %.0f ms"
        measured.append((not result["on_schedule"], text % (lab_ms["p99"], result["video_late_ms"] or 0.0)))
    signs = ", ".join(text for too_much, text in measured if too_much)
    if not signs:
        seen = ", ".join(text for _, text in measured)
        return seen and "processor time was not the reason (%s)" % seen
    who = [*_others(result), _flight(result)] if result["computer"] else ["unknown what took it"]
    idle = ", %.0f %% idle" % (100.0 * result["computer"]["idle"]) if result["computer"] else ""
    return "for want of processor time: %s (%s%s)" % (", ".join(who), signs, idle)


def _flight(figures):
    return "the flight took %.2f of %d cores" % (sum(figures["cpu_cores"].values()), figures["computer"]["cores"])


def _others(figures):
    """Who else took the computer's time, one text each."""
    computer = figures["computer"]
    if computer["busiest_other_cores"] >= _LEAST_CORES:
        yield "'%s' took %.1f cores" % (computer["busiest_other"], computer["busiest_other_cores"])
    if computer["steal"] >= _LEAST_STEAL:
        yield "the host of this virtual machine took %.0f %%" % (100.0 * computer["steal"])


def next_rate_hz(rate_hz):
    """The next lower rate to try [Hz]; None when there is none."""
    return next((lower for lower in RATES_HZ if lower < rate_hz - 1.0), None)
