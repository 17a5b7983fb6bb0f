"""Charge and time in the air of every vehicle, from its status messages."""

import math
from dataclasses import dataclass, field

from data_extraction.report.recorded_topics import PerName, vehicle_of
from data_extraction.samples import Samples
from risc_control.vehicles import NO_EVIDENCE, ON_GROUND

_ROWS = 4000  # most samples that are drawn
_GAP_S = 2.0  # after a longer silence, what happened meanwhile is unknown


@dataclass
class Battery:
    """One vehicle's battery."""

    samples: Samples = field(default_factory=lambda: Samples(2, _ROWS))  # receipt [s], charge [%]
    last_pct: float | None = None
    air_s: float = 0.0  # time in the air
    last_s: float = 0.0  # receipt of the newest status
    flying: bool = False

    @property
    def first_pct(self):
        return self.samples.first[1]


class BatteryCollector(PerName):
    """Collects each vehicle's Battery, in constant memory."""

    ends = ("/vehicle_status",)

    def __call__(self, topic, receipt_s, message):
        vehicle = self.found.setdefault(vehicle_of(topic), Battery())
        if vehicle.flying and receipt_s - vehicle.last_s < _GAP_S:
            vehicle.air_s += receipt_s - vehicle.last_s
        vehicle.flying, vehicle.last_s = message.state not in ON_GROUND | NO_EVIDENCE, receipt_s
        if not math.isnan(message.battery_pct):
            vehicle.last_pct = message.battery_pct
            vehicle.samples.append((receipt_s, vehicle.last_pct))

    def result(self, end_s):
        """{vehicle: Battery} of those that reported a charge."""
        return {name: item for name, item in super().result(end_s).items() if item.last_pct is not None}
