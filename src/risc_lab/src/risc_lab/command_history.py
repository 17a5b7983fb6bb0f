"""History of the commands that were really sent to vehicles, for controllers, filters and reports.

A command holds until the next one; before the first one all channels are 0. Compiled code gets a vehicle's record of
`CommandHistory.vehicles`.
"""

import copy
from enum import IntEnum

import numpy as np

from risc_lab.compiled import compiled, record

ROWS = 1024  # of the ring: a second of commands at 1 kHz


class Channel(IntEnum):
    """Columns of a command: the values at which a vehicle settles, with the gains of its loops; NED senses.

    Roll and pitch [rad]; climb rate [m/s, + up] or, of a type that takes thrust, lift in excess of its weight
    [weights]; yaw rate [rad/s].
    """

    PHI, THETA, CLIMB, YAW_RATE = range(4)


CHANNELS = len(Channel)


def history_of(rows):
    """Record of a vehicle: command k is in row k % rows; oldest and newest are values of k."""
    fields = ("times_s", float, (rows,)), ("commands", float, (rows, CHANNELS)), ("oldest", int), ("newest", int)
    return record(*fields)


HISTORY = history_of(ROWS)


def command_of(message):
    """(4,) command of a CommandSent of risc_maap_msgs, of rospy or of the rosbags library."""
    return np.array((message.roll_rad, message.pitch_rad, message.climb, message.yaw_rate_rad_s))


class CommandHistory:
    """The newest commands of each vehicle of a fleet. Times: one clock, that of the sender."""

    def __init__(self, vehicles, rows=ROWS):
        """vehicles: how many. rows: how many commands of each are kept."""
        self.vehicles = np.zeros(vehicles, history_of(rows))
        if vehicles:  # loads the compiled code
            self.append(0, 0.0, np.zeros(CHANNELS))
            self.at(0, 0.0)
        self.clear()

    def of(self, rows):
        """The histories of some of the vehicles, a slice; they share their data."""
        part = copy.copy(self)
        part.vehicles = self.vehicles[rows]
        return part

    def clear(self):
        """Forget everything."""
        self.vehicles["newest"] = self.vehicles["oldest"] = 0
        self.vehicles["times_s"][:, 0] = -np.inf
        self.vehicles["commands"][:, 0] = 0.0

    def append(self, vehicle, time_s, command):
        """Add a command (4,) that holds from time_s on. It replaces later ones, if any: then the clock was set."""
        append_command(self.vehicles[vehicle], time_s, command)

    def at(self, vehicle, time_s):
        """(4,) command in force at a time."""
        history = self.vehicles[vehicle]
        return history.commands[last_by(history, time_s, history.newest) % len(history.times_s)].copy()

    def held(self, vehicle, times_s, longest_s):
        """(n, 4) commands in force at times (n,); NaN where the last one is older than longest_s, or unknown."""
        history = self.vehicles[vehicle]
        rows = np.arange(history.oldest, history.newest + 1) % len(history.times_s)
        sent_s = history.times_s[rows]
        last = np.searchsorted(sent_s, times_s, side="right") - 1
        known = (last >= 0) & (times_s - sent_s[last] <= longest_s)
        return np.where(known[:, None], history.commands[rows[last]], np.nan)


@compiled
def append_command(history, time_s, command):
    """See `CommandHistory.append`."""
    k, rows = last_before(history, time_s) + 1, len(history.times_s)
    history.times_s[k % rows] = time_s
    for channel in range(len(command)):
        history.commands[k % rows, channel] = command[channel]
    history.oldest, history.newest = max(history.oldest, k - rows + 1), k


@compiled
def last_before(history, time_s):
    """k of the last command before time_s, that of the oldest when there is none."""
    k, rows = history.newest, len(history.times_s)
    while k > history.oldest and history.times_s[k % rows] >= time_s:
        k -= 1
    return k


@compiled
def last_by(history, time_s, k):
    """k of the last command that was sent by time_s, searched backwards from k."""
    rows = len(history.times_s)
    while k > history.oldest and history.times_s[k % rows] > time_s:
        k -= 1
    return k
