"""Horizontal gusts of up to this speed [m/s], one after another, each of random length and direction, that rise and
fall smoothly.
"""

import math

import numpy as np

from risc_simulator.faults._frames import level_direction

SHORTEST_S, LONGEST_S = 0.5, 1.5


class Gusts:
    def __init__(self, peak_m_s, rng):
        self._peak_m_s, self._rng = peak_m_s, rng
        self._from_s = self._length_s = 0.0
        self._wind_m_s = np.zeros(3)  # its share of the wind now

    def begin(self, vehicle, time_s):
        self._next(time_s)

    def step(self, vehicle, time_s):
        if time_s >= self._from_s + self._length_s:
            self._next(time_s)
        rise = 0.5 * (1.0 - math.cos(2.0 * math.pi * (time_s - self._from_s) / self._length_s))
        self._blow(vehicle, rise * self._velocity_m_s)

    def end(self, vehicle, time_s):
        self._blow(vehicle, np.zeros(3))

    def _blow(self, vehicle, wind_m_s):
        vehicle.change_wind(wind_m_s - self._wind_m_s)
        self._wind_m_s = wind_m_s

    def _next(self, time_s):
        self._from_s, self._length_s = time_s, self._rng.uniform(SHORTEST_S, LONGEST_S)
        self._velocity_m_s = self._peak_m_s * level_direction(self._rng)


def make(severity, rng):
    return Gusts(severity, rng)
