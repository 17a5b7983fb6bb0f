"""The loss ladder of every vehicle over time, from its safety topic."""

from dataclasses import dataclass, field
from typing import NamedTuple

from data_extraction.report.naming import vehicle_of
from risc_control.failsafe import WITHOUT_EFFECT, FailsafeLevel, Rule

SAFETY = "/safety"
RULES = {
    Rule.NONE: "",
    Rule.JOYSTICK: "joystick silent",
    Rule.STATE: "state too old",
    Rule.CONTROLS: "controls too old",
    Rule.NAVDATA: "navdata too old",
    Rule.FENCE: "leaving the fence",
    Rule.BATTERY: "battery low",
    Rule.SEPARATION: "too near to another vehicle",
    Rule.REQUEST: "landing requested",
}
_MOST_SPANS = 2000  # of one vehicle; of more only landings are kept


class Span(NamedTuple):
    """A time on one level."""

    vehicle: str  # namespace
    begin_s: float  # receipt
    end_s: float
    level: FailsafeLevel
    rule: Rule  # that set the level
    reason: str  # with the numbers of the moment; "" when OK


@dataclass
class _Vehicle:
    """One vehicle's levels so far."""

    said: tuple | None = None  # (level, rule, reason) of the newest message
    rows: list[list] = field(default_factory=list)  # [begin, end, said]; end None = it lasts


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
        level, reason = FailsafeLevel(message.level), message.reason + (WITHOUT_EFFECT if message.operator else "")
        said = level, Rule(message.rule), reason
        if vehicle.said == said:
            return
        vehicle.said, rows = said, vehicle.rows
        lasting = rows[-1] if rows and rows[-1][1] is None else None
        if len(rows) >= _MOST_SPANS and lasting and level == lasting[2][0] == FailsafeLevel.LAND:
            self.left_out += 1  # another reason for the same landing
            return
        if lasting:
            lasting[1] = receipt_s
        if len(rows) < _MOST_SPANS or level == FailsafeLevel.LAND:
            rows.append([receipt_s, None, said])
        else:
            self.left_out += level != FailsafeLevel.OK

    def spans(self, end_s):
        """{vehicle: [Span, ...]} in the order of time; the last lasts until the end of the bag, at end_s."""
        return {
            name: [
                Span(name, begin_s, end_s if until_s is None else until_s, *said)
                for begin_s, until_s, said in vehicle.rows
            ]
            for name, vehicle in sorted(self._vehicles.items())
        }
