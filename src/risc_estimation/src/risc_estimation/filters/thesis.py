"""The original release's estimator: lines through 50 samples at 200 Hz, positions and angles as they are measured."""

from risc_estimation.filters.least_squares import Filter

__all__ = ["Filter"]
