"""Polynomials through sliding windows of the raw positions and angles, read off at the newest frame (eqs 4.1-4.2)."""

from dataclasses import dataclass

import numpy as np

from risc_estimation.filters import VelocityFilter
from risc_estimation.least_squares import Window, Windows, estimate_newest, push_samples
from risc_lab.compiled import compiled, record
from risc_lab.frames import wrap_one_angle
from risc_lab.settings import NotNegative, Positive, Settings, between


@dataclass(frozen=True)
class Params(Settings):
    """Settings; config/filters/least_squares.yaml explains and holds them."""

    position_window_s: Positive
    position_order: between(1, 3)
    angle_window_s: Positive
    angle_order: between(1, 3)
    smooth_position: bool
    smooth_angles: bool
    min_samples: between(2, 1000)  # a rate needs two
    min_span_s: NotNegative
    max_gap_s: Positive
    max_rate_hz: Positive

    def __post_init__(self):
        super().__post_init__()
        longest_s = 0.9 * min(self.position_window_s, self.angle_window_s)
        if self.min_span_s >= longest_s:
            raise ValueError(
                "min_span_s must be below 0.9 x the shorter window = %g s, got %r: no vehicle would ever become visible"
                % (longest_s, self.min_span_s)
            )


SETTINGS = record(("min_samples", int), ("min_span_s", float), ("smooth_position", bool), ("smooth_angles", bool))


class Filter(VelocityFilter):
    """A vehicle is visible when it is seen inside the arena and both windows hold enough samples for a rate.

    That is `min_samples` that span `min_span_s`: the tenth frame at 200 Hz after a restart; a line then has 44 mm/s of
    noise for 2 mm positions. Dropouts up to `max_gap_s` do not restart the windows: the fit runs on real stamps, so the
    vehicle is visible again with its first good frame. An accepted pose that contradicts those before restarts them.
    """

    PARAMS = Params

    def __init__(self, params):
        super().__init__(params)
        self._settings = np.array([tuple(getattr(params, name) for name in SETTINGS.names)], dtype=SETTINGS)
        kinds = (params.position_window_s, params.position_order), (params.angle_window_s, params.angle_order)
        self._windows = Windows(kinds, 3, params.max_gap_s, params.max_rate_hz)
        self._collect()
        _update(0.0, np.zeros((3, 0), dtype=bool), np.zeros((2, 0, 3)), *self._arguments)  # loads the compiled code

    def add_body(self, template, vehicle_type=None):
        super().add_body(template)
        self._windows.add_body()
        self._collect()

    def reset(self):
        self._windows.reset()

    def update(self, poses):
        _update(poses.stamp_s, poses.flags, poses.measured, *self._arguments)

    def _collect(self):
        self._arguments = self._settings, self.visible, self.states, *self._windows.arrays


# The arrays are passed one by one, since a tuple of them takes three times as long to pass.
@compiled
def _update(
    stamp_s, flags, measured,
    settings, visible, states,
    fits, bodies, stamps_s, samples, values, weights, estimates,
):  # fmt: skip
    """One frame: fills visible and states. After `Poses`: arrays of the filter, then those of its Windows."""
    present, inside, elsewhere = flags[0], flags[1], flags[2]
    if len(present) == 0:
        return
    for k in range(2):
        window = Window(fits[k], bodies[k], stamps_s[k], samples[k], values[k], weights[k], estimates[k])
        push_samples(window, stamp_s, measured[k], present, elsewhere)
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
    """Whether a window (least_squares.BODY) holds enough samples for a rate."""
    return body.samples >= settings.min_samples and body.span_s >= settings.min_span_s
