"""A filter for tests of its inputs and outputs: velocities as measured on board, rates as commanded, covariances."""

from dataclasses import dataclass

import numpy as np

from risc_estimation.filters import COMMAND, VelocityFilter
from risc_lab.settings import Positive, Settings
from risc_lab.states import S


@dataclass(frozen=True)
class Params(Settings):
    variance: Positive


class Filter(VelocityFilter):
    PARAMS = Params
    ON_BOARD = (COMMAND, "velocity")

    def reset(self):
        self.states[:] = 0.0

    def update(self, poses):
        self.visible[:] = poses.inside
        self.states[:, : S.U], self.states[:, S.PHI : S.P] = poses.measured

    def on_board(self, row, stamp_s, what, values):
        if what == COMMAND:
            roll, pitch, _, yaw_rate = values
            self.states[row, S.P :] = roll, pitch, yaw_rate
        else:
            self.states[row, S.U : S.PHI] = values

    def covariances(self):
        return self.params.variance * np.tile(np.eye(12), (len(self.states), 1, 1))
