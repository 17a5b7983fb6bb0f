"""How far another computer's clock is from ours: what chrony says there, and what is measured over ssh."""

import contextlib
import time

from risc_doctor.clock_agreement import BAD_S, GOOD_S, parse_tracking
from risc_doctor.findings import RED, YELLOW, finding

_ROUND_TRIPS = 25
_LIMIT_S = 5.0
# one line in, one line out; ends by itself when it is not asked; on one line for csh
_TELLER = "timeout -k 1 10 python3 -uc 'import sys, time; [print(repr(time.time())) for _ in sys.stdin]'"


def measure(session):
    """(offset [s], + = ahead of ours, uncertainty [s]: half of the shortest of many round trips) of the far clock.

    Raises OSError or ValueError when the far side does not answer, FoundError when the connection is lost.
    """
    with contextlib.closing(session.channel(_TELLER, _LIMIT_S)) as channel:
        lines, trips = channel.makefile("r"), []
        for _ in range(_ROUND_TRIPS + 1):  # the first one waits for python3 to start
            sent = time.time()
            channel.sendall(b"\n")
            line = lines.readline()
            received = time.time()
            trips.append((received - sent, float(line) - (sent + received) / 2.0))
        round_trip_s, offset_s = min(trips)
        return offset_s, round_trip_s / 2.0


def judge(offset_s, uncertainty_s, how, server):
    """The Finding for an offset. how: where it comes from, for the text; server: our address, for the cure."""
    code, level = "offset", None
    if abs(offset_s) >= GOOD_S or uncertainty_s > BAD_S:
        code = "offset_large"
        level = RED if abs(offset_s) >= BAD_S and abs(offset_s) > uncertainty_s else YELLOW
    values = {"offset_s": offset_s, "uncertainty_s": uncertainty_s, "uncertainty_ms": 1e3 * uncertainty_s}
    return finding("clock", code, level, offset_text=_offset_text(offset_s), how=how, server=server, **values)


def check(session):
    """The Finding about a machine's clock."""
    answer = session.limited("PATH=$PATH:/usr/sbin chronyc -c -n tracking", _LIMIT_S)
    tracking = parse_tracking(answer.out) if answer.code == 0 else None
    try:
        measured = measure(session)
    except (OSError, ValueError):
        measured = None
    return combine(tracking, measured, session.here)


def combine(tracking, measured, server):
    """The Finding from chrony's ClockState there, and the measured (offset [s], uncertainty [s]); None: not known.

    server: our address.  When they agree, the more certain one counts (chrony's bound contains the way from our own
    clock to its server); else the measurement.
    """
    follows_us = tracking is not None and tracking.synchronised and tracking.reference == server
    if measured is None and not follows_us:
        return finding("clock", "mute")
    offset_s, uncertainty_s = measured or (tracking.offset_s, tracking.error_s)
    how = "measured over ssh"
    if follows_us:
        agree = abs(tracking.offset_s - offset_s) <= tracking.error_s + uncertainty_s
        if agree and tracking.error_s <= uncertainty_s:
            return judge(tracking.offset_s, tracking.error_s, "chrony there follows this computer", server)
        how += "; chrony there follows this computer"
        if not agree:
            how += ", but says " + _offset_text(tracking.offset_s)
    elif tracking is not None:
        how += "; chrony there follows " + (tracking.reference if tracking.synchronised else "no other clock")
    return judge(offset_s, uncertainty_s, how, server)


def _offset_text(offset_s):
    return "%.1f ms %s" % (1e3 * abs(offset_s), "ahead of" if offset_s > 0.0 else "behind")
