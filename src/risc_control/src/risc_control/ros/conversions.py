"""Messages <-> arrays, once. States are degrees on the wire and radians inside; entries are found by name."""

import numpy as np

from risc_control.states import S, States
from risc_msgs.msg import Control, Controls, Trajectories, Trajectory

_TO_RAD = np.array([1.0] * 6 + [np.pi / 180.0] * 6)


def states_from_msg(message, index):
    """(States of the vehicles in `index`, names of the message that are not in it).

    index: dict name -> row.  A vehicle that the message lacks, or whose numbers are not finite, is not visible.
    """
    rows = np.zeros((len(index), len(S)))
    visible = np.zeros(len(index), dtype=bool)
    unknown = []
    for s in message.Obj:
        i = index.get(s.name)
        if i is None:
            unknown.append(s.name)
        elif s.visible:
            rows[i] = s.x, s.y, s.z, s.u, s.v, s.w, s.phi, s.theta, s.psi, s.p, s.q, s.r
            visible[i] = True
    rows *= _TO_RAD
    if not np.isfinite(rows.sum()):
        broken = ~np.isfinite(rows).all(axis=1)
        rows[broken], visible[broken] = 0.0, False
    return States(visible, rows), unknown


class ControlsMessage:
    """A Controls message for these vehicles, filled again and again."""

    def __init__(self, names, frame_id="cortex"):
        self._entries = [Control(name=name) for name in names]
        self._message = Controls()
        self._message.header.frame_id = frame_id

    def fill(self, stamp, fractions, known):
        """The message with these Fractions (arrays (n,)) of the vehicles that are known (n,) bool."""
        self._message.header.stamp = stamp
        rows = zip(*(part.tolist() for part in fractions))
        for entry, row in zip(self._entries, rows):
            entry.phi, entry.theta, entry.psi, entry.T = row
        self._message.Obj = [entry for entry, is_known in zip(self._entries, known) if is_known]
        return self._message


class TrajectoriesMessage:
    """A Trajectories message for these vehicles, filled again and again."""

    def __init__(self, names, frame_id="cortex"):
        self._message = Trajectories(Obj=[Trajectory(name=name) for name in names])
        self._message.header.frame_id = frame_id

    def fill(self, stamp, derivatives):
        """The message with derivatives (3 or more, n, 4): position, velocity, acceleration of x, y, z, psi."""
        self._message.header.stamp = stamp
        rows = derivatives[:3].transpose(1, 0, 2).reshape(-1, 12).tolist()
        for entry, row in zip(self._message.Obj, rows):
            entry.x, entry.y, entry.z, entry.psi, entry.xdot, entry.ydot, entry.zdot, entry.psidot = row[:8]
            entry.xddot, entry.yddot, entry.zddot, entry.psiddot = row[8:]
        return self._message


def sample_from_msg(message):
    """(names, (3, n, 4) position, velocity, acceleration of x, y, z, psi) of a Trajectories message."""
    rows = [
        (
            (t.x, t.y, t.z, t.psi),
            (t.xdot, t.ydot, t.zdot, t.psidot),
            (t.xddot, t.yddot, t.zddot, t.psiddot),
        )
        for t in message.Obj
    ]
    return tuple([t.name for t in message.Obj]), np.array(rows, dtype=float).reshape(-1, 3, 4).swapaxes(0, 1)
