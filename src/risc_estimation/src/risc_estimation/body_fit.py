"""Which of a body's markers its pose is fitted to, and whether that pose is accepted. No ROS; compiled.

A pose of n markers leaves 3 n - 6 degrees of freedom: the sum of their squared distances from the fitted template,
divided by the variance of a coordinate, is chi-square distributed. Above the value that a good pose exceeds with
`false_reject_probability` it is a misfit. Then the fit is tried without each marker, and of five or more without each
pair.

The places of the markers of a recently seen body are predicted (`identity`). Its labels are not needed then: each
marker is the one nearest to its predicted place. So swapped labels are corrected, reflections are left out, and markers
that have lost their labels are used. Where several sets of markers fit, the pose nearest to the prediction is taken.
Without a prediction nothing tells which of them is right, and the body is refused.
"""

import enum
import math

from risc_estimation.identity import PATH, REACH, STEADY_RAD, is_possible, marker_noise_m
from risc_estimation.rigid_fit import MIN_MARKERS, POSE, WORK, fit_pose
from risc_lab.compiled import compiled, record


class Doubt(enum.IntEnum):
    """Why a body has no pose in a frame."""

    NONE, UNSEEN, MISFIT, COLLINEAR, TILTED, JUMP = range(6)


NONE, UNSEEN, MISFIT, COLLINEAR, TILTED, JUMP = map(int, Doubt)  # for compiled code

LIMITS = record("residual_max_m min_spread_m cos_tilt_max", ("left_out_most", int))
FIT = record(
    ("limits", LIMITS),
    ("reach", REACH),
    ("work", WORK),
    ("pose", POSE),  # what a fit has found
    ("best", POSE),
    ("ahead", PATH),  # predictions, see `identity.foresee`
    ("near", PATH),
    ("aside", PATH),
)
_PART = 0.4  # of the least distance between two markers of a template: a point this near to a place is its marker


@compiled
def fit_markers(template, measured, used, residuals_m, has_attitude, is_known, fit):
    """Fit the used markers; fills fit.pose. Returns a doubt about it.

    template, measured: (>= n, 3) [m]; used: (n,) bool, three at least; residuals_m: (> n,) largest rms distance by
    number of markers.  is_known: the pose has to be possible, see `identity.foresee`.  fit: FIT.
    """
    pose, limits, count = fit.pose, fit.limits, 0
    for i in range(len(used)):
        if used[i]:
            count += 1
    fit_pose(template, measured, used, fit.work, pose)
    if not pose.residual_m <= residuals_m[count]:
        flat = pose.residual_m <= limits.residual_max_m and not pose.spread_m >= limits.min_spread_m
        return COLLINEAR if flat else MISFIT
    if not pose.spread_m >= limits.min_spread_m:
        return COLLINEAR
    if has_attitude and not -pose.rotation[2, 2] >= limits.cos_tilt_max:
        return TILTED
    if is_known and not is_possible(fit.ahead, fit.near, fit.aside, pose, count, has_attitude, fit.reach):
        return JUMP
    return NONE


@compiled
def fit_some_markers(template, measured, used, residuals_m, has_attitude, is_known, fit):
    """As `fit_markers`; if there is a doubt, tries without one or two markers, and removes these from used."""
    doubt, count = fit_markers(template, measured, used, residuals_m, has_attitude, is_known, fit), 0
    for i in range(len(used)):
        if used[i]:
            count += 1
    if doubt != MISFIT and doubt != JUMP:
        return doubt
    for left_out in range(1, min(fit.limits.left_out_most, count - MIN_MARKERS) + 1):
        first, second, least_m, other = -1, -1, math.inf, MISFIT
        for one in range(len(used)):
            for two in range(one + left_out - 1, len(used) if left_out == 2 else one + 1):
                if used[one] and used[two]:
                    found = _without(template, measured, used, one, two, residuals_m, has_attitude, is_known, fit)
                    off_m = apart_m(template, len(used), fit.pose, fit.ahead) if is_known else fit.pose.residual_m
                    if found == NONE and off_m < least_m:
                        first, second, least_m = one, two, off_m
                    elif found != NONE and found != MISFIT:
                        other = found
        if first < 0:
            doubt = other if doubt == MISFIT else doubt
            continue
        _without(template, measured, used, first, second, residuals_m, has_attitude, is_known, fit)
        if not is_known and _has_rival(template, measured, used, first, second, residuals_m, has_attitude, fit):
            return MISFIT
        used[first] = used[second] = False
        return NONE
    return doubt


@compiled
def _without(template, measured, used, one, two, residuals_m, has_attitude, is_known, fit):
    """`fit_markers` without markers one and two."""
    used[one] = used[two] = False
    doubt = fit_markers(template, measured, used, residuals_m, has_attitude, is_known, fit)
    used[one] = used[two] = True
    return doubt if doubt != NONE or is_steady(fit.pose, has_attitude, fit.reach) else MISFIT


@compiled
def is_steady(pose, has_attitude, reach):
    """Whether the markers of a fit are far enough from one line to give the attitude without those left out.

    After a turn of 180 degrees some markers of a vehicle are where others were: these alone would fit.
    """
    return not has_attitude or reach.noise_m <= STEADY_RAD * pose.spread_m


@compiled
def _has_rival(template, measured, used, first, second, residuals_m, has_attitude, fit):
    """Whether another subset also fits, with the body elsewhere than fit.pose, which is without first and second."""
    if fit.reach.gate == math.inf:
        return False
    best = fit.best
    best.rotation[:, :], best.position_m[:] = fit.pose.rotation, fit.pose.position_m
    best.residual_m, best.spread_m = fit.pose.residual_m, fit.pose.spread_m
    rival = False
    for one in range(len(used)):
        for two in range(one + 1, len(used)) if first != second else range(one, one + 1):
            if used[one] and used[two] and not rival:
                doubt = _without(template, measured, used, one, two, residuals_m, has_attitude, False, fit)
                rival = doubt == NONE and apart_m(template, len(used), fit.pose, best) > fit.limits.residual_max_m
    pose = fit.pose
    pose.rotation[:, :], pose.position_m[:] = best.rotation, best.position_m
    pose.residual_m, pose.spread_m = best.residual_m, best.spread_m
    return rival


@compiled
def apart_m(template, count, one, other):
    """Rms distance of the markers of a body in two poses, both with a rotation and a position_m [m]."""
    squares = 0.0
    for i in range(count):
        x, y, z = template[i, 0], template[i, 1], template[i, 2]
        for row in range(3):
            off_m = one.position_m[row] - other.position_m[row]
            off_m += (one.rotation[row, 0] - other.rotation[row, 0]) * x
            off_m += (one.rotation[row, 1] - other.rotation[row, 1]) * y
            off_m += (one.rotation[row, 2] - other.rotation[row, 2]) * z
            squares += off_m * off_m
    return math.sqrt(squares / count)


@compiled
def find_markers(template, apart_least_m, markers, seen, loose_m, marker_most_m, fit, measured, used, found):
    """Find the markers of a body near the places that fit.ahead predicts. Returns how many were found.

    markers: (k, 3) with its labels [m], of which those seen (n,) bool are used; loose_m: (u, 3) without labels [m].
    apart_least_m: the least distance between two markers of the template [m].
    Fills measured (>= n, 3) in the order of the template, used (n,), and found (>= n,): the index of each in markers
    followed by loose_m.
    """
    ahead, count, labelled = fit.ahead, 0, min(len(markers), len(seen))
    for i in range(len(used)):
        used[i] = False
        x, y, z = template[i, 0], template[i, 1], template[i, 2]
        near_m = marker_noise_m(ahead, fit.reach) + ahead.off_m + ahead.off_rad * math.sqrt(x * x + y * y + z * z)
        least, found[i] = min(near_m, _PART * apart_least_m) ** 2, -1
        for row in range(3):
            R = ahead.rotation
            measured[i, row] = ahead.position_m[row] + R[row, 0] * x + R[row, 1] * y + R[row, 2] * z
        for k in range(labelled + len(loose_m)):
            point = markers[k] if k < labelled else loose_m[k - labelled]
            if k < labelled and not seen[k] or not abs(point[0]) < marker_most_m:
                continue
            square = 0.0
            for row in range(3):
                off_m = point[row] - measured[i, row]
                square += off_m * off_m
            if square < least:
                least, found[i] = square, k
    for i in range(len(used)):
        k = found[i]
        if k >= 0:
            used[i] = True
            count += 1
            for row in range(3):
                measured[i, row] = markers[k, row] if k < labelled else loose_m[k - labelled, row]
    return count
