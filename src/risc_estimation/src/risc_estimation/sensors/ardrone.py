"""Navdata of an AR.Drone, as ardrone_autonomy publishes them: x forward, y left, z up; frd_to_flu is self-inverse."""

import numpy as np

from risc_lab.frames import GRAVITY_M_S2, frd_to_flu

TOPIC, TYPE = "ardrone/navdata", "ardrone_autonomy/Navdata"


def readings(navdata):
    """See `risc_estimation.sensors`. The velocity is in level axes; a navdata option that is not sent reads 0."""
    quantities = {
        "attitude": frd_to_flu(np.radians((navdata.rotX, navdata.rotY, navdata.rotZ))),
        "velocity": frd_to_flu((navdata.vx, navdata.vy, navdata.vz)) / 1e3,
        "height": np.array([navdata.altd / 1e3]),
    }
    if navdata.ax or navdata.ay or navdata.az:
        quantities["specific_force"] = GRAVITY_M_S2 * frd_to_flu((navdata.ax, navdata.ay, navdata.az))
    return quantities
