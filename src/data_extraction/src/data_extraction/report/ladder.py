"""The loss ladder of every vehicle over time, from its safety topic."""

import re
from dataclasses import dataclass, field
from typing import NamedTuple

from data_extraction.report.naming import vehicle_of
from risc_control.failsafe import FailsafeLevel

SAFETY = "/safety"
_MOST_SPANS = 2000  # of one vehicle; of more only landings are kept


class Span(NamedTuple):
    """A time on one level."""

    vehicle: str  # namespace
    begin_s: float  # receipt
    end_s: float
    level: FailsafeLevel
    reason: str  # "" when OK

    @property
    def kind(self):
        """The reason without the numbers of the moment, e.g. "state … ms old"."""
        return re.sub(r"-?\d+(\.\d+)?", "…", self.reason)


@dataclass
class _Vehicle:
    """One vehicle's levels so far."""

    text: str | None = None  # of the newest message
    rows: list[list] = field(default_factory=list)  # [begin, end, text]; end None = it lasts


class LadderCollector:
    """Takes the messages of a bag one by one, keeps the changes."""

    def __init__(self):
        self._vehicles = {}
        self.left_out = 0  # changes to a higher level, or to another reason there, beyond those that were kept

    def wants(self, topic):
        """Whether messages of this topic say anything here."""
        return topic.endswith(SAFETY)

    def __call__(self, topic, receipt_s, message):
        """Take one message; topics that are of no interest are passed over."""
        if not topic.endswith(SAFETY):
            return
        vehicle = self._vehicles.setdefault(vehicle_of(topic), _Vehicle())
        if vehicle.text == message.data:
            return
        vehicle.text = message.data
        level, rows = _parsed(message.data)[0], vehicle.rows
        lasting = rows[-1] if rows and rows[-1][1] is None else None
        if len(rows) >= _MOST_SPANS and lasting and level == _parsed(lasting[2])[0] == FailsafeLevel.LAND:
            self.left_out += 1  # another reason for the same landing
            return
        if lasting:
            lasting[1] = receipt_s
        if len(rows) < _MOST_SPANS or level == FailsafeLevel.LAND:
            rows.append([receipt_s, None, message.data])
        else:
            self.left_out += level != FailsafeLevel.OK

    def spans(self, end_s):
        """{vehicle: [Span, ...]} in the order of time; the last lasts until the end of the bag, at end_s."""
        return {
            name: [
                Span(name, begin_s, end_s if until_s is None else until_s, *_parsed(text))
                for begin_s, until_s, text in vehicle.rows
            ]
            for name, vehicle in sorted(self._vehicles.items())
        }


def _parsed(text):
    """(FailsafeLevel, reason) of a Verdict's text, e.g. 'hold: state 120 ms old'."""
    word, _, reason = text.partition(":")
    level = next((level for level in FailsafeLevel if level.name.lower() == word.strip()), None)
    return (FailsafeLevel.LAND, text) if level is None else (level, reason.strip())
