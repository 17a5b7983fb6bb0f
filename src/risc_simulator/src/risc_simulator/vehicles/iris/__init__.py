"""3DR IRIS+: see vehicles/__init__.py for what a type gives."""

from risc_simulator.vehicles.iris.firmware import IrisFirmware as Firmware
from risc_simulator.vehicles.iris.on_board import FIELDS, after_step, before_step, slope

__all__ = ["FIELDS", "Firmware", "after_step", "before_step", "slope"]
