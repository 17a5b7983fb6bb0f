"""What motion capture lost, and where in the arena: markers, whole vehicles, frames."""

import math
from array import array
from dataclasses import dataclass, field, replace

import numpy as np

from data_extraction.flatten import seconds
from risc_lab.lab.arena import Arena

MOCAP, STATES = "/mocap_data", "/cortex_raw"
CELL_M = 0.25  # side of a cell of the map
MARKER_LIMIT_M = 100.0  # larger coordinates mean "lost" (9999.999 m in bags of the original release)
LEAST_MARKERS = 400  # a cell with fewer says nothing: half a second of one vehicle at 200 Hz
GAP_S = 0.1  # a longer time between two frames is a gap of the stream
_MOST_PLACES = 2000  # of one vehicle, that are drawn


@dataclass
class MarkerLoss:
    """Markers of one object."""

    markers: int = 0  # seen or not, over all frames
    lost: int = 0
    frames: int = 0
    blind_frames: int = 0  # without a single marker


@dataclass
class Invisibility:
    """Times at which the estimator said that it did not see a vehicle, after it had seen it once."""

    frames: int = 0
    invisible: int = 0
    times: int = 0  # how often it began
    longest_s: float = 0.0


@dataclass
class Drops:
    """All that was lost."""

    markers: dict[str, MarkerLoss]  # object -> its markers
    vehicles: dict[str, Invisibility]
    seen_map: np.ndarray  # (x, y) markers seen in each cell of the arena, cortex frame; see `cell_edges`
    lost_map: np.ndarray  # (x, y) markers lost there: by the object's other markers, else by its last known place
    unplaced: int  # markers lost of objects that were never seen before
    lost_places_m: np.ndarray  # (n, 2) [m] where vehicles became invisible
    frames: int  # of the stream
    gaps: int
    longest_gap_s: float | None  # None = there was no frame
    silent_end_s: float  # how long before the bag's end the last frame came; a gap when it is longer than one

    @property
    def least_markers(self):
        """How many markers a cell needs to be drawn."""
        return min(LEAST_MARKERS, int((self.seen_map + self.lost_map).max()))

    @property
    def markers_lost(self):
        """How many markers of all objects were lost."""
        return sum(loss.lost for loss in self.markers.values())


@dataclass
class _Watched:
    """What is remembered of a vehicle from one frame to the next."""

    seen: bool = False
    lost_since_s: float | None = None
    totals: Invisibility = field(default_factory=Invisibility)

    def until(self, end_s):
        """Invisibility of all the time until end_s [s], which is a stamp."""
        if self.lost_since_s is None:
            return self.totals
        return replace(self.totals, longest_s=max(self.totals.longest_s, end_s - self.lost_since_s))


def cell_edges(arena):
    """Edges [m] of the maps' cells along x (n + 1,) and y (m + 1,)."""
    halves = (math.ceil(half_m / CELL_M) for half_m in (arena.half_x_m, arena.half_y_m))
    return tuple(CELL_M * np.arange(-half, half + 1) for half in halves)


class DropCollector:
    """Takes the messages of a bag one by one; its memory does not grow."""

    def __init__(self, arena=None):
        """arena: whose map is made; None = the laboratory's."""
        self._markers = {}
        self._vehicles = {}
        edges_m = cell_edges(arena or Arena())
        self._seen = np.zeros([len(edges) - 1 for edges in edges_m], dtype=np.int64)
        self._lost = np.zeros_like(self._seen)
        self._places = {}  # object -> (x, y) [m] where it was last
        self._lost_places = array("d")
        self._unplaced = 0
        self._last_frame_s = None
        self._late_s = math.inf  # least time from a stamp to its receipt: what the clocks differ by
        self._frames, self._gaps, self._longest_gap_s = 0, 0, None

    def wants(self, topic):
        """Whether messages of this topic say anything here."""
        return topic in (MOCAP, STATES)

    def __call__(self, topic, receipt_s, message):
        """Take one message; topics that are of no interest are passed over."""
        if topic == MOCAP:
            self._note_frame(self._stamp_s(message, receipt_s))
            for body in message.Obj:
                self._note_markers(body)
        elif topic == STATES:
            stamp_s = self._stamp_s(message, receipt_s)
            for state in message.Obj:
                self._note_state(state, stamp_s)

    def drops(self, end_s):
        """Drops of what was collected; None when the bag held no motion capture.

        end_s: time of receipt at which the bag ends. What is lost then is lost until then, and so is the stream.
        """
        if not self._frames and not self._vehicles:
            return None
        end_s -= self._late_s  # on the clock of the stamps
        silent_end_s = max(0.0, end_s - self._last_frame_s) if self._frames else 0.0
        longest_gap_s = max(self._longest_gap_s or 0.0, silent_end_s) if self._frames else None
        return Drops(
            markers=dict(sorted(self._markers.items())),
            vehicles={name: watched.until(end_s) for name, watched in sorted(self._vehicles.items())},
            seen_map=self._seen,
            lost_map=self._lost,
            unplaced=self._unplaced,
            lost_places_m=np.array(self._lost_places).reshape(-1, 2),
            frames=self._frames,
            gaps=self._gaps + (silent_end_s > GAP_S),
            longest_gap_s=longest_gap_s,
            silent_end_s=silent_end_s,
        )

    def _stamp_s(self, message, receipt_s):
        """Stamp of a message; its receipt when nobody stamped it."""
        stamp_s = seconds(message.header.stamp) or receipt_s
        self._late_s = min(self._late_s, receipt_s - stamp_s)
        return stamp_s

    def _note_frame(self, stamp_s):
        self._frames += 1
        if self._last_frame_s is not None:
            gap_s = stamp_s - self._last_frame_s
            self._gaps += gap_s > GAP_S
            self._longest_gap_s = max(self._longest_gap_s or 0.0, gap_s)
        self._last_frame_s = stamp_s

    def _note_markers(self, body):
        loss = self._markers.setdefault(body.name, MarkerLoss())
        seen, sum_x, sum_y = 0, 0.0, 0.0
        for marker in body.marker:
            if abs(marker.x) < MARKER_LIMIT_M:  # False for NaN, too
                seen, sum_x, sum_y = seen + 1, sum_x + marker.x, sum_y + marker.y
        lost = len(body.marker) - seen
        loss.frames += 1
        loss.markers += seen + lost
        loss.lost += lost
        loss.blind_frames += not seen
        if seen:
            self._places[body.name] = (sum_x / seen, sum_y / seen)
        elif body.name not in self._places:
            self._unplaced += lost
            return
        cell = self._cell(*self._places[body.name])
        self._seen[cell] += seen
        self._lost[cell] += lost

    def _note_state(self, state, stamp_s):
        watched = self._vehicles.setdefault(state.name, _Watched())
        totals = watched.totals
        if state.visible:
            watched.seen = True
            totals.frames += 1
            if watched.lost_since_s is not None:
                totals.longest_s = max(totals.longest_s, stamp_s - watched.lost_since_s)
                watched.lost_since_s = None
        elif watched.seen:
            totals.frames += 1
            totals.invisible += 1
            if watched.lost_since_s is None:
                watched.lost_since_s = stamp_s
                totals.times += 1
                if totals.times <= _MOST_PLACES:
                    self._lost_places.extend((state.x, state.y))
            totals.longest_s = max(totals.longest_s, stamp_s - watched.lost_since_s)

    def _cell(self, *place_m):
        """Indices of the cell; what is outside counts at the border."""
        counts = self._seen.shape
        return tuple(min(max(int(m // CELL_M) + n // 2, 0), n - 1) for m, n in zip(place_m, counts))
