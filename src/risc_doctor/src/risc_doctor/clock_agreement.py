"""Do the computers' clocks agree? Ages of messages are differences of stamps and clocks."""

import csv
import ctypes
import shutil
import subprocess
from dataclasses import dataclass

from risc_control.failsafe import SafetyLimits
from risc_doctor.findings import green, red, yellow

_CHRONYC_PATIENCE_S = 2.0
# Between two computers, here and in `maap machines`. The oldest state of the flights over four computers was 60 ms old,
# and the loss ladder gives up one of 100 ms: clocks may take half of what is left. Up to 5 ms, latencies between
# computers mean something.
GOOD_S, BAD_S = 0.005, 0.020
_STA_UNSYNC, _TIME_ERROR = 0x40, 5  # sys/timex.h
_CURE = "sudo apt-get install chrony on every computer, all with the base station as their server"


@dataclass(frozen=True)
class ClockState:
    """What keeps this computer's clock, and how well."""

    source: str  # "chrony", "kernel" (some NTP client set it) or "none"
    synchronised: bool
    offset_s: float = 0.0  # of the clock from its reference, + = ahead; chrony only
    reference: str = ""
    error_s: float = 0.0  # bound of the offset's error, chrony only


def check(situation):
    """Who keeps the clock; and the age of the stamps when a graph runs."""
    state = read_clock()
    findings = [judge(state, situation.simulated)]
    if situation.master is not None:
        findings += judge_stamps(situation.graph().topics)
    return findings


def judge(state, one_computer=False):
    """Finding about who keeps the clock."""
    say = "clock"
    data = {"source": state.source, "synchronised": state.synchronised, "offset_s": state.offset_s}
    if state.synchronised and state.source == "chrony":
        text = "chrony keeps this clock within %.1f ms of %s" % (1e3 * abs(state.offset_s), state.reference)
        if abs(state.offset_s) <= GOOD_S:
            return green(say, text, **data)
        level = red if abs(state.offset_s) > BAD_S else yellow
        return level(say, text + ", which is too far", "sudo chronyc makestep; chronyc sources tells why", **data)
    if one_computer:
        return green(say, "everything is on this computer: one clock", **data)
    if state.synchronised:
        text = "an NTP client keeps this clock; how well, it does not say"
        return yellow(say, text, _CURE, **data)
    if state.source == "chrony":
        text = "chrony runs, but is not synchronised with anything"
        cure = "chronyc sources: is the server (the base station) in /etc/chrony/chrony.conf, on, and reachable?"
        return yellow(say, text, cure, **data)
    text = "nothing keeps this clock right: 50 ms ahead, vehicles hold early; more than 100 ms behind, they land"
    return yellow(say, text, _CURE, **data)


def judge_stamps(topics):
    """Findings about the ages of messages. topics: {name: ros_graph.Topic}."""
    ages_s = {name: topic.age_s for name, topic in sorted(topics.items()) if topic.age_s is not None}
    if not ages_s:
        return []
    say, data = "clock", {"age_s": ages_s}
    youngest_s, oldest_s = min(ages_s.values()), max(ages_s.values())
    text = "messages arrive this long after the exposure: " + ", ".join(
        "%s %.0f ms" % (name, 1e3 * age_s) for name, age_s in ages_s.items()
    )
    if youngest_s < -GOOD_S:
        level = red if youngest_s < -BAD_S else yellow
        return [level(say, text + "; none can come from the future: clocks differ", _CURE, **data)]
    limit_s = SafetyLimits.state_hold_s
    if oldest_s > limit_s:
        text += "; vehicles hold at %.0f ms" % (1e3 * limit_s)
        cure = "see `load`, then the network; else the clocks differ: " + _CURE
        return [red(say, text, cure, **data)]
    return [green(say, text, **data)]


def read_clock():
    """ClockState of this computer."""
    if shutil.which("chronyc"):
        state = parse_tracking(_chronyc_tracking())
        if state is not None:
            return state
    return _kernel_clock()


def parse_tracking(text):
    """ClockState of the output of `chronyc -c tracking`, None when it is none (the daemon does not run)."""
    rows = list(csv.reader(text.splitlines()))
    if not rows or len(rows[0]) < 14:
        return None
    row = rows[0]
    try:
        offset_s, delay_s, dispersion_s = -float(row[4]), float(row[10]), float(row[11])  # chronyc's + is slow
    except ValueError:
        return None
    synchronised = row[13] != "Not synchronised" and row[0] != "00000000"
    return ClockState("chrony", synchronised, offset_s, row[1] or row[0], dispersion_s + delay_s / 2.0)


def _chronyc_tracking():
    try:
        done = subprocess.run(
            ["chronyc", "-c", "tracking"],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            stdin=subprocess.DEVNULL,
            text=True,
            timeout=_CHRONYC_PATIENCE_S,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout if done.returncode == 0 else ""


class _Timex(ctypes.Structure):
    """struct timex, as far as it is read; the rest is space."""

    _fields_ = [
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_char * 256),
    ]


def _kernel_clock():
    """What the kernel was told by whatever sets its clock."""
    timex = _Timex(modes=0)  # only to be read
    state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(timex))
    synchronised = state not in (-1, _TIME_ERROR) and not timex.status & _STA_UNSYNC
    return ClockState("kernel" if synchronised else "none", synchronised)
