"""The net around the arena. Frame: cortex (x forward, y left, z up; origin on the floor, in the middle)."""

from dataclasses import dataclass

from risc_lab.settings import Settings, between

# as built
NET_HALF_X_M = 2.492954
NET_HALF_Y_M = 2.05178
NET_HEIGHT_M = 3.0


@dataclass(frozen=True)
class Arena(Settings):
    """A net: a box that stands on the floor around the origin. The laboratory's, unless a fleet file says otherwise."""

    half_x_m: between(0.5, 100.0) = NET_HALF_X_M
    half_y_m: between(0.5, 100.0) = NET_HALF_Y_M
    height_m: between(1.0, 100.0) = NET_HEIGHT_M
