"""The battery loses charge at this rate [%/s], in addition to what flying takes."""


class Failing:
    def __init__(self, pct_s):
        self._pct_s = pct_s

    def begin(self, vehicle, time_s):
        self._time_s = time_s

    def step(self, vehicle, time_s):
        vehicle.set_battery_pct(vehicle.battery_pct - self._pct_s * (time_s - self._time_s))
        self._time_s = time_s


def make(severity, rng):
    return Failing(severity)
