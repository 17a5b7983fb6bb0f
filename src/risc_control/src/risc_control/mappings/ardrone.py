"""AR.Drone: thrust and attitude <-> the fractions of /controls and cmd_vel (thesis 5.1, eqs 5.1-5.4).

Signs of /controls, as in the original release: + phi moves left, + theta moves forward, + psi turns left. All three
are opposite to the angles phi, theta, psi of the states (+ right, + nose up, + clockwise).

A fraction of 1 asks the vehicle for its full scale (`euler_angle_max`, `control_yaw`). Its attitude loops settle at
`gain` times what they are asked for (1.17 in roll, 1.11 in pitch), so the wanted angle is divided by the gain here,
where an angle becomes a fraction, and nowhere else.
"""

from typing import NamedTuple

import numpy as np

from risc_control.flatness import FlatInputs
from risc_control.frames import GRAVITY_M_S2


class Fractions(NamedTuple):
    """What /controls carries for an AR.Drone: arrays (n,)."""

    phi: np.ndarray  # [-1, 1] + left
    theta: np.ndarray  # [-1, 1] + forward
    psi: np.ndarray  # [-1, 1] + counter-clockwise
    thrust_n: np.ndarray


class ArdroneMapping:
    """FlatInputs <-> Fractions for n vehicles."""

    def __init__(self, vehicle_types, tilt_max_rad=None, yaw_rate_max_rad_s=None):
        """vehicle_types: VehicleType of each vehicle. The limits override the types' full scales (floats or None).

        They must be what the driver has set on the vehicle, or every angle is scaled.
        """
        self.tilt_max_rad = _column(vehicle_types, "tilt_max_rad", tilt_max_rad)
        self.yaw_rate_max_rad_s = _column(vehicle_types, "yaw_rate_max_rad_s", yaw_rate_max_rad_s)
        roll_gain = np.array([vehicle_type.roll.gain for vehicle_type in vehicle_types])
        pitch_gain = np.array([vehicle_type.pitch.gain for vehicle_type in vehicle_types])
        self._full_scale = -np.stack(
            [roll_gain * self.tilt_max_rad, pitch_gain * self.tilt_max_rad, self.yaw_rate_max_rad_s]
        )  # (3, n) angle or rate, NED sense, at a fraction of 1

    def to_fractions(self, inputs):
        """(Fractions clipped to [-1, 1], saturated (3, n) bool: phi, theta, psi) of FlatInputs (arrays (n,)).

        Raises ValueError when a number is not finite: such a command must never leave the controller.
        """
        wanted = np.array([inputs.phi_rad, inputs.theta_rad, inputs.yaw_rate_rad_s]) / self._full_scale
        if not np.isfinite(wanted).all() or not np.isfinite(inputs.thrust_n).all():
            raise ValueError("refusing a command that is not finite: %r" % (inputs,))
        clipped = np.minimum(np.maximum(wanted, -1.0), 1.0)
        return Fractions(*clipped, inputs.thrust_n), clipped != wanted

    def to_inputs(self, fractions):
        """FlatInputs that the vehicles reach with these Fractions: the inverse, inside the limits."""
        angles = np.array([fractions.phi, fractions.theta, fractions.psi]) * self._full_scale
        return FlatInputs(fractions.thrust_n, angles[0], angles[1], angles[2])


def climb_rate_command(thrust_n, phi_rad, theta_rad, climb_rate_m_s, delay_s, mass_kg):
    """Climb rate to command [m/s, + up]: (5.3)-(5.4), zdot_c = zdot + delay (T cos(phi) cos(theta)/m - g).

    phi, theta: attitude that the vehicle has [rad].  climb_rate_m_s: its climb rate zdot.  With `delay_s` equal to the
    time constant of the vehicle's climb loop this inverts the loop: the vertical acceleration becomes the wanted one.
    """
    a_up_m_s2 = thrust_n * np.cos(phi_rad) * np.cos(theta_rad) / mass_kg - GRAVITY_M_S2
    return climb_rate_m_s + delay_s * a_up_m_s2


def thrust_for_climb_rate(climb_command_m_s, phi_rad, theta_rad, climb_rate_m_s, delay_s, mass_kg):
    """Thrust [N] for which `climb_rate_command` gives this climb rate: its inverse (tilt below 90 degrees)."""
    a_up_m_s2 = (climb_command_m_s - climb_rate_m_s) / delay_s
    return mass_kg * (a_up_m_s2 + GRAVITY_M_S2) / (np.cos(phi_rad) * np.cos(theta_rad))


def _column(vehicle_types, name, override):
    values = [getattr(vehicle_type, name) if override is None else override for vehicle_type in vehicle_types]
    column = np.array(values, dtype=float)
    if not (column > 0.0).all() or not np.isfinite(column).all():
        raise ValueError("%s must be positive, got %r" % (name, values))
    return column
