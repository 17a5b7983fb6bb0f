"""Move +x, see +x: the operator moves a body by hand, and motion capture tells which way it went."""

import numpy as np

from risc_doctor.axes import WAYS, judge_moves
from risc_doctor.cortex_probe import connect, probe
from risc_doctor.findings import red

_LOOK_S = 0.5  # mean of so many seconds
_BRIEFLY_S = 0.3  # is the host there at all?


class NotSeenError(Exception):
    """The body cannot be looked at; the text says why."""


def body_of(fleet, word):
    """Name of the body that is meant: a vehicle's namespace or template, else a body of Cortex as it is."""
    for vehicle in fleet.vehicles:
        if word in (vehicle.namespace, vehicle.template):
            return vehicle.template
    return word


def position_m(connection, name, metres_per_unit, look_s):
    """Where the body is now: (3,) [m], NaN when it is not seen. Only markers that are seen all the time count.

    Raises NotSeenError when no frame comes.
    """
    connection.forget_stream()
    frames = [frame for _, frame in connection.stream(look_s, look_s)]
    if len(frames) < 2:
        polled = [connection.poll() for _ in range(5)]
        frames = [frame for frame in polled if frame is not None]
    if not frames:
        raise NotSeenError("no frame comes from Cortex")
    shown = [body.markers_mm for frame in frames for body in frame.bodies if body.name == name]
    if not shown:
        names = ", ".join(body.name for body in frames[-1].bodies)
        raise NotSeenError("Cortex shows no '%s'; it shows %s" % (name, names or "nothing"))
    stacked = np.stack([markers for markers in shown if markers.shape == shown[-1].shape])
    return _centre(stacked) * metres_per_unit


def _centre(stacked):
    """Mean of the markers' medians; NaN unless every marker is seen, as the middle of fewer lies elsewhere."""
    seen = np.isfinite(stacked).all(axis=2)
    if not seen.any(axis=0).all():
        return np.full(3, np.nan)
    return np.nanmedian(stacked, axis=0).mean(axis=0)


def look(fleet, word, wait_for_enter, look_s=_LOOK_S, out=None):
    """Findings after three moves.

    wait_for_enter: function of a prompt that returns when the operator is ready. look_s: how long a look takes [s].
    out: text stream for what is seen, None = stdout.
    """
    report = probe(fleet.mocap, live=True, listen_s=_BRIEFLY_S)
    if report.error:
        cure = "./maap doctor --only network,ports,cortex"
        return [red("axes", "Cortex does not answer: %s" % report.error, cure)]
    name = body_of(fleet, word)
    moves = {}
    connection, _, _ = connect(fleet.mocap)
    try:
        print("'%s' is moved by hand: half a metre each time, level, and put down again." % name, file=out)
        for axis, way in WAYS.items():
            wait_for_enter("+%s: leave it where it is, and press Enter. " % axis)
            before = position_m(connection, name, report.metres_per_unit, look_s)
            wait_for_enter("    move it %s (+%s) by half a metre, hold it still, and press Enter. " % (way, axis))
            after = position_m(connection, name, report.metres_per_unit, look_s)
            moves[axis] = after - before
            print("    seen: %+.3f %+.3f %+.3f m" % tuple(moves[axis]), file=out)
    except NotSeenError as error:
        return [red("axes", str(error), "put it into view; is Cortex live? ./maap doctor --only cortex,templates")]
    except OSError as error:
        return [red("axes", "Cortex has gone: %s" % error, "start it again; ./maap doctor --only network,cortex")]
    finally:
        connection.close()
    return judge_moves(moves)
