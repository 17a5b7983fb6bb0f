"""AR.Drone 2.0: see vehicles/__init__.py for what a type gives."""

from risc_simulator.vehicles.ardrone.firmware import ArdroneFirmware as Firmware
from risc_simulator.vehicles.ardrone.host import ArdroneHost as Host
from risc_simulator.vehicles.ardrone.on_board import FIELDS, after_step, before_step

__all__ = ["FIELDS", "Firmware", "Host", "after_step", "before_step"]
