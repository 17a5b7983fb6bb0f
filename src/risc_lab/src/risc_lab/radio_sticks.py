"""Extra settings of vehicle types that are flown by the sticks of a radio, for the vehicle node and the virtual lab."""

import math
import typing
from dataclasses import dataclass

from msgspec import Meta

from risc_lab.settings import Positive, Settings, between


@dataclass(frozen=True)
class RadioSticks(Settings):
    """`own` in the YAML file of such a type."""

    # [-] per percent^i: c0 to c4 of eq. 5.5, the hover throttle in [-1, 1] by charge
    hover_throttle: typing.Annotated[tuple[float, ...], Meta(min_length=1)]
    stick_dead_zone: between(0.0, 0.5) = 0.0  # of a stick's half travel around its centre, roll, pitch and yaw
    # fastest change of a stick that a transmitter's board follows, of half travel: per second, and from one message to
    # the next
    stick_rate_1_s: Positive = math.inf
    stick_step: Positive = math.inf

    def hovers_at(self, battery_pct):
        """Hover throttle in [-1, 1] of the nominal vehicle with this charge, eq. 5.5."""
        throttle = 0.0
        for coefficient in reversed(self.hover_throttle):
            throttle = throttle * battery_pct + coefficient
        return throttle
