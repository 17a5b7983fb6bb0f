"""Steady horizontal wind of this speed [m/s], in a direction that the seed chooses."""

from risc_simulator.faults._frames import level_direction


class Wind:
    def __init__(self, wind_m_s):
        self._wind_m_s = wind_m_s

    def begin(self, vehicle, time_s):
        vehicle.change_wind(self._wind_m_s)

    def end(self, vehicle, time_s):
        vehicle.change_wind(-self._wind_m_s)


def make(severity, rng):
    return Wind(severity * level_direction(rng))
