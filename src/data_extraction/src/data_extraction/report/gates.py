"""What the estimator and the mocap client refused, and why: from the counters that they publish."""

from collections import Counter, defaultdict
from dataclasses import dataclass

from data_extraction.report.topics import Collector

_FRAMES = "frames"

# How the topic of a node's status ends -> {its counter: what was refused}; its other counters are no decisions.
GATES = {
    "estimator_status": {
        "duplicate_stamps": "frame refused: its stamp is that of the one before",
        "backward_stamps": "frame refused: its stamp is older than the one before",
        "clock_resets": "all windows emptied: the clock of the stamps was set, or no frame came for ten seconds",
        "markers_left_out": "marker left out: the body fits its template without it",
        "misfits": "body refused: its markers do not fit the template",
        "collinear": "body refused: the markers seen lie on one line",
        "tilted": "body refused: upside down, which is taken for swapped markers",
        "outside": "body invisible: outside the arena",
    },
    "mocap_status": {
        "lost": "frame missing in the stream",
        "duplicates": "frame refused: came twice",
        "late": "frame refused: came after its successor",
        "malformed": "datagram refused: malformed",
        "faulty optional parts": "optional part of a frame refused",
        "foreign datagrams": "datagram refused: of another host",
        "stale answers": "answer refused: to an older question",
    },
}
TITLES = {"estimator_status": "states estimation", "mocap_status": "mocap stream"}


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
