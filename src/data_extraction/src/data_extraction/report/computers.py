"""Which computer flies which vehicle, and how old the states are that it answers: from the vehicle nodes' status."""

from dataclasses import dataclass

from data_extraction.report.recorded_topics import PerName, vehicle_of


@dataclass
class Computer:
    """The computer that flies one vehicle."""

    name: str  # host name; after a change: the newest
    oldest_ms: float = 0.0  # largest age of a state, by its stamp and this computer's clock, when a command answered it
    behind_ms: float = 0.0  # least amount by which its clock is behind that of the stamps; the largest reported


class ComputerCollector(PerName):
    """Keeps the worst figures of each vehicle's computer."""

    ends = ("/node_status",)

    def __call__(self, topic, _receipt_s, message):
        computer = self.found.setdefault(vehicle_of(topic), Computer(message.computer))
        computer.name = message.computer
        computer.oldest_ms = max(computer.oldest_ms, 1e3 * message.oldest_state_s)
        computer.behind_ms = max(computer.behind_ms, 1e3 * message.clock_behind_s)
