"""What must stay true during a soak, and the messages when it does not. No input or output."""

from typing import NamedTuple

FIGURES = {  # of a process: (names of its SoakLimits per hour and in total, unit, text)
    "own_mb": ("memory_mb_h", "memory_mb", "MB", "memory of its own"),
    "descriptors": ("descriptors_h", "descriptors", "", "open descriptors"),
    "threads": ("threads_h", "threads", "", "threads"),
}


class Violation(NamedTuple):
    """A broken invariant."""

    invariant: str  # one word
    text: str  # what was found, in a sentence


def growth(name, track, warm_s, params):
    """Yields the Violations of a process whose figures grow. track: drift.Track with those of FIGURES."""
    for figure, (per_hour, at_all, unit, what) in FIGURES.items():
        found = track.drift(figure, warm_s)
        most, least = getattr(params.limits, per_hour), getattr(params.limits, at_all)
        if found.judged_s >= params.least_judged_s and found.exceeds(most, least):
            text = "%s: %s went from %.4g to %.4g %s, by %s an hour; the limit is %g"
            values = name, what, found.first, found.last, unit, interval(found), most
            yield Violation("growth", " ".join((text % values).split()))


def interval(found):
    """A Drift's slope with its interval, as text."""
    return "%+.3g (%+.3g to %+.3g)" % (found.slope, found.low, found.high)


def latency(track, warm_s, params):
    """Violation of flights whose latency grows; None. track: drift.Track with p99_ms of each flight."""
    found, limits = track.drift("p99_ms", warm_s), params.limits
    if found.judged_s < params.least_judged_s or not found.exceeds(limits.latency_ms_h, limits.latency_ms):
        return None
    text = "from frame to command p99 went from %.1f to %.1f ms, by %s ms an hour; the limit is %g"
    return Violation("latency", text % (found.first, found.last, interval(found), limits.latency_ms_h))


def flight(judged, limits):
    """Violation of a flight; None. judged: of `verdict.judge_flight`."""
    if judged["reasons"]:
        return Violation("flight", "; ".join(judged["reasons"]))
    late_ms = judged["lab_late_ms"]["p99"]
    if late_ms is not None and late_ms > limits.lab_late_ms:
        text = "the virtual lab was up to %.0f ms late (p99; the limit is %g): this computer had too little time"
        return Violation("late", text % (late_ms, limits.lab_late_ms))
    return None


def crash(vehicle, reason, safe):
    """Violation of a vehicle that touched something; None. safe: outcomes that faults of this flight allow."""
    if "breach" in safe:
        return None
    return Violation("crash", "%s %s, and no fault of this flight allows that" % (vehicle, reason))


def gone(ended):
    """Violation of processes that ended and were not killed by a fault; None. ended: of `Processes.ended`."""
    wrong = ["%s (process %d)" % (name, pid) for name, pid, killed in ended if not killed]
    return Violation("process", "%s: ended, and no fault of this flight ended it" % ", ".join(wrong)) if wrong else None


def not_back(missing_s, limits):
    """Violation of processes that were killed and do not run again; None. missing_s: {name: for how long}."""
    names = [name for name, time_s in sorted(missing_s.items()) if time_s > limits.back_s]
    if not names:
        return None
    text = "%s: killed by a fault, and not started again within %g s"
    return Violation("process", text % (", ".join(names), limits.back_s))


def not_ready(waited_s, why, limits):
    """Violation of a fleet that does not take off again; None. waited_s: since it was asked to."""
    if waited_s <= limits.ready_s:
        return None
    return Violation(
        "take-off", "no vehicle took off within %g s: %s" % (limits.ready_s, why or "the operator says nothing")
    )


def error(node, text, explained):
    """Violation of an error in a log; None where a fault of this flight may be why."""
    return None if explained else Violation("log", "error of %s that no fault explains: %s" % (node, text))


def traceback(text):
    """Violation of a Python program with an unhandled exception: no fault excuses that."""
    return Violation("log", "a traceback in roslaunch.log: %s" % text.strip().splitlines()[-1])


def disk(free_mb, limits):
    """Violation of a disk that fills; None."""
    if free_mb >= limits.free_disk_mb:
        return None
    return Violation("disk", "%.0f MB are left on the disk, fewer than %g" % (free_mb, limits.free_disk_mb))
