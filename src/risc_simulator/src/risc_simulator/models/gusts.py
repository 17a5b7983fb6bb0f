"""Random motion of the air: people, doors, the other vehicles' downwash."""

import math
from dataclasses import dataclass

import numpy as np

from risc_lab.settings import NotNegative, Positive, Settings


@dataclass(frozen=True)
class Gusts(Settings):
    """A first-order Gauss-Markov velocity of the air (Dryden-like) around each vehicle, independent for each axis."""

    speed_m_s: tuple[NotNegative, NotNegative, NotNegative] = (0.4, 0.4, 0.2)  # [m/s] 1 sigma north, east, up
    # [m/s^2] 1 sigma of the acceleration that they give a vehicle along each axis; the speed then follows from its mass
    # and drag. None: the speed is as above
    push_m_s2: NotNegative | None = None
    time_s: Positive = 1.5  # [s] correlation

    def std_m_s(self, plant):
        """(3,) 1 sigma of the velocity around a vehicle with these PlantParams: north, east, up [m/s].

        Raises ValueError for a push on a vehicle without drag: no air moves it.
        """
        if self.push_m_s2 is None:
            return np.array(self.speed_m_s)
        if plant.drag_n_s_m == 0.0:
            raise ValueError("gusts of %g m/s^2: a vehicle without drag is not moved; set drag_n_s_m" % self.push_m_s2)
        return np.full(3, self.push_m_s2 * plant.mass_kg / plant.drag_n_s_m)

    def keep(self, step_s):
        """Fraction of a velocity that remains after a step."""
        return math.exp(-step_s / self.time_s)
