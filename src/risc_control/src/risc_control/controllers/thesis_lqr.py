"""The thesis' controller (7.7-7.10): LQR on a double integrator, feed-forward of the acceleration, no prediction.

For teaching, and to measure what the additions of `differential_flatness` bring. Errors are reference - actual and
feedback is +K (errata 6, 7).
"""

import math
from dataclasses import dataclass

import numpy as np

from risc_control import controllers
from risc_control.controllers.differential_flatness import wrapped
from risc_control.flatness import Acceleration, flat_inputs, limit_tilt
from risc_control.lqr import lqr_gain
from risc_control.reference_buffer import Axis
from risc_control.vehicles import Command, floats, greatest_command
from risc_lab.compiled import compiled, record
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.settings import NotNegative, Positive, Settings
from risc_lab.states import S


@dataclass(frozen=True)
class Params(Settings):
    """Diagonals of Q and R: about the best without prediction for velocities that arrive 0.12 s late (filter `thesis`).

    Such velocities allow no larger gain. The original's weights (17.22, 1.62) oscillate at 0.1 s of command delay.
    """

    q_position: NotNegative = 1.5  # horizontal [1/m^2]
    q_velocity: NotNegative = 0.0  # [1/(m/s)^2]
    r_horizontal: Positive = 1.0  # [1/(m/s^2)^2]
    q_height: NotNegative = 2.0  # vertical [1/m^2]
    q_climb: NotNegative = 1.0
    r_vertical: Positive = 1.0
    q_yaw: NotNegative = 1.0  # [1/rad^2]
    r_yaw: Positive = 1.0
    error_max_m: Positive = 0.4  # [m] larger position errors are shortened to this


_GAINS = record("position velocity height climb yaw")
_VEHICLE = record("mass_kg tilt_max_rad")


class Controller(controllers.Controller):
    """See the module. It ignores delays and who flies, and stores nothing."""

    PARAMS = Params
    # Measured together with the thesis' own filter; with a filter without delay its error is half as large.
    ESTIMATOR = "thesis"

    def __init__(self, vehicle_types, params):
        super().__init__(vehicle_types, params)
        most = [greatest_command(vehicle_type) for vehicle_type in vehicle_types]
        self._vehicles = np.zeros(len(vehicle_types), _VEHICLE)
        self._vehicles["mass_kg"] = self.mass_kg
        self._vehicles["tilt_max_rad"] = [min(limit.roll_rad, limit.pitch_rad) for limit in most]

    def design(self, params):
        """(1,) _GAINS from the weights. Raises ValueError when there is no solution."""
        A, B = [[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]]
        horizontal = lqr_gain(A, B, [params.q_position, params.q_velocity], [params.r_horizontal])[0]
        vertical = lqr_gain(A, B, [params.q_height, params.q_climb], [params.r_vertical])[0]
        yaw = lqr_gain([[0.0]], [[1.0]], [params.q_yaw], [params.r_yaw])[0]
        return np.array([(*horizontal, *vertical, *yaw)], _GAINS)

    def step(self, t, states, reference, params):
        """As `controllers.Controller`."""
        commands = np.zeros((len(Command._fields), len(self.mass_kg)))
        _step(
            self._vehicles,
            self.designed,
            float(params.error_max_m),
            floats(states.vehicles.x),
            states.vehicles.visible & reference.usable,
            floats(reference.present),
            commands,
            self.saturated,
        )
        return Command(commands[0], commands[1], commands[2], commands[3])


@compiled
def _step(vehicles, gains, error_max_m, x, usable, present, commands, saturated):
    """Fills commands (4, n), NaN for a vehicle of which a number is not finite, and saturated (n,)."""
    K = gains[0]
    for i in range(len(vehicles)):
        saturated[i] = False
        if not usable[i]:
            continue
        position, velocity, acceleration = present[0, i], present[1, i], present[2, i]
        # (7.7): u = K (x_r - x), with the position error shortened to its limit
        e_x, e_y, e_z = position[Axis.X] - x[i, S.X], position[Axis.Y] - x[i, S.Y], position[Axis.Z] - x[i, S.Z]
        distance_m = math.sqrt(e_x * e_x + e_y * e_y + e_z * e_z)
        scale = error_max_m / distance_m if distance_m > error_max_m else 1.0
        u_x = K.position * scale * e_x + K.velocity * (velocity[Axis.X] - x[i, S.U])
        u_y = K.position * scale * e_y + K.velocity * (velocity[Axis.Y] - x[i, S.V])
        u_z = K.height * scale * e_z + K.climb * (velocity[Axis.Z] - x[i, S.W])
        # (7.8)-(7.10), from cortex axes to north, east and up
        f = Acceleration(
            u_x + acceleration[Axis.X], -(u_y + acceleration[Axis.Y]), u_z + acceleration[Axis.Z] + GRAVITY_M_S2
        )
        psi = x[i, S.PSI]
        yaw_rate = velocity[Axis.PSI] + K.yaw * wrapped(position[Axis.PSI] - psi)
        # squares, as the norm in `flat_inputs` must be finite
        if not math.isfinite(f.north * f.north + f.east * f.east + f.up * f.up + yaw_rate):
            commands[:, i] = math.nan
            continue
        f, saturated[i] = limit_tilt(f, vehicles[i].tilt_max_rad)
        commands[0, i], commands[1, i], commands[2, i], commands[3, i] = flat_inputs(
            f, psi, yaw_rate, vehicles[i].mass_kg
        )
