"""Charge and time in the air of every vehicle, from its navdata."""

from dataclasses import dataclass

import numpy as np

from data_extraction.report.naming import vehicle_of
from data_extraction.samples import Samples
from risc_control.vehicle_pilot import FlightState

NAVDATA = "/navdata"
_ROWS = 4000  # that are drawn
_GAP_S = 2.0  # navdata are silent for longer: nobody knows what happened meanwhile
_IN_THE_AIR = frozenset(
    (
        FlightState.FLYING, FlightState.HOVERING, FlightState.TAKING_OFF, FlightState.GOTO, FlightState.LANDING,
        FlightState.LOOPING,
    )
)  # fmt: skip


@dataclass
class Battery:
    """One vehicle's battery."""

    t_s: np.ndarray  # (n,) receipt [s]
    charge_pct: np.ndarray  # (n,) [%]
    first_pct: float
    last_pct: float
    air_s: float  # time in the air


class _Vehicle:
    def __init__(self):
        self.samples = Samples(2, _ROWS)
        self.first_pct = self.last_pct = None
        self.last_s = None
        self.flying = False
        self.air_s = 0.0


class BatteryCollector:
    """Takes the messages of a bag one by one; its memory does not grow."""

    def __init__(self):
        self._vehicles = {}

    def wants(self, topic):
        """Whether messages of this topic say anything here."""
        return topic.endswith(NAVDATA)

    def __call__(self, topic, receipt_s, message):
        """Take one message; topics that are of no interest are passed over."""
        if not topic.endswith(NAVDATA):
            return
        vehicle = self._vehicles.setdefault(vehicle_of(topic, levels=2), _Vehicle())
        if vehicle.flying and receipt_s - vehicle.last_s < _GAP_S:
            vehicle.air_s += receipt_s - vehicle.last_s
        vehicle.flying = message.state in _IN_THE_AIR
        vehicle.last_s = receipt_s
        charge_pct = float(message.batteryPercent)
        if charge_pct > 0.0:  # 0: not reported
            vehicle.samples.append((receipt_s, charge_pct))
            vehicle.last_pct = charge_pct
            if vehicle.first_pct is None:
                vehicle.first_pct = charge_pct

    def batteries(self):
        """{vehicle: Battery} of those that reported a charge."""
        result = {}
        for name, vehicle in sorted(self._vehicles.items()):
            if vehicle.first_pct is not None:
                t_s, charge_pct = vehicle.samples.table().T
                result[name] = Battery(t_s, charge_pct, vehicle.first_pct, vehicle.last_pct, vehicle.air_s)
        return result
