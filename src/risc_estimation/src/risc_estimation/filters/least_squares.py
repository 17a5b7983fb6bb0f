"""Polynomials through sliding windows of the raw positions and angles, read off at the newest frame (eqs 4.1-4.2)."""

from dataclasses import dataclass

import numpy as np

from risc_estimation.filters import VelocityFilter
from risc_estimation.least_squares import SlidingFit, Window, estimate_newest, push_samples
from risc_lab.compiled import compiled, record
from risc_lab.frames import wrap_one_angle


@dataclass(frozen=True)
class Params:
    """Settings; config/filters/least_squares.yaml explains and holds them."""

    position_window_s: float
    position_order: int
    angle_window_s: float
    angle_order: int
    smooth_position: bool
    smooth_angles: bool
    min_samples: int
    min_span_s: float
    max_gap_s: float
    max_rate_hz: float

    def __post_init__(self):
        for name in ("position_window_s", "angle_window_s", "max_gap_s", "max_rate_hz"):
            if not getattr(self, name) > 0.0:
                raise ValueError("%s must be positive, got %r" % (name, getattr(self, name)))
        for name in ("position_order", "angle_order"):
            if getattr(self, name) not in (1, 2, 3):
                raise ValueError("%s must be 1, 2 or 3, got %r" % (name, getattr(self, name)))
        if self.min_samples < 2:
            raise ValueError("min_samples must be at least 2 (a rate needs two), got %r" % (self.min_samples,))
        shorter_s = min(self.position_window_s, self.angle_window_s)
        if not 0.0 <= self.min_span_s < 0.9 * shorter_s:
            raise ValueError(
                "min_span_s must be in [0, 0.9 x the shorter window = %g s), got %r: no vehicle would "
                "ever become visible" % (0.9 * shorter_s, self.min_span_s)
            )


SETTINGS = record(("min_samples", int), ("min_span_s", float), ("smooth_position", bool), ("smooth_angles", bool))


class Filter(VelocityFilter):
    """A vehicle is visible when it is seen inside the arena and both windows hold enough for a rate.

    That is `min_samples` that span `min_span_s`: the tenth frame at 200 Hz after a restart; a line then has 44 mm/s of
    noise for 2 mm positions. Dropouts up to `max_gap_s` do not restart the windows: the fit runs on real stamps, so the
    vehicle is visible again with its first good frame.
    """

    PARAMS = Params

    def __init__(self, params):
        super().__init__(params)
        self._settings = np.zeros(1, dtype=SETTINGS)
        for name in SETTINGS.names:
            self._settings[name] = getattr(params, name)
        windows = (params.position_window_s, params.position_order), (params.angle_window_s, params.angle_order)
        capacity_s = max(params.position_window_s, params.angle_window_s)
        self._fits = [
            SlidingFit(window_s, order, 3, params.max_gap_s, params.max_rate_hz, capacity_s=capacity_s)
            for window_s, order in windows
        ]
        self._collect()
        _update(0.0, np.zeros((2, 0), dtype=bool), np.zeros((2, 0, 3)), *self._arguments)  # loads the compiled code

    def add_body(self, template):
        super().add_body(template)
        for fit in self._fits:
            fit.add_body()
        self._collect()

    def reset(self):
        for fit in self._fits:
            fit.reset()

    def update(self, poses):
        _update(poses.stamp_s, poses.flags, poses.measured, *self._arguments)

    def _collect(self):
        """One array of each kind for both windows: fewer of them to pass."""
        stacked = [np.stack(arrays) for arrays in zip(*[fit.window for fit in self._fits])]
        for k, fit in enumerate(self._fits):
            fit.window = Window._make(array[k] for array in stacked)
        self._arguments = self._settings, self.visible, self.states, *stacked


# The arrays come one by one, since a tuple of them takes three times as long to pass.
@compiled
def _update(
    stamp_s, flags, measured,
    settings, visible, states,
    fits, bodies, stamps_s, samples, values, weights, estimates,
):  # fmt: skip
    """One frame: fills visible and states. After `Poses`: arrays of the filter, then both Windows, stacked."""
    present, inside = flags[0], flags[1]
    if len(present) == 0:
        return
    for k in range(2):
        window = Window(fits[k], bodies[k], stamps_s[k], samples[k], values[k], weights[k], estimates[k])
        push_samples(window, stamp_s, measured[k], present)
        estimate_newest(window, present)
    smooth_position, smooth_angles = settings[0].smooth_position, settings[0].smooth_angles
    for i in range(len(present)):
        visible[i] = inside[i] and _is_settled(bodies[0, i], settings[0]) and _is_settled(bodies[1, i], settings[0])
        if visible[i]:
            state, position, angle = states[i], estimates[0, i], estimates[1, i]
            for axis in range(3):
                state[axis] = position[0, axis] if smooth_position else measured[0, i, axis]
                state[3 + axis] = position[1, axis]
                state[6 + axis] = wrap_one_angle(angle[0, axis] if smooth_angles else measured[1, i, axis])
                state[9 + axis] = angle[1, axis]


@compiled
def _is_settled(body, settings):
    """Whether a window (least_squares.BODY) holds enough for a rate."""
    return body.samples >= settings.min_samples and body.span_s >= settings.min_span_s
