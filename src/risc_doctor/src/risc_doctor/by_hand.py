"""Move +x, see +x: the operator moves a body by hand, and motion capture tells which way it went."""

import contextlib

import numpy as np

from risc_doctor.axes import WAYS, judge_moves
from risc_doctor.cortex_probe import EndpointConnection, probe
from risc_doctor.findings import Findings, FoundError

_LOOK_S = 0.5  # averaging time
_BRIEFLY_S = 0.3  # to find out whether the host answers


def position_m(connection, name, metres_per_unit, look_s):
    """Mean (3,) of a body's markers [m]; NaN unless every marker is seen at times: the mean of fewer is elsewhere.

    Raises FoundError when no frame arrives, or none with the body.
    """
    connection.forget_stream()
    frames = [frame for _, frame in connection.stream(look_s, look_s)]
    if len(frames) < 2:
        frames = list(filter(None, (connection.poll() for _ in range(5))))
    if not frames:
        raise FoundError("axes", "body_unseen", error="no frames arrive from Cortex")
    shown = [body.markers_mm for frame in frames for body in frame.bodies if body.name == name]
    if not shown:
        names = ", ".join(body.name for body in frames[-1].bodies)
        error = "Cortex shows no '%s'; it shows %s" % (name, names or "nothing")
        raise FoundError("axes", "body_unseen", error=error)
    stacked = np.stack([markers for markers in shown if markers.shape == shown[-1].shape])
    if not np.isfinite(stacked).all(axis=2).any(axis=0).all():
        return np.full(3, np.nan)
    return np.nanmedian(stacked, axis=0).mean(axis=0) * metres_per_unit


def look(fleet, word, wait_for_enter, look_s=_LOOK_S):
    """Findings after three moves.

    word: a vehicle's namespace or template, or a body of Cortex.  look_s: averaging time [s].
    wait_for_enter: function of a prompt that returns when the operator is ready.
    """
    found = Findings("axes")
    report = probe(fleet.mocap, live=True, listen_s=_BRIEFLY_S)
    if report.error:
        return found.say("no_host", error=report.error)
    name = next((v.template for v in fleet.vehicles if word in (v.namespace, v.template)), word)
    moves = {}
    try:
        with contextlib.closing(EndpointConnection(fleet.mocap)) as connection:
            print("'%s' is moved by hand: half a metre each time, level, and put down again." % name)
            for axis, way in WAYS.items():
                wait_for_enter("+%s: leave it where it is, and press Enter. " % axis)
                before = position_m(connection, name, report.metres_per_unit, look_s)
                wait_for_enter("    move it %s (+%s) by half a metre, hold it still, and press Enter. " % (way, axis))
                moves[axis] = position_m(connection, name, report.metres_per_unit, look_s) - before
                print("    seen: %+.3f %+.3f %+.3f m" % tuple(moves[axis]))
    except FoundError as error:
        return [error.finding]
    except OSError as error:
        return found.say("host_gone", error=error)
    return judge_moves(moves)
