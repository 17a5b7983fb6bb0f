"""The navdata of an AR.Drone without sockets, for offline flights: see vehicles/__init__.py."""

from zlib import crc32

import numpy as np

from ardrone_autonomy.protocol.navdata import DEMO_PERIOD, FULL_RATE_HZ, Navdata, NavdataError, Tag
from risc_simulator.vehicles.ardrone.host import NO_STICKS
from risc_simulator.vehicles.ardrone.navdata import Frame, NavdataWriter
from risc_simulator.vehicles.ardrone.profiles import ConfigurationStore
from risc_simulator.vehicles.ardrone.sensors import ArdroneSensors

# Options that the driver's message is made of; no reading depends on the commands.
_OPTIONS = Tag.DEMO, Tag.TIME, Tag.PHYS_MEASURES, Tag.PWM, Tag.PRESSURE_RAW, Tag.MAGNETO, Tag.WIND_SPEED
_NOT_TOLD = {
    "sticks": NO_STICKS,
    "command": (0.0, 0.0, 0.0, 0.0),
    "ref_sequence": 0,
    "ref_gap_ms": 0.0,
    "picture": (0, 0),
}


class Telemetry:
    """Packets as the host sends them, messages as the driver makes them."""

    channel = "navdata"
    period_s = DEMO_PERIOD / FULL_RATE_HZ  # as launch/driver.launch asks for

    def __init__(self, vehicle, seed, noise):
        """vehicle: world.Vehicle, still on the floor.  noise: factor, 0 = exact sensors."""
        from ardrone_autonomy.ros.conversions import navdata_message  # with ROS only

        rng = np.random.default_rng([seed, crc32(vehicle.namespace.encode("utf-8"))])
        self.sensors = ArdroneSensors(rng, noise, vehicle.height_m, lambda: vehicle.firmware.flow)
        self._vehicle, self._make_message = vehicle, navdata_message
        self.get = ConfigurationStore().get
        self._writer, self._sequence = NavdataWriter(_OPTIONS, self), 0

    def packet(self, time_s):
        """Packet that the vehicle sends at world time time_s [s], which is now."""
        self._sequence += 1
        reading = self.sensors.read(self._vehicle.state, self._vehicle.firmware.motors_on, time_s)
        frame = Frame(
            reading=reading, time_s=time_s, ctrl_state=0, cycles=self._sequence, trim_deg=(0.0, 0.0), **_NOT_TOLD
        )
        return bytes(self._writer.packet(frame, 0, self._sequence))

    def message(self, packet, header):
        """Message that the driver makes from a packet; None if the packet is damaged."""
        try:
            return self._make_message(Navdata(packet), header)
        except NavdataError:
            return None
