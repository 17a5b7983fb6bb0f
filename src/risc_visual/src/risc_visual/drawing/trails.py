"""Paths of moving things, kept in pieces so that only the end has to be sent again. Needs no ROS."""

from collections import deque
from dataclasses import dataclass
from math import dist

PIECE_POINTS = 25
MAX_PIECES = 64  # of one path; with the pieces' points this bounds what a path costs


@dataclass
class Piece:
    """A stretch of a path without a break."""

    slot: int  # 0 .. MAX_PIECES - 1, the same as long as the piece lives
    points_m: list[tuple[float, float, float]]
    newest_s: float
    sent: bool = False  # has been handed out in its final shape


class Trail:
    """The path of one thing. Frame and clock are the caller's."""

    def __init__(self, duration_s, params):
        """duration_s: what is older is forgotten. params: params.PathParams."""
        self._duration_s, self._params = duration_s, params
        self._pieces = deque(maxlen=MAX_PIECES)
        self._count = 0
        self._end = None  # (stamp [s], position (3,) [m]) newest position

    def add(self, stamp_s, position_m):
        """Add a position (3,) [m]. A stamp before the last one (a bag that starts again) clears the path."""
        (last_s, last_m), self._end = self._end or (stamp_s, position_m), (stamp_s, position_m)
        if stamp_s < last_s:
            self._pieces.clear()
        near = stamp_s - last_s <= self._params.gap_s and dist(position_m, last_m) <= self._params.jump_m
        if not (near and self._pieces):
            self._begin_piece()
            return
        piece = self._pieces[-1]
        piece.newest_s = stamp_s
        if dist(position_m, piece.points_m[-1]) >= self._params.step_m:
            piece.points_m.append(position_m)
            if len(piece.points_m) >= PIECE_POINTS:
                self._begin_piece()  # starts where the last one ends: no gap to be seen

    def _begin_piece(self):
        """Begin a piece at the newest position; if there are too many, the oldest is dropped."""
        stamp_s, position_m = self._end
        self._pieces.append(Piece(self._count % MAX_PIECES, [position_m], stamp_s))
        self._count += 1

    def to_send(self, now_s, turn, turns):
        """Pieces to send in this turn: the growing one, those just finished, and each of the others once in `turns`
        turns, so that their markers do not expire.

        now_s: time on the clock of the stamps [s]. Returns a list of (slot, points [m], age), age being that of the
        newest point as a fraction of the path's duration; what is older than the duration is forgotten.
        """
        while self._pieces and self._pieces[0].newest_s < now_s - self._duration_s:
            self._pieces.popleft()
        chosen = []
        for piece in self._pieces:
            growing = piece is self._pieces[-1]
            if not growing and piece.sent and (turn + piece.slot) % turns:
                continue
            piece.sent = not growing
            points_m = piece.points_m + [self._end[1]] if growing else piece.points_m
            if len(points_m) > 1:
                age = (now_s - piece.newest_s) / self._duration_s
                chosen.append((piece.slot, points_m, max(0.0, age)))
        return chosen
