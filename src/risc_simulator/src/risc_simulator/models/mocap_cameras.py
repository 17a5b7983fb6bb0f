"""What a motion-capture system sees of exact markers: noise, occlusion and markers that belong to nothing.

All lengths in metres, all positions in the mocap frame (x forward, y left, z up). Every marker is handled at once.

Seeded: the same seed and the same calls give the same output. Noise, occlusion and ghosts have generators of their own,
and each draws as many numbers for a hidden marker as for a visible one, so that hiding one marker, or switching one
effect off, changes nothing about the others.
"""

from dataclasses import dataclass
from typing import NamedTuple, Optional, Tuple

import numpy as np


@dataclass(frozen=True)
class CameraParams:
    """Quality of the system; the defaults are those of a good laboratory with 16 cameras."""

    noise_std_m: float = 0.002  # [m] standard deviation per axis, white
    occlusions_per_marker_hz: float = 0.02  # [1/s] how often a visible marker gets lost
    occlusion_mean_s: float = 0.05  # [s] mean of the exponentially distributed time for which it stays lost
    ghosts_hz: float = 0.5  # [1/s] how often a reflection appears as an unidentified marker
    ghost_mean_s: float = 0.1  # [s] mean of its exponentially distributed life
    volume_min_m: Tuple[float, float, float] = (-2.0, -2.3, 0.0)  # capture volume in which ghosts appear
    volume_max_m: Tuple[float, float, float] = (2.0, 2.3, 2.4)

    def __post_init__(self):
        for name in ("noise_std_m", "occlusions_per_marker_hz", "occlusion_mean_s", "ghosts_hz", "ghost_mean_s"):
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                raise ValueError("camera parameter %s is %r: give a number that is not negative" % (name, value))
        low, high = np.asarray(self.volume_min_m, float), np.asarray(self.volume_max_m, float)
        if low.shape != (3,) or high.shape != (3,) or not (low < high).all():
            raise ValueError(
                "capture volume from %r to %r: give x, y, z with min below max" % (self.volume_min_m, self.volume_max_m)
            )

    @classmethod
    def ideal(cls):
        """Exact markers, nothing hidden, no ghosts."""
        return cls(noise_std_m=0.0, occlusions_per_marker_hz=0.0, ghosts_hz=0.0)


@dataclass(frozen=True)
class OcclusionWindow:
    """Scripted loss: markers of a body are hidden from start_s (inclusive) to end_s (exclusive)."""

    body: str
    start_s: float
    end_s: float
    markers: Optional[Tuple[int, ...]] = None  # indices in the body; None = all

    def __post_init__(self):
        if not self.start_s < self.end_s:
            raise ValueError(
                "occlusion of %r from %r s to %r s: the end must be later" % (self.body, self.start_s, self.end_s)
            )


class Observation(NamedTuple):
    """What the cameras report of one instant.

    layout: ((body name, number of markers), ...), the same object as long as it stays the same.
    markers_m: (n, 3), the markers of all bodies in layout order, NaN rows are lost.   unidentified_m: (u, 3).
    """

    time_s: float
    layout: Tuple[Tuple[str, int], ...]
    markers_m: np.ndarray
    unidentified_m: np.ndarray

    def bodies(self):
        """[(name, (n, 3) markers), ...]: views of markers_m."""
        out, start = [], 0
        for name, count in self.layout:
            out.append((name, self.markers_m[start : start + count]))
            start += count
        return out


class MocapCameras:
    """Turns exact markers into observed ones, frame by frame.

    params: CameraParams.   seed: int or numpy SeedSequence.   windows: scripted OcclusionWindows.
    """

    def __init__(self, params=None, seed=0, windows=()):
        self.params = CameraParams() if params is None else params
        sequence = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
        self._noise, self._occlusion, self._ghost = (np.random.default_rng(s) for s in sequence.spawn(3))
        self._windows = list(windows)
        self._layout = ()
        self._window_rows = []  # for each window: rows of the marker array that it hides
        self._hidden_until_s = np.empty(0)
        self._ghosts_m = np.empty((0, 3))
        self._ghosts_until_s = np.empty(0)
        self._last_time_s = -np.inf

    def add_window(self, window):
        """Script one more loss. Raises ValueError when it names a body or marker that the last frame did not have."""
        if self._layout:
            rows = self._rows_of(window)
            current = [(w, r) for w, r in zip(self._windows, self._window_rows) if w.end_s > self._last_time_s]
            current.append((window, rows))  # those that have passed are forgotten here
            self._windows, self._window_rows = [w for w, _ in current], [r for _, r in current]
        else:
            self._windows.append(window)

    def observe(self, time_s, bodies):
        """Observation at time_s [s] of bodies [(name, (n, 3) exact markers [m]), ...].

        Times must not decrease. A change of the bodies starts their occlusions anew. Raises ValueError when a scripted
        window does not fit the bodies.
        """
        layout = tuple((name, len(markers)) for name, markers in bodies)
        if layout != self._layout:
            self._start_layout(layout)
        exact_m = np.concatenate([markers for _, markers in bodies]) if bodies else np.empty((0, 3))
        step_s = max(time_s - self._last_time_s, 0.0) if np.isfinite(self._last_time_s) else 0.0
        self._last_time_s = time_s

        params = self.params
        markers_m = self._noise.standard_normal(exact_m.shape)
        markers_m *= params.noise_std_m
        markers_m += exact_m
        hidden = self._hidden(time_s, step_s)
        if hidden.any():
            markers_m[hidden] = np.nan
        return Observation(time_s, self._layout, markers_m, self._unidentified(time_s, step_s))

    def _start_layout(self, layout):
        previous, self._layout = self._layout, layout
        try:
            self._window_rows = [self._rows_of(window) for window in self._windows]
        except ValueError:
            self._layout = previous
            raise
        self._hidden_until_s = np.full(sum(count for _, count in layout), -np.inf)

    def _rows_of(self, window):
        start = 0
        for name, count in self._layout:
            if name == window.body:
                indices = np.arange(count) if window.markers is None else np.asarray(window.markers, int)
                if indices.size and not 0 <= indices.min() <= indices.max() < count:
                    raise ValueError(
                        "scripted occlusion hides markers %r of %r, which has %d: number them from 0"
                        % (window.markers, name, count)
                    )
                return start + indices
            start += count
        raise ValueError(
            "scripted occlusion of %r: no such body, choose one of %s"
            % (window.body, ", ".join(name for name, _ in self._layout) or "none")
        )

    def _hidden(self, time_s, step_s):
        """(n,) bool: lost by chance or by script."""
        params = self.params
        if params.occlusions_per_marker_hz > 0.0:
            chance, length = self._occlusion.random((2, self._hidden_until_s.size))
            # a Poisson process per visible marker; how long the loss lasts is exponential
            starts = (chance < -np.expm1(-params.occlusions_per_marker_hz * step_s)) & (time_s >= self._hidden_until_s)
            if starts.any():
                self._hidden_until_s[starts] = time_s - params.occlusion_mean_s * np.log1p(-length[starts])
        hidden = time_s < self._hidden_until_s
        for window, rows in zip(self._windows, self._window_rows):
            if window.start_s <= time_s < window.end_s:
                hidden[rows] = True
        return hidden

    def _unidentified(self, time_s, step_s):
        """(u, 3) ghosts: each stays where it appeared and trembles like any marker."""
        params = self.params
        if params.ghosts_hz > 0.0:
            born = self._ghost.poisson(params.ghosts_hz * step_s)
            alive = time_s < self._ghosts_until_s
            if born or not alive.all():
                new_m = self._ghost.uniform(params.volume_min_m, params.volume_max_m, (born, 3))
                new_until_s = time_s + self._ghost.exponential(params.ghost_mean_s, born)
                self._ghosts_m = np.concatenate((self._ghosts_m[alive], new_m))
                self._ghosts_until_s = np.concatenate((self._ghosts_until_s[alive], new_until_s))
        if not len(self._ghosts_m):
            return self._ghosts_m
        return self._ghosts_m + params.noise_std_m * self._ghost.standard_normal(self._ghosts_m.shape)
