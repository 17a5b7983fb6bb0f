"""A fault for tests: the motors of a vehicle stop."""

from risc_simulator.models.flight import FlightAction


class Cutout:
    def begin(self, vehicle, time_s):
        vehicle.schedule(time_s, FlightAction.CUT_MOTORS)


def make(severity, rng):
    return Cutout()
