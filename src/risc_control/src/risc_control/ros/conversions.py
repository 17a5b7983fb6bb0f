"""Messages <-> arrays, once. States are degrees on the wire and radians inside; entries are found by name."""

import math

import numpy as np

from risc_lab.command_history import command_of
from risc_lab.compiled import compiled
from risc_lab.ros.clock import ros_time_s
from risc_lab.ros.fleet_messages import ControlsArrays, CortexArrays, TrajectoriesArrays
from risc_lab.states import S, States
from risc_maap_msgs.msg import CommandSent, TrajectoryDerivatives

_RAD_PER_DEG = math.pi / 180.0


class StatesReader:
    """Reads the states of these vehicles, and of the bodies that they carry, from messages of /cortex_raw."""

    def __init__(self, names, carried=()):
        """carried: name of the body that each vehicle carries, None if none; () if no bodies are wanted."""
        self._names, self._carried = tuple(names), tuple(carried) if any(carried) else ()
        self.bodies = None  # `controllers.Bundle.bodies` of the newest message; None when no vehicle carries anything
        self._message = CortexArrays(())
        self._adopt()
        self._states()

    def read(self, buff):
        """(header, States of the vehicles in the order of the names) of a message's bytes.

        A vehicle that the message lacks, or whose numbers are not finite, is not visible, and its numbers are 0; so are
        those of `bodies`.
        """
        message = self._message.deserialize(buff)
        if message.data is not self._data:
            self._adopt()
        return message.header, self._states()

    def _adopt(self):
        """Find the rows of our vehicles again: the entries of the message have changed."""
        message = self._message
        self._data, self._degrees, self._seen = message.data, message.states, message.visible
        at = {name: row for row, name in enumerate(message.names)}
        self._rows = np.array([at.get(name, -1) for name in self._names + self._carried], dtype=np.intp)
        self.unknown = sorted(set(at) - {*self._names, *self._carried})  # names of the newest message, not ours

    def _states(self):
        visible, x = np.empty(len(self._rows), dtype=bool), np.empty((len(self._rows), len(S)))
        _pick_states(self._degrees, self._seen, self._rows, visible, x)
        if not self._carried:
            return States(visible, x)
        n = len(self._names)
        self.bodies = States(visible[n:], x[n:])
        return States(visible[:n], x[:n])


def covariances_of(message, index):
    """(n, 12, 12) as `controllers.Bundle.covariances` of a StateCovariances.  index: {name: row}."""
    found = np.full((len(index), len(S), len(S)), np.nan)
    for body in message.bodies:
        if body.name in index:
            found[index[body.name]] = np.reshape(body.covariance, (len(S), len(S)))
    return found


@compiled
def _pick_states(degrees, seen, rows, visible, x):
    """Fill visible (n,) and x (n, 12) from the rows of a message; row -1: not there."""
    for i in range(len(rows)):
        row = rows[i]
        total = 0.0
        for k in range(x.shape[1]):
            value = degrees[row, k] if row >= 0 else 0.0
            total += value
            x[i, k] = value if k < S.PHI else value * _RAD_PER_DEG
        visible[i] = row >= 0 and seen[row] and math.isfinite(total)
        if not visible[i]:
            x[i] = 0.0


def note_commands(message, index, history, tolerance_s):
    """Note a CommandsSent in a CommandHistory. Returns how many of its commands were noted.

    index: {name of a vehicle: its row}.  tolerance_s: commands whose time differs from our clock by more are skipped.
    """
    now_s, noted = ros_time_s(), 0
    for command in message.commands:
        i, sent_s = index.get(command.name), command.sent.to_sec()
        if i is not None and abs(now_s - sent_s) <= tolerance_s:
            history.append(i, sent_s, command_of(command))
            noted += 1
    return noted


class StatesMessage:
    """A Cortex message of these vehicles, filled again and again."""

    def __init__(self, names):
        self._message = CortexArrays(names)

    def fill(self, header, states):
        """The message with these States, with the stamp and frame of a header."""
        message = self._message
        message.header.stamp, message.header.frame_id = header.stamp, header.frame_id
        message.visible[:] = states.visible
        message.states[:] = states.x
        message.states[:, S.PHI :] /= _RAD_PER_DEG
        return message


class ControlsMessage:
    """A Controls message for these vehicles, filled again and again."""

    def __init__(self, names, frame_id="cortex"):
        self._names, self._frame_id = tuple(names), frame_id
        self._message = self._of(self._names)
        nothing, everyone = np.zeros(len(self._names)), np.ones(len(self._names), dtype=bool)
        self.fill(self._message.header.stamp, [nothing] * 4, everyone)  # loads the compiled code

    def _of(self, names):
        message = ControlsArrays(names)
        message.header.frame_id = self._frame_id
        return message

    def fill(self, stamp, fractions, known):
        """The message with these `vehicles.Controls` (arrays (n,)) of the vehicles that are known (n,) bool."""
        names = self._names
        if np.count_nonzero(known) < len(known):
            names = tuple(name for name, is_known in zip(names, known) if is_known)
        if self._message.names != names:
            self._message = self._of(names)
        self._message.header.stamp = stamp
        _fill_rows(*fractions, known, self._message.controls)
        return self._message


@compiled
def _fill_rows(phi, theta, psi, thrust, known, rows):
    """Fill rows (known, 4) of a message from arrays (n,), where known (n,) bool."""
    row = 0
    for i in range(len(known)):
        if known[i]:
            rows[row, 0], rows[row, 1], rows[row, 2], rows[row, 3] = phi[i], theta[i], psi[i], thrust[i]
            row += 1


class TrajectoriesMessage:
    """A Trajectories message for these vehicles, filled again and again."""

    def __init__(self, names, frame_id="cortex"):
        self._message = TrajectoriesArrays(names)
        self._message.header.frame_id = frame_id
        self._derivatives = self._message.derivatives

    def fill(self, stamp, derivatives):
        """The message with derivatives (3 or more, n, 4): position, velocity, acceleration of x, y, z, psi."""
        self._message.header.stamp = stamp
        self._derivatives[:] = derivatives[:3].transpose(1, 0, 2)
        return self._message


def derivatives_message(stamp, names, derivatives):
    """A TrajectoryDerivatives message of derivatives (orders, n, 4) of these vehicles."""
    message = TrajectoryDerivatives(names=names, derivatives=derivatives.ravel())
    message.header.stamp, message.header.frame_id = stamp, "cortex"
    return message


def command_sent(name, sent, answers, command, level):
    """CommandSent of an array (4,), columns `command_history.Channel`, and the vehicle's failsafe level."""
    return CommandSent(name, sent, answers, *command.tolist(), level)
