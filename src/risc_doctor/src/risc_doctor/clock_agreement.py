"""Do the clocks of computers agree? The age of a message is the difference between a clock and its stamp."""

import contextlib
import csv
import ctypes
import subprocess
from dataclasses import asdict, dataclass

from risc_control.safety import SafetyLimits
from risc_doctor.findings import RED, YELLOW, Findings, finding

_CHRONYC_PATIENCE_S = 2.0
# Limits between two computers, here and in `maap machines`. In flights over four computers the oldest state was 60 ms
# old, and the failsafe rejects one of 100 ms: clocks may take half of what is left. Up to 5 ms, latencies between
# computers are meaningful.
GOOD_S, BAD_S = 0.005, 0.020
_TIME_ERROR = 5  # sys/timex.h: what adjtimex returns for a clock that nothing synchronises
_TIMEX_BYTES = 512  # more than struct timex has


@dataclass(frozen=True)
class ClockState:
    """What synchronises this computer's clock, and how well."""

    source: str  # "chrony", "kernel" (some NTP client set it) or "none"
    synchronised: bool
    offset_s: float = 0.0  # of the clock from its reference, + = ahead; chrony only
    reference: str = ""
    error_s: float = 0.0  # bound of the offset's error, chrony only


def check(situation):
    """What synchronises the clock; and the age of the stamps when a graph runs."""
    return [judge(read_clock(), situation.simulated), *judge_stamps(situation.graph().topics)]


def judge(state, one_computer=False):
    """Finding about what synchronises the clock."""
    level = None
    if state.synchronised and state.source == "chrony":
        code = "chrony" if abs(state.offset_s) <= GOOD_S else "chrony_far"
        level = YELLOW if GOOD_S < abs(state.offset_s) <= BAD_S else None
    elif one_computer:
        code = "one"
    elif state.synchronised:
        code = "ntp"
    else:
        code = "chrony_alone" if state.source == "chrony" else "nobody"
    return finding("clock", code, level, offset_ms=1e3 * abs(state.offset_s), **asdict(state))


def judge_stamps(topics):
    """Findings about the ages of messages. topics: {name: ros_graph.Topic}."""
    found, limit_s = Findings("clock"), SafetyLimits.state_hold_s
    ages_s = {name: topic.age_s for name, topic in sorted(topics.items()) if topic.age_s is not None}
    if not ages_s:
        return found
    text = ", ".join("%s %.0f ms" % (name, 1e3 * age_s) for name, age_s in ages_s.items())
    if min(ages_s.values()) < -GOOD_S:
        level = RED if min(ages_s.values()) < -BAD_S else YELLOW
        return found.say("future", level, ages=text, age_s=ages_s)
    code = "old" if max(ages_s.values()) > limit_s else "ages"
    return found.say(code, ages=text, age_s=ages_s, limit_ms=1e3 * limit_s)


def read_clock():
    """ClockState of this computer: what chrony says, else what its NTP client told the kernel."""
    command, quiet = ["chronyc", "-c", "tracking"], subprocess.DEVNULL
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        told = subprocess.check_output(command, stdin=quiet, stderr=quiet, text=True, timeout=_CHRONYC_PATIENCE_S)
        if state := parse_tracking(told):
            return state
    timex = ctypes.create_string_buffer(_TIMEX_BYTES)  # all zero: only reads
    synchronised = ctypes.CDLL(None, use_errno=True).adjtimex(timex) not in (-1, _TIME_ERROR)
    return ClockState("kernel" if synchronised else "none", synchronised)


def parse_tracking(text):
    """ClockState of the output of `chronyc -c tracking`, None when it has none (the daemon does not run)."""
    row = next(csv.reader(text.splitlines()), [])
    try:
        offset_s, delay_s, dispersion_s = -float(row[4]), float(row[10]), float(row[11])  # chronyc's + is slow
        synchronised = row[13] != "Not synchronised" and row[0] != "00000000"
    except (ValueError, IndexError):
        return None
    return ClockState("chrony", synchronised, offset_s, row[1] or row[0], dispersion_s + delay_s / 2.0)
