"""AR.Drone: thrust -> the climb rate that its vertical command asks for (thesis 5.1, eqs 5.3-5.4)."""

import math

from risc_lab.frames import GRAVITY_M_S2


def climb_rate_command(thrust_n, phi_rad, theta_rad, climb_rate_m_s, delay_s, mass_kg):
    """Climb rate to command [m/s, + up]: (5.3)-(5.4), zdot_c = zdot + delay (T cos(phi) cos(theta)/m - g).

    phi, theta: attitude that the vehicle has [rad].  climb_rate_m_s: its climb rate zdot.  With `delay_s` equal to the
    time constant of the vehicle's climb loop this inverts the loop: the vertical acceleration becomes the wanted one.
    """
    a_up_m_s2 = thrust_n * math.cos(phi_rad) * math.cos(theta_rad) / mass_kg - GRAVITY_M_S2
    return climb_rate_m_s + delay_s * a_up_m_s2
