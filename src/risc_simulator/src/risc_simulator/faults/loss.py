"""Frames are lost with this probability, one by one."""

from risc_simulator.faults.drop import make

__all__ = ["make"]
