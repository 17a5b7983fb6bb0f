"""AR.Drone 2.0: see vehicles/__init__.py for what a type gives."""

from risc_lab.lab.calibration import BOTTOM_MOUNT, FRONT_MOUNT
from risc_simulator.vehicles import VirtualCamera
from risc_simulator.vehicles.ardrone.firmware import ArdroneFirmware as Firmware
from risc_simulator.vehicles.ardrone.host import ArdroneHost as Host
from risc_simulator.vehicles.ardrone.navdata import repeated
from risc_simulator.vehicles.ardrone.offline import OfflineLink
from risc_simulator.vehicles.ardrone.on_board import FIELDS, after_step, before_step
from risc_simulator.vehicles.ardrone.telemetry import Telemetry

CAMERAS = (
    VirtualCamera("front", "ardrone_front.yaml", FRONT_MOUNT, by_fleet=True),
    VirtualCamera("bottom", "ardrone_bottom.yaml", BOTTOM_MOUNT, sensor_px=(320, 180)),
)
__all__ = ["CAMERAS", "FIELDS", "Firmware", "Host", "OfflineLink", "Telemetry", "after_step", "before_step", "repeated"]
