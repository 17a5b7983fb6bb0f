"""What the estimator and the mocap client rejected, and why: from the counters that they publish."""

from collections import Counter
from dataclasses import dataclass, field

from data_extraction.report.recorded_topics import PerName

# End of the topic of a node's status -> those of its counters that are decisions (texts: templates/sections.html).
GATES = {
    "estimator_status": ("duplicate_stamps", "backward_stamps", "clock_resets", "markers_left_out", "markers_frozen",
                         "misfits", "collinear", "tilted", "jumps", "outside", "swaps_mended", "filled_in",
                         "exchanges"),
    "mocap_status": ("lost", "duplicates", "late", "malformed", "faulty optional parts", "foreign datagrams",
                     "stale answers"),
}  # fmt: skip


@dataclass
class GateCounts:
    """Counters of one node over the bag. They restart with the node; its runs are added up."""

    frames: int = 0  # that it processed
    refused: Counter = field(default_factory=Counter)  # gate -> rejections; also gates that rejected nothing
    unknown: str = ""  # bodies without a template
    newest: Counter = field(default_factory=Counter)  # as the node last reported them

    def grown(self, name, value):
        """Increase of a counter to `value`; a lower value than before means that the node was restarted."""
        newest, self.newest[name] = self.newest[name], value
        return value - newest if value >= newest else value


class GateCollector(PerName):
    """Collects GateCounts by the end of the topic's name."""

    ends = tuple("/" + gate for gate in GATES)

    def __call__(self, topic, _receipt_s, message):
        gate = topic.rpartition("/")[2]
        counts = self.found.setdefault(gate, GateCounts())
        counts.frames += counts.grown("frames", message.frames)
        counts.unknown = ", ".join(getattr(message, "unknown_bodies", ())) or counts.unknown
        told = {counter.name: counter.count for counter in message.counters}
        for name in filter(told.__contains__, GATES[gate]):
            counts.refused[name] += counts.grown(name, told[name])
