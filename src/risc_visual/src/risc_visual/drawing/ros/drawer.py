"""Common parts of the drawing nodes: the newest messages in, markers out in colours that suit the background."""

import copy
import functools
import threading

import rospy
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from risc_lab.ros.paced_subscriber import PacedSubscriber
from risc_visual.drawing.palette import on_white
from risc_visual.ros.node import Health

LIGHT_PARAM = "/light_ground"  # true: all is drawn on white; read when a node starts


class Drawer:
    """Draws the newest message of each topic repeatedly, one at a time: drawing needs no locks."""

    def __init__(self, name, inputs, rate_hz, optional=False):
        """name, inputs, optional: as of Health, which counts what is drawn. rate_hz: of drawing."""
        self._health, self._inputs = Health(name, inputs, optional), inputs
        self._rate_hz = rate_hz
        self._lock = threading.Lock()

    def on(self, topic, kind, draw, *publishers, rate_hz=None):
        """Publish what draw(message) returns, None for nothing; with several publishers it returns an item for each."""

        def on_message(message):
            with self._lock:
                found = draw(message)
            for publisher, content in zip(publishers, found if len(publishers) > 1 else (found,)):
                if content is not None:
                    publisher.publish(content)
            if topic in self._inputs:
                self._health.drawn(topic)

        PacedSubscriber(topic, kind, on_message, rate_hz or self._rate_hz)


class MarkerPublisher(rospy.Publisher):
    """Publisher of Marker or MarkerArray; their colours suit a black ground, and are converted for a white one."""

    def __init__(self, topic, kind, **options):
        super().__init__(topic, kind, **options)
        self._light = bool(rospy.get_param(LIGHT_PARAM, False))

    def publish(self, content):
        """content: a Marker, or a list of Marker for a MarkerArray; it is not changed."""
        if self._light:
            content = _on_white(content) if isinstance(content, Marker) else list(map(_on_white, content))
        super().publish(content)


def _on_white(marker):
    marker = copy.copy(marker)
    marker.color = _colour(marker.color.r, marker.color.g, marker.color.b, marker.color.a)
    return marker


@functools.lru_cache(maxsize=1024)
def _colour(red, green, blue, alpha):
    return ColorRGBA(*on_white((red, green, blue)), alpha)
