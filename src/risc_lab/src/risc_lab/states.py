"""States of vehicles at one time, as the estimator, /cortex_raw and the controllers have them. SI units."""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

AIRBORNE_M = 0.3  # higher than this a vehicle's centre is in the air; lower it may stand on the floor


class S(IntEnum):
    """Columns of a state: position [m], velocity [m/s], roll pitch yaw [rad], their rates [rad/s].

    Cortex axes (z up); angles in the NED sense: + right wing down, + nose up, + clockwise from above.
    """

    X, Y, Z, U, V, W, PHI, THETA, PSI, P, Q, R = range(12)


class States(NamedTuple):
    """States of n vehicles."""

    visible: np.ndarray  # (n,) bool; where False the row of x means nothing
    x: np.ndarray  # (n, 12), columns `S`

    @property
    def position_m(self):
        """(n, 3)."""
        return self.x[:, S.X : S.U]

    @property
    def velocity_m_s(self):
        """(n, 3)."""
        return self.x[:, S.U : S.PHI]

    @property
    def angles_rad(self):
        """(n, 3) phi, theta, psi."""
        return self.x[:, S.PHI : S.P]

    @property
    def rates_rad_s(self):
        """(n, 3) Euler rates."""
        return self.x[:, S.P :]
