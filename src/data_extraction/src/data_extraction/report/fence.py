"""How far every vehicle was from the net, as its loss ladder sees it: now, and where it would be a little later."""

from dataclasses import dataclass

import numpy as np

from data_extraction.flatten import seconds
from data_extraction.samples import Samples
from risc_control.failsafe import SafetyLimits

STATES = "/cortex_raw"
_BLOCK_S = 0.1  # the least margin of so long is one point of the drawing
_ROWS = 50_000  # more are thinned out; the least margin of all is kept beside them


@dataclass
class FenceMargin:
    """One vehicle's distance from the fence (risc_control.failsafe.SafetyLimits): positive inside."""

    t_s: np.ndarray  # (n,) stamp [s] of the blocks below
    now_m: np.ndarray  # (n,) [m] least margin of the position in the block
    ahead_m: np.ndarray  # (n,) [m] least of both, the position and the place it reaches within the look-ahead
    limits: SafetyLimits
    least_m: float  # of the position, over everything
    least_s: float  # stamp
    least_place_m: tuple[float, float, float]  # cortex frame
    least_ahead_m: float


class _Vehicle:
    def __init__(self, limits):
        self.limits = limits
        self.samples = Samples(3, _ROWS)
        self.block = None  # [stamp of its begin, now, ahead]
        self.least = None  # (margin, stamp, place)
        self.least_ahead_m = np.inf


class FenceCollector:
    """Takes the messages of a bag one by one; its memory does not grow."""

    def __init__(self, limits=None, default=None):
        """limits: {vehicle's template: SafetyLimits}.  default: of the others, None = that of SafetyLimits."""
        self._limits, self._default = limits or {}, default or SafetyLimits()
        self._vehicles = {}

    def wants(self, topic):
        """Whether messages of this topic say anything here."""
        return topic == STATES

    def __call__(self, topic, receipt_s, message):
        """Take one message; topics that are of no interest are passed over."""
        if topic != STATES:
            return
        stamp_s = seconds(message.header.stamp) or receipt_s
        for state in message.Obj:
            if state.visible:
                if state.name not in self._vehicles:
                    self._vehicles[state.name] = _Vehicle(self._limits.get(state.name, self._default))
                _note(self._vehicles[state.name], stamp_s, state)

    def margins(self):
        """{vehicle: FenceMargin}."""
        result = {}
        for name, vehicle in sorted(self._vehicles.items()):
            table = np.vstack((vehicle.samples.table(), [vehicle.block]))
            result[name] = FenceMargin(*table.T, vehicle.limits, *vehicle.least, vehicle.least_ahead_m)
        return result


def _note(vehicle, stamp_s, state):
    now_m, ahead_m = margin(vehicle.limits, (state.x, state.y, state.z), (state.u, state.v, state.w))
    if vehicle.least is None or now_m < vehicle.least[0]:
        vehicle.least = (now_m, stamp_s, (state.x, state.y, state.z))
    vehicle.least_ahead_m = min(vehicle.least_ahead_m, ahead_m)
    block = vehicle.block
    if block is not None and 0.0 <= stamp_s - block[0] < _BLOCK_S:
        block[1], block[2] = min(block[1], now_m), min(block[2], ahead_m)
        return
    if block is not None:
        vehicle.samples.append(block)
    vehicle.block = [stamp_s, now_m, ahead_m]


def margin(limits, position_m, velocity_m_s):
    """(margin of the position, least of it and of the margin after the look-ahead) [m]; both vectors in cortex axes.

    A lower side that lies below the floor is no net: nothing can come near it.
    """
    now_m = ahead_m = np.inf
    low_x, low_y, low_z = limits.fence_min_m
    lowest = (low_x, low_y, low_z if low_z >= 0.0 else -np.inf)
    for low, value, rate, high in zip(lowest, position_m, velocity_m_s, limits.fence_max_m):
        later = value + limits.fence_lookahead_s * rate
        now_m = min(now_m, value - low, high - value)
        ahead_m = min(ahead_m, later - low, high - later)
    return now_m, min(now_m, ahead_m)
