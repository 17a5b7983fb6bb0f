"""A node for the recorder's tests: publishes as told on standard input, and prints a line when it is done.

Every line is a JSON object: {topics: {name: type}, count, hz}; optional: tag, size [bytes], latch, clock [s].
"""

import json
import sys
import time

import rospy
from rosgraph_msgs.msg import Clock
from roslib.message import get_message_class

from risc_lab.ros.publisher_updates import init_node


def payload(tag, topic, number, size=0):
    """The text of one message."""
    return ("%s %s %d|" % (tag, topic, number)).ljust(size, ".")


def message_of(kind, text):
    """A message of std_msgs that holds the text."""
    return get_message_class(kind)(data=text if kind == "std_msgs/String" else text.encode())


class Talker:
    """Publishers that were used so far, by topic."""

    def __init__(self):
        self._publishers = {}

    def publish(self, topics, count, hz=200.0, tag="", size=0, latch=False, clock=None):
        """Publish `count` messages on each topic. Begins when all have subscribers; at once if latched."""
        publishers = {topic: self._publisher(topic, get_message_class(kind), latch) for topic, kind in topics.items()}
        while True:
            if clock is not None:
                self._publisher("/clock", Clock).publish(rospy.Time.from_sec(clock))
            if latch or all(publisher.get_num_connections() for publisher in publishers.values()):
                break
            time.sleep(0.05)
        next_s = time.monotonic()
        for number in range(count):
            for topic, publisher in publishers.items():
                publisher.publish(message_of(topics[topic], payload(tag, topic, number, size)))
            next_s += 1.0 / hz
            time.sleep(max(0.0, next_s - time.monotonic()))

    def _publisher(self, topic, kind, latch=False):
        if topic not in self._publishers:
            # no queue: publish() returns when the message is in the socket
            self._publishers[topic] = rospy.Publisher(topic, kind, latch=latch, queue_size=None, tcp_nodelay=True)
        return self._publishers[topic]


if __name__ == "__main__":
    init_node("talker", anonymous=True, disable_signals=True, disable_rosout=True)
    talker = Talker()
    for line in sys.stdin:
        talker.publish(**json.loads(line))
        print("published", flush=True)
