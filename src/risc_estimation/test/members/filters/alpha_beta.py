"""A filter from outside the tree: alpha-beta, each coordinate on its own, critically damped."""

from dataclasses import dataclass

import numpy as np

from risc_estimation.filters import VelocityFilter
from risc_lab.frames import wrap_angle


@dataclass(frozen=True)
class Params:
    memory: float
    settle_frames: int


class Filter(VelocityFilter):
    PARAMS = Params

    def __init__(self, params):
        super().__init__(params)
        self._alpha, self._beta = 1.0 - params.memory**2, (1.0 - params.memory) ** 2
        self.reset()

    def add_body(self, template, vehicle_type=None):
        super().add_body(template)
        self.reset()

    def reset(self):
        bodies = len(self.states)
        self._stamp_s, self._frames = -np.inf, np.zeros(bodies, dtype=int)
        self._values, self._rates = np.zeros((2, bodies, 3)), np.zeros((2, bodies, 3))

    def update(self, poses):
        step_s = poses.stamp_s - self._stamp_s
        self._stamp_s = poses.stamp_s
        known = (poses.present & (self._frames > 0))[:, None]
        self._frames = np.where(poses.present, self._frames + 1, 0)
        predicted = self._values + (step_s * self._rates if known.any() else 0.0)
        errors = np.where(known, poses.measured - predicted, 0.0)
        self._values = np.where(known, predicted + self._alpha * errors, poses.measured)
        self._rates = np.where(known, self._rates + self._beta / step_s * errors, 0.0)
        self.visible[:] = poses.inside & (self._frames > self.params.settle_frames)
        (positions, angles), (velocities, rates) = self._values, self._rates
        states = np.hstack([positions, velocities, wrap_angle(angles), rates])
        self.states[self.visible] = states[self.visible]
