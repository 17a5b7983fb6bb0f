"""Which computer flies which vehicle, and how old what it answers is there: from the status of the vehicle nodes."""

from dataclasses import dataclass

from data_extraction.report.naming import vehicle_of

NODE_STATUS = "/node_status"


@dataclass
class Computer:
    """The computer that flies one vehicle."""

    name: str  # host name; after a change: the newest
    oldest_ms: float = 0.0  # largest age of a state, by its stamp and this computer's clock, when a command answered it
    behind_ms: float = 0.0  # by how much its clock is behind that of the stamps, at least; the largest that was told


class ComputerCollector:
    """Takes the messages of a bag one by one, keeps the worst figures of each vehicle's computer."""

    def __init__(self):
        self._computers = {}

    def wants(self, topic):
        """Whether messages of this topic say anything here."""
        return topic.endswith(NODE_STATUS)

    def __call__(self, topic, _receipt_s, message):
        """Take one message; topics that are of no interest are passed over."""
        if not topic.endswith(NODE_STATUS):
            return
        computer = self._computers.setdefault(vehicle_of(topic), Computer(message.computer))
        computer.name = message.computer
        computer.oldest_ms = max(computer.oldest_ms, 1e3 * message.oldest_state_s)
        computer.behind_ms = max(computer.behind_ms, 1e3 * message.clock_behind_s)

    def computers(self):
        """{vehicle's namespace: Computer} of those that reported."""
        return dict(sorted(self._computers.items()))
