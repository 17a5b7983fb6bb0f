"""A controller that uses the bodies that vehicles carry: `toy_pd`, but the body follows the course in height."""

from dataclasses import dataclass

from risc_control.controllers import toy_pd
from risc_lab.states import S


@dataclass(frozen=True)
class Params(toy_pd.Params):
    """Gains, and the desired height of the body."""

    below_m: float = 0.0  # below the course


class Controller(toy_pd.Controller):
    """See the module."""

    PARAMS = Params

    def step(self, t, states, reference, params):
        """As `controllers.Controller`."""
        hangs_m = states.vehicles.x[:, S.Z] - states.bodies.x[:, S.Z]
        present = reference.present.copy()
        present[0, states.bodies.visible, S.Z] += (hangs_m - params.below_m)[states.bodies.visible]
        return super().step(t, states, reference._replace(present=present), params)
