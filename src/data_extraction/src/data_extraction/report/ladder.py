"""The loss ladder of every vehicle over time, from its safety topic."""

import re
from typing import NamedTuple

from data_extraction.report.naming import vehicle_of
from risc_control.safety import Rung

SAFETY = "/safety"
_MOST_SPANS = 2000  # of one vehicle; the texts of more are not kept


class Span(NamedTuple):
    """A time on one rung."""

    vehicle: str  # namespace
    begin_s: float  # receipt
    end_s: float
    rung: Rung
    reason: str  # "" when OK

    @property
    def kind(self):
        """The reason without the numbers of the moment, e.g. "state … ms old"."""
        return re.sub(r"-?\d+(\.\d+)?", "…", self.reason)


class LadderCollector:
    """Takes the messages of a bag one by one, keeps the changes."""

    def __init__(self):
        self._changes = {}  # vehicle -> [(receipt, text)]
        self.left_out = 0  # changes beyond those that were kept

    def wants(self, topic):
        """Whether messages of this topic say anything here."""
        return topic.endswith(SAFETY)

    def __call__(self, topic, receipt_s, message):
        """Take one message; topics that are of no interest are passed over."""
        if not topic.endswith(SAFETY):
            return
        changes = self._changes.setdefault(vehicle_of(topic), [])
        if changes and changes[-1][1] == message.data:
            return
        if len(changes) < _MOST_SPANS:
            changes.append((receipt_s, message.data))
        else:
            self.left_out += 1

    def spans(self, end_s):
        """{vehicle: [Span, ...]} in the order of time; the last lasts until the end of the bag, at end_s."""
        result = {}
        for vehicle, changes in sorted(self._changes.items()):
            ends = [begin_s for begin_s, _ in changes[1:]] + [end_s]
            result[vehicle] = [
                Span(vehicle, begin_s, end_s, *_parsed(text)) for (begin_s, text), end_s in zip(changes, ends)
            ]
        return result


def _parsed(text):
    """(Rung, reason) of a Verdict's text, e.g. 'hold: state 120 ms old'."""
    word, _, reason = text.partition(":")
    rung = next((rung for rung in Rung if rung.name.lower() == word.strip()), None)
    return (Rung.LAND, text) if rung is None else (rung, reason.strip())
