"""How the drawing nodes publish: their markers suit the ground on which they are shown."""

import copy
import functools

import rospy
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from risc_visual.drawing.palette import on_white

LIGHT_PARAM = "/light_ground"  # true: all is drawn on white; read when a node starts


class MarkerPublisher(rospy.Publisher):
    """A publisher of Marker or MarkerArray, whose colours are chosen for a black ground."""

    def __init__(self, topic, kind, **options):
        super().__init__(topic, kind, **options)
        self._light = bool(rospy.get_param(LIGHT_PARAM, False))

    def publish(self, content):
        """content: a Marker, a MarkerArray or a list of Marker; it is not changed."""
        if self._light:
            markers = [content] if isinstance(content, Marker) else getattr(content, "markers", content)
            darker = [_on_white(marker) for marker in markers]
            content = darker[0] if isinstance(content, Marker) else darker
        super().publish(content)


def _on_white(marker):
    marker = copy.copy(marker)
    marker.color = _colour(marker.color.r, marker.color.g, marker.color.b, marker.color.a)
    return marker


@functools.lru_cache(maxsize=1024)
def _colour(red, green, blue, alpha):
    return ColorRGBA(*on_white((red, green, blue)), alpha)
