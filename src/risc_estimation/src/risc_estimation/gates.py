"""Which markers and poses are believed: one compiled function a gate."""

import math

import numpy as np

from risc_lab.compiled import compiled, record

LIMITS = record(
    ("marker_m", float),
    ("residual_max_m", float),
    ("min_spread_m", float),
    ("cos_tilt_max", float),
    ("lower_m", float, (3,)),  # corners of the arena
    ("upper_m", float, (3,)),
)
REFUSALS = record(  # how often a gate has refused; the fields of `risc_estimation.state_estimator.EstimatorCounts`
    ("markers_left_out", int),
    ("misfits", int),
    ("collinear", int),
    ("tilted", int),
    ("outside", int),
)


def limits_of(params):
    """(1,) LIMITS from PoseFitParams."""
    margin_m = params.arena_margin_m
    lower_m = np.array([-params.arena_x_m, -params.arena_y_m, params.arena_z_min_m]) - margin_m
    upper_m = np.array([params.arena_x_m, params.arena_y_m, params.arena_z_max_m]) + margin_m
    cos_tilt_max = math.cos(min(params.tilt_max_rad, math.pi))
    row = (params.marker_limit_m, params.residual_max_m, params.min_spread_m, cos_tilt_max, lower_m, upper_m)
    return np.array([row], dtype=LIMITS)


@compiled
def see_markers(markers, limits, visible):
    """Fills visible (n,): which of the first n markers (k, 3) [m] are there and not lost. Returns how many."""
    count = 0
    for i in range(len(visible)):
        visible[i] = (
            i < len(markers)
            and abs(markers[i, 0]) < limits.marker_m
            and abs(markers[i, 1]) < limits.marker_m
            and abs(markers[i, 2]) < limits.marker_m
        )
        if visible[i]:
            count += 1
    return count


@compiled
def believe_pose(pose, has_attitude, limits, refusals):
    """Whether a pose (rigid_fit.POSE, vehicle's body to cortex frame) whose markers fit is one to fly by."""
    if not pose.spread_m >= limits.min_spread_m:
        refusals.collinear += 1
        return False
    if has_attitude and not -pose.rotation[2, 2] >= limits.cos_tilt_max:
        refusals.tilted += 1
        return False
    return True


@compiled
def is_inside(position_m, limits, refusals):
    """Whether a vehicle is inside the net."""
    for axis in range(3):
        if not limits.lower_m[axis] <= position_m[axis] <= limits.upper_m[axis]:
            refusals.outside += 1
            return False
    return True
