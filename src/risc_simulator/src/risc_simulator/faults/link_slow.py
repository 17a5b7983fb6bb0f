"""All that a vehicle hears and says arrives later by this time [s]."""

from risc_simulator.faults.delay import make

__all__ = ["make"]
