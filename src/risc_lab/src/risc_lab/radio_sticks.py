"""Vehicles that are flown by the sticks of a radio: what their types have of their own, for both sides."""

import math
import typing
from dataclasses import dataclass

from msgspec import Meta

from risc_lab.settings import Positive, Settings, between


@dataclass(frozen=True)
class RadioSticks(Settings):
    """`own` in the YAML file of such a type."""

    # [-] per percent^i: c0 to c4 of eq. 5.5, the throttle in [-1, 1] that hovers at a charge
    hover_throttle: typing.Annotated[tuple[float, ...], Meta(min_length=1)]
    stick_dead_zone: between(0.0, 0.5) = 0.0  # of a stick's half travel around its centre, roll, pitch and yaw
    # what a transmitter's board follows at once, of half travel: change of a stick per second, and from one message to
    # the next
    stick_rate_1_s: Positive = math.inf
    stick_step: Positive = math.inf

    def hovers_at(self, battery_pct):
        """Throttle in [-1, 1] that hovers the nominal vehicle with this charge, eq. 5.5."""
        throttle = 0.0
        for coefficient in reversed(self.hover_throttle):
            throttle = throttle * battery_pct + coefficient
        return throttle
