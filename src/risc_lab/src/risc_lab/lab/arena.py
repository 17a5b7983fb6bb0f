"""The net around the arena. Frame: cortex (x forward, y left, z up; origin on the floor, in the middle)."""

from dataclasses import dataclass

from risc_lab.lab.ranges import check_ranges

# as built
NET_HALF_X_M = 2.492954
NET_HALF_Y_M = 2.05178
NET_HEIGHT_M = 3.0


@dataclass(frozen=True)
class Arena:
    """A net: a box that stands on the floor around the origin. The laboratory's, unless a fleet file says otherwise."""

    half_x_m: float = NET_HALF_X_M
    half_y_m: float = NET_HALF_Y_M
    height_m: float = NET_HEIGHT_M

    def __post_init__(self):
        check_ranges(self, half_x_m=(0.5, 100.0), half_y_m=(0.5, 100.0), height_m=(1.0, 100.0))
