"""Actual states, references and commands of each vehicle, paired by time: for plots and reports. Needs no ROS."""

import math
import operator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from data_extraction.samples import Samples
from risc_lab.phases import phase_words

STATES, TRUTH, REFERENCES, COMMANDS = "/cortex_raw", "/ground_truth", "/trajectory", "/controls"
ON_COURSE = "course"  # the phase in which the course itself is flown
_ALONE = -1  # place of an entry that is the only one of its message


@dataclass
class Series:
    """Samples of one quantity over time."""

    t_s: np.ndarray  # (n,) [s], increasing
    values: np.ndarray  # (n, k)
    receipts_s: np.ndarray | None = None  # (n,) [s] times of receipt
    labels: np.ndarray | None = None  # (n,) name of the course where it stood in place of the vehicle's; "" = none

    def at(self, t_s):
        """Values interpolated at times t_s (m,). Returns (m, k); NaN outside the recorded time."""
        return np.column_stack(
            [np.interp(t_s, self.t_s, column, left=np.nan, right=np.nan) for column in self.values.T]
        )

    def near(self, t_s, gap_s):
        """(whether times t_s (m,) lie between samples at most gap_s apart and with the same label, their labels)."""
        after = np.minimum(np.searchsorted(self.t_s, t_s), len(self.t_s) - 1)
        before = np.maximum(np.where(self.t_s[after] > t_s, after - 1, after), 0)
        near = (self.t_s[before] <= t_s) & (t_s <= self.t_s[after]) & (self.t_s[after] - self.t_s[before] <= gap_s)
        return near & (self.labels[before] == self.labels[after]), self.labels[before]

    def thinned(self, most):
        """A new Series of at most `most` samples, including the first and the last."""
        rows = np.unique(np.linspace(0, len(self.t_s) - 1, min(most, len(self.t_s))).round().astype(int))
        return Series(self.t_s[rows], self.values[rows])


class Recording:
    """Takes messages and assigns their entries to vehicles.

    Entries are those of the messages' `Obj`, in the units of risc_msgs (objects of rospy or of rosbags).
    Vehicles are found by name. The original release put the course's name into `Trajectory.name`, or one vehicle's
    name into all entries, and identified vehicles by their place in the message; the place counts where names repeat
    or none is a vehicle's. It never stamped its trajectories: then times of receipt are used for all topics.
    """

    def __init__(self, fields, limit=None, only=()):
        """fields: {topic: names of an entry's fields to keep}.  limit: most rows of each, see Samples; None = all.

        only: the wanted vehicles; the only entry of a message is taken for the first of them; () = all.
        """
        self._take = {topic: operator.attrgetter(*names) for topic, names in fields.items()}
        self._width = {topic: 2 + len(names) for topic, names in fields.items()}
        self._limit, self._only = limit, only
        self._samples = {topic: {} for topic in fields}  # {(place in Obj[], name): Samples of stamp, receipt, fields}
        self._repeated = set()  # topics that had a name twice in a message
        self._marks = [(-math.inf, "", {}, "")]  # (receipt, course, {vehicle: phase}, phase of others) from then on
        self.order = {}  # the vehicles on STATES, by their first message -> None
        self.unstamped = set()  # topics without stamps

    @property
    def topics(self):
        return self._take.keys()

    def add(self, topic, receipt_s, stamp_s, entries):
        """Take the entries of a message. stamp_s: 0 when it is not stamped."""
        take, samples = self._take[topic], self._samples[topic]
        if not stamp_s:
            self.unstamped.add(topic)
        is_state = topic in (STATES, TRUTH)
        if topic == STATES:
            self.order.update(dict.fromkeys(entry.name for entry in entries))
        elif not is_state and len({entry.name for entry in entries}) < len(entries):
            self._repeated.add(topic)
        for place, entry in enumerate(entries):
            if is_state and not entry.visible:
                continue
            row = (stamp_s or receipt_s, receipt_s, *take(entry))
            if math.isfinite(sum(row)):
                key = (None if is_state else _ALONE if len(entries) == 1 else place, entry.name)
                if key not in samples:
                    samples[key] = Samples(self._width[topic], self._limit)
                samples[key].append(row)

    def phases(self, receipt_s, message):
        """Take a TrajectoryPhases message: the course of the trajectory node, and the phase of each vehicle."""
        _, _, phases, others = self._marks[-1]
        self._mark(receipt_s, message.course, {**phases, **phase_words(message.vehicles)}, others)

    def others_phase(self, receipt_s, word):
        """Set the phase of the vehicles that no trajectory node reports."""
        self._mark(receipt_s, *self._marks[-1][1:3], word)

    def _mark(self, receipt_s, *what):
        if self._marks[-1][1:] != what:
            self._marks.append((receipt_s, *what))

    @property
    def has_phases(self):
        """Whether a trajectory node has reported phases of vehicles."""
        return bool(self._marks[-1][2])

    def told(self, vehicle, receipts_s):
        """(courses, phases) of a vehicle at times of receipt (n,): words, "" where unknown."""
        marks = np.searchsorted([mark[0] for mark in self._marks], receipts_s, side="right") - 1
        courses = np.array([course for _, course, _, _ in self._marks])
        phases = np.array([phases.get(vehicle, others) for _, _, phases, others in self._marks])
        return courses[marks], phases[marks]

    def by_place(self, topic, states):
        """Whether a topic's entries go to vehicles by place, because their names are not vehicles' names (`states`)."""
        names = {name for _, name in self._samples[topic]}
        return topic in (REFERENCES, COMMANDS) and bool(names) and (topic in self._repeated or names.isdisjoint(states))

    def parts(self, topic, states=()):
        """{vehicle: [(label, Samples), ...]} of a topic, without what was forgotten. states: the known vehicles."""
        parts = {}
        by_place = self.by_place(topic, states)
        for (place, name), samples in self._samples[topic].items():
            if not len(samples):
                continue
            places = list(self._only if self._only and place == _ALONE else self.order)
            place = 0 if place == _ALONE else place
            owner = places[place] if by_place and place < len(places) else name
            parts.setdefault(owner, []).append(("" if name == owner or name in states else name, samples))
        return parts

    def forget(self, parts, begin_s, end_s):
        """Delete the rows of [(label, Samples), ...] with begin_s <= time < end_s."""
        for _, samples in parts:
            samples.forget(self.clock, begin_s, end_s)

    def restart(self):
        """Delete all samples, but keep vehicles and phases: the clock is another one, or was set back."""
        self._samples = {topic: {} for topic in self._take}

    @property
    def clock(self):
        """Column of the Samples that holds the times: stamps, or receipts when a topic has no stamps."""
        return 1 if self.unstamped else 0

    def series(self, parts):
        """Series of [(label, Samples), ...] in the order of time."""
        table = np.vstack([samples.table() for _, samples in parts])
        labels = np.repeat([label for label, _ in parts], [len(samples) for _, samples in parts])
        t_s, first = np.unique(table[:, self.clock], return_index=True)
        return Series(t_s, table[first, 2:], table[first, 1], labels[first])


def best_shift(cost, shifts_s):
    """(time shift [s] of the least cost, that cost, the largest on the grid). shifts_s: (n,) uniform starting grid."""
    costs = [cost(shift_s) for shift_s in shifts_s]
    best_s, step_s = shifts_s[int(np.argmin(costs))], shifts_s[1] - shifts_s[0]
    found = minimize_scalar(cost, bounds=(best_s - step_s, best_s + step_s), method="bounded")
    return float(found.x), float(found.fun), max(costs)
