"""What the estimator and the mocap client refused, and why: from the counters that they publish."""

from collections import Counter
from dataclasses import dataclass, field

from data_extraction.report.topics import PerName

# How the topic of a node's status ends -> those of its counters that are decisions (words: templates/sections.html).
GATES = {
    "estimator_status": ("duplicate_stamps", "backward_stamps", "clock_resets", "markers_left_out", "markers_frozen",
                         "misfits", "collinear", "tilted", "jumps", "outside", "swaps_mended", "filled_in",
                         "exchanges"),
    "mocap_status": ("lost", "duplicates", "late", "malformed", "faulty optional parts", "foreign datagrams",
                     "stale answers"),
}  # fmt: skip


@dataclass
class GateCounts:
    """Counters of one node over the bag. They grow while the node lives; after a restart they are added."""

    frames: int = 0  # that it worked on
    refused: Counter = field(default_factory=Counter)  # how often; every gate, also those that refused nothing
    unknown: str = ""  # bodies without a template
    newest: Counter = field(default_factory=Counter)  # as the node told them last

    def grown(self, name, value):
        """How much a counter has grown when it is `value` now: less than before is another life of the node."""
        newest, self.newest[name] = self.newest[name], value
        return value - newest if value >= newest else value


class GateCollector(PerName):
    """By the end of the topic's name."""

    ends = tuple("/" + gate for gate in GATES)

    def __call__(self, topic, _receipt_s, message):
        gate = topic.rpartition("/")[2]
        counts = self.found.setdefault(gate, GateCounts())
        counts.frames += counts.grown("frames", message.frames)
        counts.unknown = ", ".join(getattr(message, "unknown_bodies", ())) or counts.unknown
        told = {counter.name: counter.count for counter in message.counters}
        for name in filter(told.__contains__, GATES[gate]):
            counts.refused[name] += counts.grown(name, told[name])
