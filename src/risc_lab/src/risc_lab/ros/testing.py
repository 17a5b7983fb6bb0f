"""For tests with a graph: a node in a process of its own that is spoken to by its topics and services."""

import contextlib
import itertools
import os
import signal
import subprocess
import xmlrpc.client

import rosgraph
import roslib.packages
import rospy

from risc_lab.testing import LIMIT_S, wait_for

_UNKNOWN = "unknown"  # the name that rospy gives a publisher until its header has come
_numbers = itertools.count(1)


def publishers_heard(subscriber):
    """Set of the names of the nodes whose every message reaches this rospy.Subscriber from now on; rospy's
    get_num_connections also counts those that it has only decided to call. The nodes are asked, too: a publisher of
    rospy sends its header first, and messages only once it has registered the connection.
    """
    callers = {connection.callerid_pub for connection in subscriber.impl.connections} - {_UNKNOWN}
    return {caller for caller in callers if _sends_to_us(caller, subscriber.resolved_name)}


def _sends_to_us(node, topic):
    ours, connections = rospy.get_name(), ()
    with contextlib.suppress(OSError, rosgraph.MasterException):  # it has ended
        with xmlrpc.client.ServerProxy(rosgraph.Master(ours).lookupNode(node)) as slave:
            _, _, connections = slave.getBusInfo(ours)
    return any((whose, way, what) == (ours, "o", topic) for _, whose, way, _, what, *_ in connections)


class Listener:
    """Collects the messages of a topic."""

    def __init__(self, topic, kind):
        self.messages = []
        self.subscriber = rospy.Subscriber(topic, kind, self.messages.append, queue_size=1000, tcp_nodelay=True)

    def wait_for(self, fits, what, after=0):
        """The first message after the first `after` ones that fits, once it has come."""
        wait_for(lambda: any(map(fits, self.messages[after:])), what)
        return next(filter(fits, self.messages[after:]))

    def nth(self, number):
        """Message `number`, 1 is the first, once it has come."""
        wait_for(lambda: len(self.messages) >= number, "message %d of %s" % (number, self.subscriber.resolved_name))
        return self.messages[number - 1]


class NodeProcess:
    """A node, and our publishers and subscribers on its topics."""

    def __init__(self, group=""):
        """group: the end of its namespace, which is unique."""
        self.namespace = "/node%d%s" % (next(_numbers), group)
        self.received = {}  # {topic: messages}
        self._publishers, self._subscribers = {}, {}

    def start(self, package, program, *arguments, environment=None, output=None):
        """environment: variables in addition to our own.  output: as of Popen, for both streams."""
        self.process = subprocess.Popen(
            [roslib.packages.find_node(package, program)[0], *arguments],
            env=dict(os.environ, ROS_NAMESPACE=self.namespace, **(environment or {})),
            stdout=output,
            stderr=subprocess.STDOUT if output else None,
            text=True,
        )

    def name_of(self, topic):
        """A topic's whole name."""
        return topic if topic.startswith("/") else self.namespace + "/" + topic

    def subscribe(self, topic, kind):
        """All messages of a topic from now on go to the list received[topic]."""
        messages = self.received[topic] = []
        self._subscribers[topic] = rospy.Subscriber(
            self.name_of(topic), kind, messages.append, queue_size=1000, buff_size=1 << 22, tcp_nodelay=True
        )
        return messages

    def listen(self, topic, kind):
        """As `subscribe`, for a topic that the node publishes already: waits, so that no message is missed."""
        messages = self.subscribe(topic, kind)
        wait_for(lambda: publishers_heard(self._subscribers[topic]), "the node publishes " + topic)
        return messages

    def unsubscribe(self, topic):
        """Stop collecting the messages of a topic."""
        self._subscribers.pop(topic).unregister()

    def publisher(self, topic, kind):
        """Publisher to the node, once the node subscribes."""
        if topic not in self._publishers:
            publisher = rospy.Publisher(self.name_of(topic), kind, queue_size=100, tcp_nodelay=True)
            wait_for(publisher.get_num_connections, "the node subscribes to " + topic)
            self._publishers[topic] = publisher
        return self._publishers[topic]

    def publish(self, topic, message):
        self.publisher(topic, type(message)).publish(message)

    def call(self, service, kind, *arguments):
        rospy.wait_for_service(self.name_of(service), LIMIT_S)
        return rospy.ServiceProxy(self.name_of(service), kind)(*arguments)

    def alive(self):
        return self.process.poll() is None

    def end(self, how=signal.SIGINT):
        """Send Ctrl-C; returns the exit code. Our publishers and subscribers end as well."""
        for topic in list(self._subscribers):
            self.unsubscribe(topic)
        if self.alive():
            self.process.send_signal(how)
        try:
            return self.process.wait(LIMIT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise
        finally:
            for publisher in self._publishers.values():
                publisher.unregister()
            self._publishers.clear()
