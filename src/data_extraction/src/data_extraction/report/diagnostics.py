"""What nodes tell of themselves on /diagnostics: one way to listen to it, for everybody who does."""

import abc

DIAGNOSTICS = "/diagnostics"


class DiagnosticsCollector(abc.ABC):
    """Takes the messages of a bag one by one and hands their statuses on; its memory does not grow."""

    def wants(self, topic):
        """Whether messages of this topic say anything here."""
        return topic == DIAGNOSTICS

    def __call__(self, topic, _receipt_s, message):
        """Take one message; topics that are of no interest are passed over."""
        if topic == DIAGNOSTICS:
            for status in message.status:
                self.take(status)

    @abc.abstractmethod
    def take(self, status):
        """Take one diagnostic_msgs/DiagnosticStatus."""
