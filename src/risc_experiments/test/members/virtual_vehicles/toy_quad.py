"""The made-up quadrotor: its attitude loops take radians; the third stick is its thrust, and nothing holds a height.

Its wire: UDP 4050 takes a text, an order or four sticks; every packet on UDP 4051 is answered with state and charge.
"""

import socket

from risc_control.vehicles import REGISTRY
from risc_lab.compiled import compiled
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab.vehicle_types import own_numbers
from risc_simulator.models import flight
from risc_simulator.models.flight import FlightAction, FlightPhase
from risc_simulator.models.quadrotor import U, level_motion
from risc_simulator.socket_host import VehicleHost

FIELDS = (("thrust_m_s2", float),)  # less gravity


@compiled
def before_step(x, inputs, vehicle):
    """Cancel the climb loop of the common equations: it asks for the present climb rate, so only the thrust acts."""
    inputs[U.CLIMB], inputs[U.CLIMB_TRIM] = level_motion(x)[0], vehicle.thrust_m_s2


class Firmware(flight.Firmware):
    """Carries out commands."""

    def __init__(self, vehicle_type, rng, perturbed, rest_height_m):
        super().__init__(vehicle_type, rng, perturbed, rest_height_m)
        self._numbers = own_numbers(vehicle_type, REGISTRY.module("toy_quad").Params)

    def configure(self, record):
        self._record = record
        record["thrust_m_s2"] = 0.0

    def apply(self, action, time_s, vertical_motion):
        if action is FlightAction.TAKE_OFF and self.phase is FlightPhase.LANDED:
            self.fly_at(time_s, 0.0)
        elif action is FlightAction.CUT_MOTORS:
            self.crash(time_s)
        elif isinstance(action, FlightAction):
            self.phase = FlightPhase.LANDING if action is FlightAction.LAND else self.phase
        elif self.motors_on:
            up = action.climb_m_s  # the stick, as a full scale of 1 leaves it
            self._record["thrust_m_s2"] = GRAVITY_M_S2 * (self._numbers.weights(up) - 1.0)
            self.command = (action.roll_rad, action.pitch_rad, action.yaw_rate_rad_s, 0.0)


class Host(VehicleHost):
    """See the module."""

    STATES = {FlightPhase.LANDED: 2, FlightPhase.FLYING: 3, FlightPhase.LANDING: 8}  # numbers of FlightState

    def __init__(self, vehicle, address, seed=0, radio_loss=0.0, wires=None):
        super().__init__(vehicle, wires)
        self._commands, self._status = self._bound(address, 4050), self._bound(address, 4051)
        self._wires = {
            self._commands: (self.wire("commands"), self._obey),
            self._status: (self.wire("status"), self._answer),
        }

    def _bound(self, address, port):
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.bind((address, port))
        self._waiting.add(sock)
        return sock

    def on_readable(self, sock, now_s):
        wire, deliver = self._wires[sock]
        wire.carry(*sock.recvfrom(64), now_s, deliver)

    def _obey(self, data, _sender, now_s):
        order, *numbers = data.decode().split()
        if order == "sticks":
            forward, left, up, turn = map(float, numbers)
            tilt_rad, turn_rad_s = self._vehicle.type.tilt_max_rad, self._vehicle.type.yaw_rate_max_rad_s
            action = flight.Setpoint(-left * tilt_rad, -forward * tilt_rad, up, -turn * turn_rad_s)
        else:
            action = FlightAction[order.upper()]
        self._vehicle.schedule(now_s, action)

    def _answer(self, _data, client, _now_s):
        text = "%d %.1f" % (self.STATES.get(self._vehicle.phase, 0), self._vehicle.battery_pct)
        self._status.sendto(text.encode(), client)

    def tick(self, now_s):
        self._now_s = now_s

    def describe(self):
        return "%s: a toy quadrotor" % self._vehicle.namespace

    def close(self):
        for sock in self._wires:
            sock.close()
        self._waiting.close()
