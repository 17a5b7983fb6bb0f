"""All that a vehicle receives and sends arrives later by this time [s]."""

from risc_simulator.faults.delay import make

__all__ = ["make"]
