"""The safety ladder of every vehicle over time, from its safety topic."""

from dataclasses import dataclass

from data_extraction.report.recorded_topics import PerName, vehicle_of
from risc_control.safety import WITHOUT_EFFECT, FailsafeLevel, Rule

_MOST_SPANS = 2000  # of one vehicle; beyond that, only landings are kept


@dataclass
class Span:
    """A period on one level."""

    vehicle: str  # namespace
    begin_s: float  # receipt
    end_s: float | None  # None = ongoing
    level: FailsafeLevel
    rule: Rule  # that set the level
    reason: str  # with the numbers of the moment; "" when OK


class LadderCollector(PerName):
    """Keeps the changes: {vehicle: [Span, ...]} in the order of time."""

    ends = ("/safety",)

    def __init__(self):
        super().__init__()
        self._said = {}  # vehicle -> (level, rule, reason) of its newest message
        self.left_out = 0  # changes to a higher level, or to another reason there, beyond those that were kept

    def __call__(self, topic, receipt_s, message):
        name = vehicle_of(topic)
        level, reason = FailsafeLevel(message.level), message.reason + (WITHOUT_EFFECT if message.operator else "")
        said = level, Rule(message.rule), reason
        if self._said.get(name) == said:
            return
        self._said[name], spans = said, self.found.setdefault(name, [])
        lasting = spans[-1] if spans and spans[-1].end_s is None else None
        if len(spans) >= _MOST_SPANS and lasting and level == lasting.level == FailsafeLevel.LAND:
            self.left_out += 1  # another reason for the same landing
            return
        if lasting:
            lasting.end_s = receipt_s
        if len(spans) < _MOST_SPANS or level == FailsafeLevel.LAND:
            spans.append(Span(name, receipt_s, None, *said))
        else:
            self.left_out += level != FailsafeLevel.OK

    def result(self, end_s):
        """{vehicle: [Span, ...]}; an ongoing Span ends with the bag."""
        for spans in self.found.values():
            if spans[-1].end_s is None:
                spans[-1].end_s = end_s
        return super().result(end_s)


def raised(spans_of):
    """The Spans of all vehicles on higher levels, those on the highest first. spans_of: {vehicle: [Span, ...]}."""
    found = [span for spans in spans_of.values() for span in spans if span.level != FailsafeLevel.OK]
    return sorted(found, key=lambda span: (-span.level, span.begin_s))


def by_rule(spans):
    """[((vehicle, level, Rule), [how long each of its Spans lasted [s]]), ...], sorted."""
    lengths_s = {}
    for span in sorted(spans, key=lambda span: span.begin_s):
        lengths_s.setdefault((span.vehicle, span.level, span.rule), []).append(span.end_s - span.begin_s)
    return sorted(lengths_s.items())
