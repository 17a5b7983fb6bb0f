"""How far another computer's clock is from ours: what chrony says there, else measured over the ssh connection."""

import re
import time
from dataclasses import dataclass

from risc_experiments.findings import green, red, yellow

GOOD_S = 0.005  # latency figures of several computers mean something
BAD_S = 0.020  # a fifth of the loss ladder's first limit
LADDER = "the loss ladder takes states older than 100 ms for lost"
_ROUND_TRIPS = 25
_LIMIT_S = 5.0
# one line in, one line out; ends by itself when nobody asks; on one line for csh
_TELLER = "timeout -k 1 10 python3 -uc 'import sys, time; [print(repr(time.time())) for _ in sys.stdin]'"


@dataclass(frozen=True)
class Tracking:
    """What `chronyc -n tracking` says, as far as we need it."""

    source: str  # address of the server that it follows
    synchronised: bool
    offset_s: float  # of its clock from the server's, + = ahead
    error_s: float  # bound of the offset's error


def parse_tracking(text):
    """The Tracking in chronyc's output, None when there is none in it."""
    fields = dict(re.findall(r"^([A-Z][A-Za-z ]*?)\s*: (.*)$", text, re.MULTILINE))
    system = re.match(r"([\d.]+) seconds (fast|slow)", fields.get("System time", ""))
    if system is None:
        return None
    source = re.search(r"\((.*)\)", fields.get("Reference ID", ""))
    delay, dispersion = (re.match(r"[\d.]+", fields.get(key, "")) for key in ("Root delay", "Root dispersion"))
    if source is None or delay is None or dispersion is None:
        return None
    return Tracking(
        source=source.group(1),
        synchronised=fields.get("Leap status", "").strip() != "Not synchronised",
        offset_s=float(system.group(1)) * (1.0 if system.group(2) == "fast" else -1.0),
        error_s=float(dispersion.group()) + float(delay.group()) / 2.0,
    )


def measure(session):
    """(offset [s], its uncertainty [s]) of the far clock, + = ahead of ours: half of the shortest of many round trips.

    Raises OSError or ValueError when the far side does not answer, MachineError when the connection is lost.
    """
    channel = session.channel(_TELLER)
    channel.settimeout(_LIMIT_S)
    try:
        lines = channel.makefile("r")
        best = None
        for _ in range(_ROUND_TRIPS + 1):  # the first one waits for python3 to start
            sent = time.time()
            channel.sendall(b"\n")
            line = lines.readline()
            received = time.time()
            there = float(line)
            if best is None or received - sent < best[1]:
                best = (there - (sent + received) / 2.0, received - sent)
        return best[0], best[1] / 2.0
    finally:
        channel.close()


def judge(offset_s, uncertainty_s, how, server):
    """The Finding for an offset. how: where it comes from, for the text; server: our address, for the cure."""
    text = "%.1f ms %s this computer's (± %.1f ms, %s)" % (
        1e3 * abs(offset_s), "ahead of" if offset_s > 0.0 else "behind", 1e3 * uncertainty_s, how,
    )  # fmt: skip
    cure = (
        "chrony on every machine, with this computer as its server (%s). Here: the line 'allow' in "
        "/etc/chrony/conf.d/base.conf. There: the line 'server %s iburst' in /etc/chrony/sources.d/base.sources, then "
        "sudo systemctl restart chrony && sudo chronyc makestep" % (LADDER, server)
    )
    values = {"offset_s": offset_s, "uncertainty_s": uncertainty_s}
    if abs(offset_s) >= BAD_S and abs(offset_s) > uncertainty_s:
        return red("clock", text, cure, **values)
    if abs(offset_s) >= GOOD_S or uncertainty_s > BAD_S:
        return yellow("clock", text, cure, **values)
    return green("clock", text, **values)


def check(session):
    """The Finding about a machine's clock."""
    answer = session.limited("PATH=$PATH:/usr/sbin chronyc -n tracking", _LIMIT_S)
    tracking = parse_tracking(answer.out) if answer.code == 0 else None
    if tracking is not None and tracking.synchronised and tracking.source == session.here:
        return judge(tracking.offset_s, tracking.error_s, "chrony there follows this computer", session.here)
    how = "measured over ssh"
    if tracking is not None:
        follows = "follows " + tracking.source if tracking.synchronised else "follows nobody"
        how += "; chrony there " + follows
    try:
        offset_s, uncertainty_s = measure(session)
    except (OSError, ValueError):
        return yellow(
            "clock", "the clock there could not be asked", "does `python3 -c 'print()'` work in a login there?"
        )
    return judge(offset_s, uncertainty_s, how, session.here)
