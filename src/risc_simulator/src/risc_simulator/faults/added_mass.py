"""The vehicle is heavier by this share of its mass; its on-board logic does not know."""


class Load:
    def __init__(self, share):
        self._share = share

    def begin(self, vehicle, time_s):
        vehicle.change_plant(mass_kg=vehicle.plant.mass_kg * (1.0 + self._share))

    def end(self, vehicle, time_s):
        vehicle.change_plant(mass_kg=vehicle.plant.mass_kg / (1.0 + self._share))


def make(severity, rng):
    return Load(severity)
