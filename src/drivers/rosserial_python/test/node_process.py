"""serial_node in its own process, for the rostests."""

import itertools
import os
import signal
import subprocess
import time

import roslib.packages
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Log

from risc_lab.ros.heard import publishers_heard
from risc_maap_msgs.msg import SerialLink

LIMIT_S = 30.0
_namespaces = ("/lines%d" % number for number in itertools.count(1))


def wait_for(condition, what):
    deadline_s = time.monotonic() + LIMIT_S
    while not condition():
        if time.monotonic() > deadline_s:
            raise AssertionError("waited %g s for %s" % (LIMIT_S, what))
        time.sleep(0.002)


class Node:
    """serial_node in its own process and namespace, as `arduino`."""

    def __init__(self, *arguments, output=None, **params):
        self.namespace = next(_namespaces)
        self.name = self.namespace + "/arduino"
        rospy.set_param(self.name, params)
        self.links, self.logs, self.status = [], [], []
        self._subscribers = [
            rospy.Subscriber(self.name + "/link", SerialLink, self.links.append, queue_size=100),
            rospy.Subscriber("/rosout", Log, self._on_log, queue_size=1000),
            rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics, queue_size=100),
        ]
        self._publishers = {}
        executable = roslib.packages.find_node("rosserial_python", "serial_node.py")[0]
        self.process = subprocess.Popen(
            [executable, *arguments, "__name:=arduino"],
            env=dict(os.environ, ROS_NAMESPACE=self.namespace),
            stdout=output,
            stderr=subprocess.STDOUT if output else None,
            text=True,
        )

    def _on_log(self, message):
        if message.name == self.name:
            self.logs.append((message.level, message.msg))

    def _on_diagnostics(self, message):
        self.status += [status for status in message.status if status.name.startswith(self.name.lstrip("/") + ":")]

    def listen(self, topic, kind):
        """All messages of the node's topic from now on."""
        messages = []
        name = self.namespace + "/" + topic
        subscriber = rospy.Subscriber(name, kind, messages.append, queue_size=1000, tcp_nodelay=True)
        self._subscribers.append(subscriber)
        wait_for(lambda: publishers_heard(subscriber), "the node to publish " + topic)
        return messages

    def publisher(self, topic, kind):
        """To the node, which listens already."""
        if topic not in self._publishers:
            publisher = rospy.Publisher(self.namespace + "/" + topic, kind, queue_size=100, tcp_nodelay=True)
            wait_for(publisher.get_num_connections, "the node to subscribe to " + topic)
            self._publishers[topic] = publisher
        return self._publishers[topic]

    def wait_state(self, state, cause=None):
        """Until the newest state is this one; returns the message."""
        wait_for(
            lambda: self.links and self.links[-1].state == state and cause in (None, self.links[-1].cause),
            "state %s with cause %s, found %s" % (state, cause, self.links[-1:]),
        )
        return self.links[-1]

    def counter(self, name):
        return {c.name: c.count for c in self.links[-1].counters}[name]

    def said(self, text):
        return any(text in message for _, message in self.logs)

    def end(self):
        """Ctrl-C; the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            return self.process.wait(LIMIT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise
        finally:
            for each in [*self._subscribers, *self._publishers.values()]:
                each.unregister()
