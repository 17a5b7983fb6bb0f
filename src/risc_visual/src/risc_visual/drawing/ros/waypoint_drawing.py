"""Waypoints, and the states of vehicles -> the markers of draw_waypoints. Needs no ROS master."""

from risc_visual.drawing.cast import Index, is_news
from risc_visual.drawing.ros import markers
from risc_visual.drawing.ros.paths import PathDrawing
from risc_visual.drawing.trails import TrailParams
from risc_visual.ros.conversions import poses_from_cortex, waypoints_from_msg


class WaypointDrawing:
    """Every method belongs to one topic, each topic may have a thread of its own. now_s: ROS time [s]."""

    def __init__(self, params, names):
        """params: WaypointParams. names: of the vehicles, which get the first ids."""
        self._params = params
        self._numbers = Index((name, 1) for name in names)  # of waypoints
        trail_params = TrailParams(params.trail_s, params.step_m, params.jump_m, params.gap_s)
        self._paths = PathDrawing(
            "way_trail", markers.RED[:3], markers.FLOWN_M, trail_params, params.rate_hz, Index(names)
        )
        self._sent = (frozenset(), 0.0)  # vehicles that have a waypoint, and when it was said; replaced as a whole

    def waypoints(self, msg, now_s):
        """Waypoints -> (balls, headings, labels)."""
        params, head = self._params, markers.header()  # the frame cortex needs no time: waypoints are where they are
        waypoints = waypoints_from_msg(msg)
        self._sent = frozenset(item.name for item in waypoints), now_s
        return tuple(
            draw(head, self._numbers, waypoints, alpha, params.lifetime_s)
            for draw, alpha in (
                (markers.waypoint_markers, params.alpha),
                (markers.heading_markers, params.alpha),
                (markers.waypoint_labels, params.label_alpha),
            )
        )

    def paths(self, msg, now_s):
        """Cortex -> what to send of the paths of the vehicles that have a waypoint."""
        names, said_s = self._sent
        names = names if is_news(said_s, now_s, self._params.lifetime_s) else ()
        self._paths.keep_only(names)
        positions_m = {pose.name: pose.position_m for pose in poses_from_cortex(msg) if pose.visible}
        wanted_m = {name: position_m for name, position_m in positions_m.items() if name in names}
        return self._paths.draw(markers.header(msg.header.stamp), wanted_m)
