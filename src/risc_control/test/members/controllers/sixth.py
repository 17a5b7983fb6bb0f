"""A controller that reads six derivatives of its reference: `differential_flatness`, which may report the last two, and
the variance of x, by its commands.
"""

from dataclasses import dataclass

import numpy as np

from risc_control.controllers import differential_flatness
from risc_control.vehicles import Command

SEEN = []  # (Times, Reference, covariances) of each step, as the controller gets them
TOLD = 0.1  # rad of roll and pitch for a derivative of 1


@dataclass(frozen=True)
class Params(differential_flatness.Params):
    """Parameters of the controller, and of the test."""

    # 1: fly; 2: report: roll is the fifth derivative of x ahead, pitch the sixth, and yaw rate [rad/s] the variance
    # of x [m^2], 0 where there is none
    purpose: float = 1.0


class Controller(differential_flatness.Controller):
    """See the module."""

    PARAMS = Params
    ORDER = 6
    COVARIANCES = True

    def step(self, t, states, reference, params):
        """As `controllers.Controller`."""
        SEEN.append((t, reference, states.covariances))
        command = super().step(t, states, reference, params)
        if params.purpose == 1.0:
            return command
        fifth, sixth = TOLD * reference.ahead[5, :, 0], TOLD * reference.ahead[6, :, 0]
        variance = np.zeros(len(fifth)) if states.covariances is None else states.covariances[:, 0, 0]
        return Command(fifth, sixth, variance, command.thrust_n)
