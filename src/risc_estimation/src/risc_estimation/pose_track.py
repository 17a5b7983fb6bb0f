"""Where a vehicle was at any instant between two frames of motion capture. Needs no ROS."""

import math
from array import array
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from risc_lab.clock_guard import ClockGuard, Step
from risc_lab.frames import rotation_body_to_cortex

_WIDTH = 7  # stamp, position, roll, pitch, yaw


class Poses(NamedTuple):
    """Poses at m instants. Frame: cortex. Where not known the numbers are NaN."""

    known: np.ndarray  # (m,) bool
    positions_m: np.ndarray  # (m, 3)
    R_body_to_cortex: np.ndarray  # (m, 3, 3)


class PoseTrack:
    """Poses of one vehicle over time, interpolated between samples: position on a line, attitude on the shortest arc.

    Never extrapolates, and does not bridge gaps: there the pose is not known.
    """

    def __init__(self, max_gap_s=0.1, span_s=None):
        """max_gap_s: longest gap [s] that is interpolated. span_s: how much is remembered [s], None = everything."""
        self._max_gap_s = max_gap_s
        self._span_s = span_s
        self._rows = array("d")
        self._stamps = ClockGuard(math.inf)  # a vehicle may be out of sight for long

    def __len__(self):
        return len(self._rows) // _WIDTH

    @property
    def last_stamp_s(self):
        """Stamp [s] of the newest sample, None before the first."""
        return self._rows[-_WIDTH] if self._rows else None

    def append(self, stamp_s, position_m, euler_rad):
        """Add a sample: position (3,) [m] in the cortex frame; roll, pitch, yaw [rad] in the NED sense.

        Samples that do not advance, or that hold anything but finite numbers, are ignored; a new clock (a bag
        played again) starts afresh. Returns the `Step` of the stamp.
        """
        row = (stamp_s, *position_m, *euler_rad)
        if not math.isfinite(sum(row)):
            return Step.REFUSED
        step = self._stamps.look(stamp_s)
        if step is Step.REFUSED:
            return step
        if step is Step.NEW_CLOCK:
            self._rows = array("d")
        self._rows.extend(row)
        if self._span_s is not None and stamp_s - self._rows[0] > 2.0 * self._span_s:
            keep = np.searchsorted(self._table()[:, 0], stamp_s - self._span_s) - 1
            self._rows = self._rows[max(0, keep) * _WIDTH :]
        return step

    def at(self, times_s):
        """Poses at times (m,) [s]."""
        times = np.atleast_1d(np.asarray(times_s, dtype=float))
        known = np.zeros(len(times), dtype=bool)
        positions = np.full((len(times), 3), np.nan)
        R = np.full((len(times), 3, 3), np.nan)
        table = self._table()
        if len(table):
            stamps = table[:, 0]
            after = np.clip(np.searchsorted(stamps, times), 0, len(stamps) - 1)
            before = np.where(stamps[after] > times, after - 1, after)
            known = (before >= 0) & (times <= stamps[-1])
            known &= stamps[after] - stamps[before] <= self._max_gap_s
            first, second, wanted = table[before[known]], table[after[known]], times[known]
            gap_s = second[:, 0] - first[:, 0]
            part = (wanted - first[:, 0]) / np.where(gap_s > 0.0, gap_s, 1.0)
            positions[known] = first[:, 1:4] + part[:, None] * (second[:, 1:4] - first[:, 1:4])
            if known.any():
                R[known] = _between(first[:, 4:], second[:, 4:], part)
        return Poses(known, positions, R)

    def _table(self):
        """A view of the samples: it must be released before the next append."""
        return np.frombuffer(self._rows).reshape(-1, _WIDTH) if self._rows else np.zeros((0, _WIDTH))


def _between(first_rad, second_rad, part):
    """Rotation matrices (m, 3, 3) at `part` (m,) of the shortest arc between two sets of roll, pitch, yaw (m, 3)."""
    start = Rotation.from_matrix(rotation_body_to_cortex(*first_rad.T))
    end = Rotation.from_matrix(rotation_body_to_cortex(*second_rad.T))
    arc = (start.inv() * end).as_rotvec()
    return (start * Rotation.from_rotvec(part[:, None] * arc)).as_matrix()
