"""Nothing passes between a vehicle and the rest of the world; streams are held up."""

from risc_simulator.faults.blackhole import make

__all__ = ["make"]
