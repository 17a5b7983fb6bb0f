"""What the estimator and the mocap client refused, and why: from the counters that they publish."""

from dataclasses import dataclass

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


class GateCollector:
    """Takes the messages of a bag one by one. Counters grow while their node lives; after a restart they are added."""

    def __init__(self):
        self._newest = {}  # {(gate, counter): value}
        self._before = {}  # the same, of lives of the node that have ended
        self._unknown = {}

    def wants(self, topic):
        """Whether messages of this topic say anything here."""
        return topic.rpartition("/")[2] in GATES

    def __call__(self, topic, _receipt_s, message):
        """Take one message; topics that are of no interest are passed over."""
        gate = topic.rpartition("/")[2]
        if gate not in GATES:
            return
        self._note((gate, _FRAMES), message.frames)
        for counter in message.counters:
            if counter.name in GATES[gate]:
                self._note((gate, counter.name), counter.count)
        unknown = getattr(message, "unknown_bodies", ())
        if unknown:
            self._unknown[gate] = ", ".join(unknown)

    def counts(self):
        """{gate: GateCounts} of the nodes that reported."""
        result = {}
        for gate, counters in GATES.items():
            values = {
                key: value + self._before.get((gate, key), 0) for (of, key), value in self._newest.items() if of == gate
            }
            if values:
                refused = {key: values[key] for key in counters if key in values}
                result[gate] = GateCounts(values.get(_FRAMES, 0), refused, self._unknown.get(gate, ""))
        return result

    def _note(self, key, value):
        last = self._newest.get(key, 0)
        if value < last:
            self._before[key] = self._before.get(key, 0) + last
        self._newest[key] = value
