"""3DR IRIS+: see vehicles/__init__.py for what a type gives."""

from risc_simulator.vehicles.iris.firmware import IrisFirmware as Firmware
from risc_simulator.vehicles.iris.host import IrisHost as Host
from risc_simulator.vehicles.iris.mavlink import repeated
from risc_simulator.vehicles.iris.offline import OfflineLink
from risc_simulator.vehicles.iris.on_board import FIELDS, after_step, before_step, slope

__all__ = ["FIELDS", "Firmware", "Host", "OfflineLink", "after_step", "before_step", "repeated", "slope"]
