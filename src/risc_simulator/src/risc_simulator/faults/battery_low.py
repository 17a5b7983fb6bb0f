"""The battery holds no more than this [%]; it does not recover."""


class Low:
    def __init__(self, pct):
        self._pct = pct

    def begin(self, vehicle, time_s):
        vehicle.weaken_battery(min(self._pct, vehicle.battery_pct))


def make(severity, rng):
    return Low(severity)
