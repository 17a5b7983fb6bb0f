"""The net around the arena, as built. Frame: cortex (x forward, y left, z up; origin on the floor, in the middle)."""

NET_HALF_X_M = 2.492954
NET_HALF_Y_M = 2.05178
NET_HEIGHT_M = 3.0
