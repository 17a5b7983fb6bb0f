"""Which computer flies which vehicle, and how old what it answers is there: from the vehicle nodes' diagnostics."""

from dataclasses import dataclass

from data_extraction.report.diagnostics import DiagnosticsCollector
from data_extraction.report.naming import vehicle_of

_OLDEST = "oldest state answered by a command (ms)"
_BEHIND = "clock behind that of the states, at least (ms)"


@dataclass
class Computer:
    """The computer that flies one vehicle."""

    name: str  # host name; after a change: the newest
    oldest_ms: float = 0.0  # largest age of a state, by its stamp and this computer's clock, when a command answered it
    behind_ms: float = 0.0  # by how much its clock is behind that of the stamps, at least; the largest that was told


class ComputerCollector(DiagnosticsCollector):
    """Keeps the worst figures of each vehicle's computer."""

    def __init__(self):
        self._computers = {}

    def take(self, status):
        """Take one DiagnosticStatus; those of other nodes are passed over."""
        node, _, what = status.name.partition(": ")
        values = {pair.key: pair.value for pair in status.values}
        if not what.startswith("vehicle ") or "computer" not in values:
            return
        computer = self._computers.setdefault(vehicle_of(node), Computer(values["computer"]))
        computer.name = values["computer"]
        computer.oldest_ms = max(computer.oldest_ms, float(values.get(_OLDEST, 0.0)))
        computer.behind_ms = max(computer.behind_ms, float(values.get(_BEHIND, 0.0)))

    def computers(self):
        """{vehicle's namespace: Computer} of those that reported."""
        return dict(sorted(self._computers.items()))
