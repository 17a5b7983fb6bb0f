"""Losses of motion capture, and where in the arena they occurred: markers, whole vehicles, frames."""

import math
from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from data_extraction.flatten import stamp_or_receipt_s
from data_extraction.report.recorded_topics import Collector
from risc_lab.lab.arena import Arena

MOCAP, STATES = "/mocap_data", "/cortex_raw"
CELL_M = 0.25  # side of a cell of the map
MARKER_LIMIT_M = 100.0  # larger coordinates mean "lost" (9999.999 m in bags of the original release)
LEAST_MARKERS = 400  # a cell with fewer is not significant: half a second of one vehicle at 200 Hz
GAP_S = 0.1  # a longer time between two frames is a gap of the stream
_MOST_PLACES = 2000  # per vehicle, that are drawn


@dataclass
class MarkerLoss:
    """Markers of one object."""

    markers: int = 0  # seen or not, over all frames
    lost: int = 0
    frames: int = 0
    blind_frames: int = 0  # without a single marker


@dataclass
class Invisibility:
    """Periods in which the estimator reported a vehicle as not seen, after it had seen it once."""

    frames: int = 0
    invisible: int = 0
    times: int = 0  # number of these periods
    longest_s: float = 0.0
    since_s: float | None = None  # stamp [s] at which the current period began; None = it is seen

    def until(self, stamp_s):
        """Extend the current period, if any, to that stamp [s]."""
        if self.since_s is not None:
            self.longest_s = max(self.longest_s, stamp_s - self.since_s)


@dataclass
class Drops:
    """Everything that was lost."""

    seen_map: np.ndarray  # (x, y) markers seen in each cell of the arena, cortex frame; see `cell_edges`
    lost_map: np.ndarray  # (x, y) markers lost there: at the object's other markers, else at its last known place
    markers: dict[str, MarkerLoss] = field(default_factory=lambda: defaultdict(MarkerLoss))  # object -> its markers
    vehicles: dict[str, Invisibility] = field(default_factory=lambda: defaultdict(Invisibility))
    unplaced: int = 0  # markers lost of objects that were never seen before
    lost_places_m: list[tuple] = field(default_factory=list)  # (x, y) [m] where vehicles became invisible
    frames: int = 0  # of the stream
    gaps: int = 0
    longest_gap_s: float | None = None  # None = there was no frame
    silent_end_s: float = 0.0  # time from the last frame to the bag's end; a gap when it is longer than GAP_S

    @property
    def least_markers(self):
        """How many markers a cell needs to be drawn."""
        return min(LEAST_MARKERS, int((self.seen_map + self.lost_map).max()))

    @property
    def markers_lost(self):
        """How many markers of all objects were lost."""
        return sum(loss.lost for loss in self.markers.values())


def cell_edges(arena):
    """Edges [m] of the maps' cells along x (n + 1,) and y (m + 1,)."""
    halves = (math.ceil(half_m / CELL_M) for half_m in (arena.half_x_m, arena.half_y_m))
    return tuple(CELL_M * np.arange(-half, half + 1) for half in halves)


class DropCollector(Collector):
    """Collects Drops, in constant memory."""

    topics = (MOCAP, STATES)

    def __init__(self, arena=None):
        """arena: Arena of the maps; None = the laboratory's."""
        shape = [len(edges) - 1 for edges in cell_edges(arena or Arena())]
        self._drops = Drops(np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.int64))
        self._places = {}  # object -> (x, y) [m] where it was last
        self._gaps = 0  # before the newest frame
        self._last_frame_s = math.nan
        self._late_s = math.inf  # least time from a stamp to its receipt: the offset of the clocks

    def __call__(self, topic, receipt_s, message):
        stamp_s = stamp_or_receipt_s(message, receipt_s)
        self._late_s = min(self._late_s, receipt_s - stamp_s)
        for item in message.Obj:
            self._note_state(item, stamp_s) if topic == STATES else self._note_markers(item)
        if topic == MOCAP:
            drops = self._drops
            drops.frames += 1
            gap_s = stamp_s - self._last_frame_s
            self._gaps += gap_s > GAP_S
            drops.longest_gap_s = max(drops.longest_gap_s or 0.0, gap_s)
            self._last_frame_s = stamp_s

    def result(self, end_s):
        """Drops of what was collected; None when the bag held no motion capture.

        A vehicle or a stream that is lost at the end counts as lost until the end of the bag.
        """
        drops = self._drops
        if not drops.frames and not drops.vehicles:
            return None
        end_s -= self._late_s  # on the clock of the stamps
        for item in drops.vehicles.values():
            item.until(end_s)
        if drops.frames:
            drops.silent_end_s = max(0.0, end_s - self._last_frame_s)
            drops.longest_gap_s = max(drops.longest_gap_s, drops.silent_end_s)
            drops.gaps = self._gaps + (drops.silent_end_s > GAP_S)
        return drops

    def _note_markers(self, body):
        drops, loss = self._drops, self._drops.markers[body.name]
        seen = [(marker.x, marker.y) for marker in body.marker if abs(marker.x) < MARKER_LIMIT_M]  # False for NaN, too
        lost = len(body.marker) - len(seen)
        loss.frames += 1
        loss.markers += len(body.marker)
        loss.lost += lost
        loss.blind_frames += not seen
        if seen:
            self._places[body.name] = tuple(sum(values) / len(seen) for values in zip(*seen))
        elif body.name not in self._places:
            drops.unplaced += lost
            return
        # positions outside count in the border cells
        place_m, counts = self._places[body.name], drops.seen_map.shape
        cell = tuple(min(max(int(m // CELL_M) + n // 2, 0), n - 1) for m, n in zip(place_m, counts))
        drops.seen_map[cell] += len(seen)
        drops.lost_map[cell] += lost

    def _note_state(self, state, stamp_s):
        item = self._drops.vehicles[state.name]
        if state.visible or item.frames:
            item.frames += 1
            item.invisible += not state.visible
            if not state.visible and item.since_s is None:
                item.since_s = stamp_s
                item.times += 1
                if item.times <= _MOST_PLACES:
                    self._drops.lost_places_m.append((state.x, state.y))
            item.until(stamp_s)
            if state.visible:
                item.since_s = None
