"""A student's controller: PD on the position and feed-forward of the acceleration; nothing else."""

from dataclasses import dataclass

import numpy as np

from risc_control import controllers
from risc_control.vehicles import Command
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.states import S


@dataclass(frozen=True)
class Params:
    """Gains."""

    position_1_s2: float = 0.0
    velocity_1_s: float = 0.0
    yaw_1_s: float = 0.0


class Controller(controllers.Controller):
    """See the module."""

    PARAMS = Params

    def step(self, t, states, reference, params):
        """As `controllers.Controller`."""
        x, (position, velocity, acceleration) = states.vehicles.x, reference.present[:3]
        a = acceleration[:, :3] + params.position_1_s2 * (position[:, :3] - x[:, S.X : S.U])
        a += params.velocity_1_s * (velocity[:, :3] - x[:, S.U : S.PHI])
        psi = x[:, S.PSI]
        north, east, up = a[:, 0], -a[:, 1], GRAVITY_M_S2 + a[:, 2]
        forward = np.cos(psi) * north + np.sin(psi) * east
        right = np.cos(psi) * east - np.sin(psi) * north
        turn = (position[:, 3] - psi + np.pi) % (2.0 * np.pi) - np.pi
        thrust_n = self.mass_kg * up / (np.cos(x[:, S.PHI]) * np.cos(x[:, S.THETA]))
        return Command(
            np.arctan2(right, up), -np.arctan2(forward, up), params.yaw_1_s * turn + velocity[:, 3], thrust_n
        )
