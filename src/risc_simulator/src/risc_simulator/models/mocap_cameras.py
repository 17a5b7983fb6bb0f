"""Camera model of a motion-capture system: noise, occlusion and ghost markers are added to exact markers.

All lengths in metres, all positions in the mocap frame (x forward, y left, z up).

Seeded: the same seed and the same calls give the same output. Noise, occlusion and ghosts have generators of their own,
and each draws as many numbers for a hidden marker as for a visible one, so that hiding one marker, or switching one
effect off, changes nothing about the others.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from risc_lab.compiled import compiled
from risc_lab.lab.arena import Arena
from risc_lab.settings import NotNegative, Settings


@dataclass(frozen=True)
class CameraParams(Settings):
    """Quality of the system; the defaults are those of a good laboratory with 16 cameras."""

    noise_std_m: NotNegative = 0.002  # [m] standard deviation per axis, white
    occlusions_per_marker_hz: NotNegative = 0.02  # [1/s] how often a visible marker gets lost
    occlusion_mean_s: NotNegative = 0.05  # [s] mean of the exponentially distributed time for which it stays lost
    ghosts_hz: NotNegative = 0.5  # [1/s] how often a reflection appears as an unidentified marker
    ghost_mean_s: NotNegative = 0.1  # [s] mean of its exponentially distributed life
    volume_min_m: tuple[float, float, float] = (-2.0, -2.3, 0.0)  # capture volume in which ghosts appear
    volume_max_m: tuple[float, float, float] = (2.0, 2.3, 2.4)

    def __post_init__(self):
        super().__post_init__()
        if not np.less(self.volume_min_m, self.volume_max_m).all():
            raise ValueError(
                "capture volume from %r to %r: give x, y, z with min below max" % (self.volume_min_m, self.volume_max_m)
            )

    @classmethod
    def ideal(cls):
        """Exact markers, nothing hidden, no ghosts."""
        return cls(noise_std_m=0.0, occlusions_per_marker_hz=0.0, ghosts_hz=0.0)

    @classmethod
    def of_arena(cls, arena):
        """The defaults, with the laboratory's capture volume scaled to an Arena."""
        known = Arena()
        size = (arena.half_x_m / known.half_x_m, arena.half_y_m / known.half_y_m, arena.height_m / known.height_m)
        corners = (tuple(k * m for k, m in zip(size, corner_m)) for corner_m in (cls.volume_min_m, cls.volume_max_m))
        return cls(**dict(zip(("volume_min_m", "volume_max_m"), corners)))


class Observation(NamedTuple):
    """What the cameras report of one instant.

    layout: ((body name, number of markers), ...), the same object as long as it does not change.
    markers_m: (n, 3), the markers of all bodies in layout order, NaN rows are lost markers.   unidentified_m: (u, 3).
    """

    time_s: float
    layout: tuple[tuple[str, int], ...]
    markers_m: np.ndarray
    unidentified_m: np.ndarray


class MocapCameras:
    """Turns exact markers into observed ones, frame by frame.

    params: CameraParams.   seed: int or numpy SeedSequence.
    """

    def __init__(self, params=None, seed=0):
        self.params = CameraParams() if params is None else params
        sequence = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
        self._noise, self._occlusion, self._ghost = (np.random.default_rng(s) for s in sequence.spawn(3))
        self._layout = ()
        self._hidden_until_s = np.empty(0)
        self._ghosts_m = np.empty((0, 3))
        self._ghosts_until_s = np.empty(0)
        self._next_end_s = math.inf  # when the next ghost disappears
        self._last_time_s = -math.inf
        self._see(0.0, 0.0, np.empty((0, 3)))  # loads the compiled code

    def hide(self, body, until_s):
        """Hide all markers of a body in the frames before until_s. Raises ValueError if the last frame had none."""
        start = 0
        for name, count in self._layout:
            if name == body:
                hidden_until_s = self._hidden_until_s[start : start + count]
                np.maximum(hidden_until_s, until_s, out=hidden_until_s)
                return
            start += count
        known = ", ".join(name for name, _ in self._layout) or "none"
        raise ValueError("cannot hide %r: no such body, choose one of %s" % (body, known))

    def observe(self, time_s, layout, exact_m):
        """Observation at time_s [s] of bodies with exact markers.

        layout: ((body name, number of markers), ...). exact_m: (n, 3) markers of all bodies in this order [m].
        Times must not decrease. A change of the layout restarts the occlusions.
        """
        if layout is not self._layout and layout != self._layout:
            self._layout = layout
            self._hidden_until_s = np.full(sum(count for _, count in layout), -np.inf)
        step_s = max(time_s - self._last_time_s, 0.0) if self._last_time_s > -math.inf else 0.0
        self._last_time_s = time_s

        if len(exact_m) != len(self._hidden_until_s):
            raise ValueError("the layout has %d markers, got %d" % (len(self._hidden_until_s), len(exact_m)))
        markers_m = self._see(time_s, step_s, exact_m)
        return Observation(time_s, self._layout, markers_m, self._unidentified(time_s, step_s))

    def _see(self, time_s, step_s, exact_m):
        params = self.params
        losses = params.occlusions_per_marker_hz * step_s
        noise = self._noise.standard_normal(exact_m.shape)
        chances = self._occlusion.random((2 if params.occlusions_per_marker_hz > 0.0 else 0, len(exact_m)))
        means = losses, params.occlusion_mean_s, params.noise_std_m
        return _see(time_s, *means, exact_m, noise, chances, self._hidden_until_s)

    def _unidentified(self, time_s, step_s):
        """(u, 3) ghosts: each stays where it appeared, with the noise of any marker."""
        params = self.params
        if params.ghosts_hz > 0.0:
            born = self._ghost.poisson(params.ghosts_hz * step_s)
            if born or time_s >= self._next_end_s:
                alive = time_s < self._ghosts_until_s
                new_m = self._ghost.uniform(params.volume_min_m, params.volume_max_m, (born, 3))
                new_until_s = time_s + self._ghost.exponential(params.ghost_mean_s, born)
                self._ghosts_m = np.concatenate((self._ghosts_m[alive], new_m))
                self._ghosts_until_s = np.concatenate((self._ghosts_until_s[alive], new_until_s))
                self._next_end_s = self._ghosts_until_s.min(initial=math.inf)
        if not len(self._ghosts_m):
            return self._ghosts_m
        return self._ghosts_m + params.noise_std_m * self._ghost.standard_normal(self._ghosts_m.shape)


@compiled
def _see(time_s, losses, loss_mean_s, noise_std_m, exact_m, noise, chances, hidden_until_s):
    """(n, 3) markers with noise; those that are hidden, or get lost by chance now, are NaN.

    losses: expected number of times that a marker gets lost in this frame. noise: (n, 3) normal numbers. chances:
    (2, n) uniform numbers, which decide whether a marker gets lost and for how long; (0, n): none does.
    hidden_until_s: (n,), kept from call to call.
    """
    markers_m = exact_m + noise_std_m * noise
    starts = -math.expm1(-losses) if len(chances) else 0.0  # probability, as of a Poisson process
    for k in range(len(markers_m)):
        if starts > 0.0 and chances[0, k] < starts and time_s >= hidden_until_s[k]:
            duration_s = -loss_mean_s * math.log1p(-chances[1, k])  # exponentially distributed
            hidden_until_s[k] = time_s + duration_s
        if time_s < hidden_until_s[k]:
            markers_m[k] = math.nan
    return markers_m
