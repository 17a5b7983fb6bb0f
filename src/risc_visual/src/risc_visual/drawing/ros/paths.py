"""Paths of several things as markers that rviz gets in pieces."""

from risc_visual.drawing.ros import markers
from risc_visual.drawing.trails import Trail

_REFRESH_S = 1.0  # every piece of a path is sent again in this time
_PIECE_LIFETIME_S = 3.0


class PathDrawing:
    """The paths of all things on one topic."""

    def __init__(self, ns, rgb, width_m, trail_params, rate_hz, index):
        """index: cast.Index of the things' names; rate_hz: how often `draw` is called, about."""
        self._ns, self._rgb, self._width_m, self._params, self._index = ns, rgb, width_m, trail_params, index
        self._turns = max(1, round(_REFRESH_S * rate_hz))
        self._turn = 0
        self._trails = {}

    def draw(self, head, positions_m):
        """Markers to send now. positions_m: dict name -> (3,) [m] at the header's stamp."""
        now_s = head.stamp.to_sec()
        for name, position_m in positions_m.items():
            if markers.is_known(position_m):
                self._trails.setdefault(name, Trail(self._params)).add(now_s, position_m)
        self._turn += 1
        found = []
        for name, trail in self._trails.items():
            pieces = trail.to_send(now_s, self._turn, self._turns)
            look = self._rgb, self._width_m, _PIECE_LIFETIME_S
            found += markers.trail_markers(head, self._ns, self._index[name], pieces, *look)
        return found

    def keep_only(self, names):
        """Forget the paths of all others."""
        self._trails = {name: trail for name, trail in self._trails.items() if name in names}
