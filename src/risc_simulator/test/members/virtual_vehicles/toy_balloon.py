"""A vehicle type for tests: takes one text per UDP datagram ("up 0.3"), answers its height; a camera looks back."""

import math
import pathlib
import re
import socket

from risc_lab.compiled import compiled
from risc_lab.lab.calibration import CameraMount
from risc_simulator.models import flight
from risc_simulator.models.flight import FlightAction
from risc_simulator.models.quadrotor import U, X
from risc_simulator.socket_host import VehicleHost, open_socket
from risc_simulator.vehicles import VirtualCamera

PORT, VIDEO_PORT = 4040, 4041
CALIBRATION = pathlib.Path(__file__).parents[1] / "cameras/toy_balloon.yaml"
CAMERAS = (VirtualCamera("rear", str(CALIBRATION), CameraMount((-0.1, 0.0, 0.0), yaw_rad=math.pi)),)
FIELDS = (("buoyancy_m_s2", float),)


@compiled
def slope(x, inputs, vehicle, x_dot):
    """Upright, without horizontal motion; h'' = (climb command - h') / tau + buoyancy."""
    x_dot[:] = 0.0
    up_m_s2 = (inputs[U.CLIMB] + x[X.W]) / vehicle.climb_time_constant_s + vehicle.buoyancy_m_s2
    x_dot[X.H] = -x[X.W]
    x_dot[X.W] = -up_m_s2
    return vehicle.mass_kg * up_m_s2


def repeated(told, datagram):
    """Replace every height by the first one."""
    return told.setdefault("height", datagram) if re.fullmatch(rb"-?\d+\.\d{3}", datagram) else datagram


class Firmware(flight.Firmware):
    """Flies when given a climb rate, falls when told to land."""

    def configure(self, record):
        record["buoyancy_m_s2"] = 0.0

    def apply(self, action, time_s, vertical_motion):
        if action is FlightAction.LAND:
            self.crash(time_s)
        else:
            self.command = (0.0, 0.0, 0.0, action.climb_m_s)
            self.fly_at(time_s, 0.0)


class Host(VehicleHost):
    """Answers each "up NUMBER" with the height [m]."""

    def __init__(self, vehicle, address, seed=0, radio_loss=0.0, wires=None):
        super().__init__(vehicle, wires)
        self._commands, self._heights = self.wire("commands"), self.wire("heights")
        self._socket = open_socket(socket.SOCK_DGRAM, address, PORT, vehicle.namespace)
        self.video_listener = open_socket(socket.SOCK_STREAM, address, VIDEO_PORT, vehicle.namespace)
        self._waiting.add(self._socket)

    def attach_video(self, video):
        video.configure(channel=0, rate_hz=20.0, bitrate_kbit_s=500.0, enabled=True)

    def on_readable(self, sock, now_s):
        self._commands.carry(*sock.recvfrom(64), now_s, self._obey)

    def _obey(self, data, sender, now_s):
        self._vehicle.schedule(now_s, flight.Setpoint(climb_m_s=float(data.split()[1])))
        self._heights.carry(b"%.3f" % self._vehicle.height_m, sender, now_s, self._answer)

    def _answer(self, data, client, _now_s):
        self._socket.sendto(data, client)

    def tick(self, now_s):
        self._now_s = now_s

    def describe(self):
        return "%s: a balloon" % self._vehicle.namespace

    def close(self):
        self._socket.close()
        self.video_listener.close()
        self._waiting.close()
