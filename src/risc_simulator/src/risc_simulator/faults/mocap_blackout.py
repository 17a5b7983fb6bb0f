"""No frame arrives."""

from risc_simulator.faults.blackhole import make

__all__ = ["make"]
