"""Each frame is lost with this probability, independently of the others."""

from risc_simulator.faults.drop import make

__all__ = ["make"]
