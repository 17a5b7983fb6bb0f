"""Paths of several things as markers, sent to rviz in pieces."""

from collections import defaultdict

from risc_visual.drawing.ros.markers import Pen, is_known
from risc_visual.drawing.trails import MAX_PIECES, Trail

_REFRESH_S = 1.0  # every piece of a path is sent again in this time
_PIECE_LIFETIME_S = 3.0
_OLDEST_ALPHA = 0.25  # of a path's oldest piece; the newest is opaque


class PathDrawing:
    """The paths of all things on one topic."""

    def __init__(self, ns, rgb, width_m, duration_s, params, index):
        """duration_s: length of a path. params: params.PathParams with a rate_hz: about the rate of calls to `draw`.

        index: cast.Index of the things' names.
        """
        self._look, self._index = (ns, rgb, width_m), index
        self._trails = defaultdict(lambda: Trail(duration_s, params))
        self._turns = max(1, round(_REFRESH_S * params.rate_hz))
        self._turn = 0

    def draw(self, head, positions_m):
        """Markers to send now: line strips that pale with age. positions_m: dict name -> (3,) [m] at head's stamp."""
        now_s, pen = head.stamp.to_sec(), Pen(_PIECE_LIFETIME_S, head)
        for name, position_m in positions_m.items():
            if is_known(position_m):
                self._trails[name].add(now_s, position_m)
        self._turn += 1
        ns, rgb, width_m = self._look
        found = []
        for name, trail in self._trails.items():
            first = self._index[name] * MAX_PIECES
            for slot, points_m, age in trail.to_send(now_s, self._turn, self._turns):
                alpha = round(1.0 - (1.0 - _OLDEST_ALPHA) * min(1.0, age), 2)  # in steps: shared objects stay few
                found.append(pen.line(ns, first + slot, points_m, width_m, (*rgb, alpha)))
        return found

    def keep_only(self, names):
        """Forget the paths of all others."""
        for name in set(self._trails) - set(names):
            del self._trails[name]
