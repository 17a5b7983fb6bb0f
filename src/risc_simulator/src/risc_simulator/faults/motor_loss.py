"""A motor stops. Firmware that watches for it stops the others; otherwise the lift of the opposite rotor rolls the
vehicle over: nothing controls its roll, and half its thrust is left.
"""

from dataclasses import replace

from risc_lab.frames import GRAVITY_M_S2
from risc_simulator.models.flight import FlightAction

ARM = 0.6  # from the centre to a rotor, as a fraction of the vehicle's radius
OPEN_RAD_S = 0.1  # bandwidth of a loop without control moment: practically none


class Loss:
    def begin(self, vehicle, time_s):
        self._time_s = time_s
        if vehicle.firmware.STOPS_WITH_A_MOTOR:
            vehicle.schedule(time_s, FlightAction.CUT_MOTORS)
            self._turns_1_s2 = 0.0
            return
        plant = vehicle.plant
        lift_n = 0.25 * plant.nominal_mass_kg * GRAVITY_M_S2
        self._turns_1_s2 = lift_n * ARM * vehicle.type.radius_m / plant.inertia_kg_m2[0]
        roll = replace(plant.roll, natural_frequency_rad_s=OPEN_RAD_S)
        vehicle.change_plant(roll=roll, thrust_scale=0.5 * plant.thrust_scale)

    def step(self, vehicle, time_s):
        if self._turns_1_s2 and vehicle.firmware.lifted and vehicle.firmware.motors_on:
            vehicle.turn(self._turns_1_s2 * (time_s - self._time_s))
        self._time_s = time_s


def make(severity, rng):
    return Loss()
