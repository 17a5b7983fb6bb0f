"""Waypoints, and the states of vehicles -> the markers of draw_waypoints. Needs no ROS master."""

import math
from collections import Counter

from geometry_msgs.msg import Quaternion
from visualization_msgs.msg import Marker

from risc_estimation.ros.bearing_conversions import states_from_msg
from risc_visual.drawing.cast import Index, is_news
from risc_visual.drawing.ros.markers import FLOWN_M, RED, WHITE, Pen, header
from risc_visual.drawing.ros.paths import PathDrawing

_NAMELESS = "waypoint"  # namespace of those that name no vehicle, as in bags of the original release
_ARROW_M = (0.255, 0.07, 0.07)


class WaypointDrawing:
    """Not thread-safe. now_s: ROS time [s]."""

    def __init__(self, params, names):
        """params: WaypointParams. names: of the vehicles, which get the first ids."""
        self._params = params
        self._numbers = Index((name, 1) for name in names)  # of waypoints: (name, which of those with this name)
        self._paths = PathDrawing("way_trail", RED, FLOWN_M, params.trail_s, params, Index(names))
        self._sent = ((), 0.0)  # vehicles that have a waypoint, and the time of that message

    def waypoints(self, msg, now_s):
        """Waypoints -> (balls, arrows of the headings, names): ns = name, id from the index."""
        params, pen = self._params, Pen(self._params.lifetime_s)  # waypoints do not move: no stamp
        rgba, count = WHITE + (params.alpha,), Counter()
        balls, arrows, labels = [], [], []
        for entry in msg.Obj:
            count[entry.name] += 1
            at_m = (entry.x, entry.y, entry.z)
            half_rad = -0.5 * math.radians(entry.heading)  # headings are + clockwise, turns about z the other way
            if not all(map(math.isfinite, (*at_m, half_rad))):
                continue
            what = entry.name or _NAMELESS, self._numbers[entry.name, count[entry.name]]
            balls.append(pen.ball(*what, at_m, 0.17, rgba))
            turn = Quaternion(0.0, 0.0, math.sin(half_rad), math.cos(half_rad))
            arrows.append(pen.marker(*what, Marker.ARROW, at_m, _ARROW_M, rgba, turn))
            labels.append(pen.label(*what, entry.name, at_m, WHITE + (params.label_alpha,)))
        self._sent = [label.text for label in labels], now_s
        return balls, arrows, labels

    def paths(self, msg, now_s):
        """Cortex -> path markers of the vehicles that have a waypoint."""
        names, said_s = self._sent
        names = names if is_news(said_s, now_s, self._params.lifetime_s) else ()
        self._paths.keep_only(names)
        seen = {name: at_m for name, (at_m, _) in states_from_msg(msg).items() if name in names}
        return self._paths.draw(header(msg.header.stamp), seen)
