"""Distance of every vehicle from the net, as its safety ladder sees it: of its position, and of where it could stop."""

from dataclasses import dataclass, field

import numpy as np

from data_extraction.flatten import stamp_or_receipt_s
from data_extraction.report.recorded_topics import PerName
from data_extraction.samples import Samples
from risc_control.fence import Fence
from risc_control.safety import SafetyLimits
from risc_lab.lab.vehicle_types import DEFAULT_TYPE, load_vehicle_type

_BLOCK_S = 0.1  # the least margin in each such period is one point of the plot
_ROWS = 50_000  # more are thinned out; the least margin of all is kept separately


@dataclass
class FenceMargin:
    """One vehicle's distance from the net: positive inside."""

    fence: Fence
    type_known: bool = True  # False: its limit and where it could have stopped are unknown
    least_m: float = np.inf  # of the position, over everything
    least_s: float = 0.0  # stamp
    least_place_m: tuple = ()  # (x, y, z) cortex frame
    least_stopped_m: float = np.inf
    samples: Samples = field(default_factory=lambda: Samples(3, _ROWS))  # of the blocks that have ended
    block: list = field(default_factory=list)  # the current row of `table`; [] before the first

    @property
    def table(self):
        """(n, 3): stamp [s], least margin [m] of the position, and of where it could have stopped, of each block."""
        return np.vstack((self.samples.table(), [self.block]))

    def note(self, stamp_s, state):
        position_m = (state.x, state.y, state.z)
        now_m, stopped_m = margin(self.fence, position_m, (state.u, state.v, state.w))
        if now_m < self.least_m or not self.block:
            self.least_m, self.least_s, self.least_place_m = now_m, stamp_s, position_m
        self.least_stopped_m = min(self.least_stopped_m, stopped_m)
        if self.block and 0.0 <= stamp_s - self.block[0] < _BLOCK_S:
            self.block[1:] = min(self.block[1], now_m), min(self.block[2], stopped_m)
            return
        if self.block:
            self.samples.append(self.block)
        self.block = [stamp_s, now_m, stopped_m]


class FenceCollector(PerName):
    """Collects each vehicle's FenceMargin, in constant memory."""

    topics = ("/cortex_raw",)

    def __init__(self, fences=None, types=None, limits=None):
        """fences: {vehicle's template: Fence}.

        types: {template: VehicleType} of the others.  limits: their SafetyLimits, None = the default ones.
        """
        super().__init__()
        limits = limits or SafetyLimits()
        others = {template: Fence(limits, vehicle_type) for template, vehicle_type in (types or {}).items()}
        self._fences = {**others, **(fences or {})}
        self._unknown = Fence(limits, load_vehicle_type(DEFAULT_TYPE))  # only its net is used

    def __call__(self, topic, receipt_s, message):
        stamp_s = stamp_or_receipt_s(message, receipt_s)
        for state in message.Obj:
            if state.visible:
                if state.name not in self.found:
                    fence = self._fences.get(state.name)
                    self.found[state.name] = FenceMargin(fence or self._unknown, type_known=fence is not None)
                self.found[state.name].note(stamp_s, state)


def margin(fence, position_m, velocity_m_s):
    """(margin of the position, of the place where it could have stopped) [m]; both vectors in cortex axes.

    A lower limit below the floor is not a net: no vehicle can come near it.
    """
    now_m = stopped_m = np.inf
    low_x, low_y, low_z = fence.limits.fence_min_m
    lowest = (low_x, low_y, low_z if low_z >= 0.0 else -np.inf)
    for axis, (low, high) in enumerate(zip(lowest, fence.limits.fence_max_m)):
        value, rate = position_m[axis], velocity_m_s[axis]
        now_m = min(now_m, value - low, high - value)
        stopped_m = min(stopped_m, value - fence.stop_m(axis, -rate) - low, high - value - fence.stop_m(axis, rate))
    return now_m, stopped_m
