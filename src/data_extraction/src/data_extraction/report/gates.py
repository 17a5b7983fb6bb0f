"""What the estimator and the mocap client refused, and why: from their counters on /diagnostics."""

from dataclasses import dataclass

from data_extraction.report.diagnostics import DiagnosticsCollector

FRAMES = "frames"

# How the status of a node ends -> {its counter: what was refused}; the rest of a status are no decisions.
GATES = {
    "states estimation": {
        "duplicate_stamps": "frame refused: its stamp is that of the one before",
        "backward_stamps": "frame refused: its stamp is older than the one before",
        "clock_resets": "all windows emptied: the clock of the stamps was set, or no frame came for ten seconds",
        "markers_left_out": "marker left out: the body fits its template without it",
        "misfits": "body refused: its markers do not fit the template",
        "collinear": "body refused: the markers seen lie on one line",
        "tilted": "body refused: upside down, which is taken for swapped markers",
        "outside": "body invisible: outside the arena",
    },
    "mocap stream": {
        "lost": "frame missing in the stream",
        "duplicates": "frame refused: came twice",
        "late": "frame refused: came after its successor",
        "malformed": "datagram refused: malformed",
        "faulty optional parts": "optional part of a frame refused",
        "foreign datagrams": "datagram refused: of another host",
        "stale answers": "answer refused: to an older question",
    },
}


@dataclass
class GateCounts:
    """Counters of one node over the bag."""

    frames: int  # that it worked on
    refused: dict[str, int]  # counter -> how often; every gate, also those that refused nothing
    unknown: str = ""  # bodies without a template


class GateCollector(DiagnosticsCollector):
    """Counters grow while their node lives; after a restart they are added."""

    def __init__(self):
        self._newest = {}  # {(gate, counter): value}
        self._before = {}  # the same, of lives of the node that have ended
        self._unknown = {}

    def take(self, status):
        """Take one DiagnosticStatus; those without gates are passed over."""
        gate = next((gate for gate in GATES if status.name.endswith(gate)), None)
        if gate is None:
            return
        for pair in status.values:
            if pair.key == FRAMES or pair.key in GATES[gate]:
                self._note((gate, pair.key), pair.value)
            elif pair.key == "unknown bodies" and pair.value != "none":
                self._unknown[gate] = pair.value

    def counts(self):
        """{gate: GateCounts} of the nodes that reported."""
        result = {}
        for gate, counters in GATES.items():
            values = {
                key: value + self._before.get((gate, key), 0) for (of, key), value in self._newest.items() if of == gate
            }
            if values:
                refused = {key: values[key] for key in counters if key in values}
                result[gate] = GateCounts(values.get(FRAMES, 0), refused, self._unknown.get(gate, ""))
        return result

    def _note(self, key, text):
        if not text.isdigit():
            return
        value, last = int(text), self._newest.get(key, 0)
        if value < last:
            self._before[key] = self._before.get(key, 0) + last
        self._newest[key] = value
