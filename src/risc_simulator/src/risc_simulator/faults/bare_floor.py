"""The floor below has no texture: the bottom camera of a vehicle that has one sees nothing move."""


class BareFloor:
    def begin(self, vehicle, time_s):
        vehicle.firmware.see_floor(False)

    def end(self, vehicle, time_s):
        vehicle.firmware.see_floor(True)


def make(severity, rng):
    return BareFloor()
