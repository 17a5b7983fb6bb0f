"""What the estimator and the mocap client refused, and why: from the counters that they publish."""

from collections import Counter, defaultdict
from dataclasses import dataclass

from data_extraction.report.topics import Collector

_FRAMES = "frames"

# How the topic of a node's status ends -> those of its counters that are decisions (words: templates/sections.html).
GATES = {
    "estimator_status": ("duplicate_stamps", "backward_stamps", "clock_resets", "markers_left_out", "misfits",
                         "collinear", "tilted", "outside"),
    "mocap_status": ("lost", "duplicates", "late", "malformed", "faulty optional parts", "foreign datagrams",
                     "stale answers"),
}  # fmt: skip


@dataclass
class GateCounts:
    """Counters of one node over the bag."""

    frames: int  # that it worked on
    refused: dict[str, int]  # counter -> how often; every gate, also those that refused nothing
    unknown: str = ""  # bodies without a template


class GateCollector(Collector):
    """Counters grow while their node lives; after a restart they are added."""

    ends = tuple("/" + gate for gate in GATES)

    def __init__(self):
        self._newest = defaultdict(dict)  # gate -> {counter: value}
        self._before = defaultdict(Counter)  # the same, of lives of the node that have ended
        self._unknown = {}

    def __call__(self, topic, _receipt_s, message):
        gate = topic.rpartition("/")[2]
        counts = {counter.name: counter.count for counter in message.counters if counter.name in GATES[gate]}
        counts[_FRAMES] = message.frames
        newest = self._newest[gate]
        for name, value in counts.items():
            if value < newest.get(name, 0):
                self._before[gate][name] += newest[name]
            newest[name] = value
        unknown = getattr(message, "unknown_bodies", ())
        if unknown:
            self._unknown[gate] = ", ".join(unknown)

    def counts(self):
        """{gate: GateCounts} of the nodes that reported."""
        result = {}
        for gate in filter(self._newest.get, GATES):
            values = {name: value + self._before[gate][name] for name, value in self._newest[gate].items()}
            refused = {name: values[name] for name in GATES[gate] if name in values}
            result[gate] = GateCounts(values[_FRAMES], refused, self._unknown.get(gate, ""))
        return result
