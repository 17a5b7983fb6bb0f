"""serial_node in its own process, for the rostests."""

import rospy
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Log

from risc_lab.ros.testing import NodeProcess, wait_for
from risc_maap_msgs.msg import SerialLink

LATE_S = 0.15  # allowed delay of noticing a loss, as the median of several: a busy computer runs other programs first


class Node(NodeProcess):
    """serial_node as `arduino`. params: its private parameters."""

    def __init__(self, *arguments, output=None, **params):
        super().__init__()
        self.name = self.namespace + "/arduino"
        rospy.set_param(self.name, params)
        self.logs, self.status = [], []
        self.links = self.subscribe(self.name + "/link", SerialLink)
        self._others = [
            rospy.Subscriber("/rosout", Log, self._on_log, queue_size=1000),
            rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics, queue_size=100),
        ]
        self.start("rosserial_python", "serial_node.py", *arguments, "__name:=arduino", output=output)

    def _on_log(self, message):
        if message.name == self.name:
            self.logs.append((message.level, message.msg))

    def _on_diagnostics(self, message):
        self.status += [status for status in message.status if status.name.startswith(self.name.lstrip("/") + ":")]

    def wait_state(self, state, cause=None):
        """Wait until the newest state is this one; return the message."""
        wait_for(
            lambda: self.links and self.links[-1].state == state and cause in (None, self.links[-1].cause),
            "state %s with cause %s, found %s" % (state, cause, self.links[-1:]),
        )
        return self.links[-1]

    def loss(self, cut):
        """Call cut(); return the first message that reports the loss of the link."""
        before = len(self.links)
        cut()
        wait_for(lambda: any(link.state == SerialLink.WAITING for link in self.links[before:]), "the loss")
        return next(link for link in self.links[before:] if link.state == SerialLink.WAITING)

    def counter(self, name):
        return {c.name: c.count for c in self.links[-1].counters}[name]

    def said(self, text):
        return any(text in message for _, message in self.logs)

    def end(self):
        try:
            return super().end()
        finally:
            for each in self._others:
                each.unregister()
