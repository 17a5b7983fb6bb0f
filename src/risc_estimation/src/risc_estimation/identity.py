"""Whether a body can have moved to a pose since it was last seen: tracks of raw poses, frame by frame. No ROS.

A track is a position and an attitude with their rates, filtered with a fading memory of `_MEMORY_S` (gains of position
and velocity: 1 - k^2 and (1 - k)^2 for k = exp(-step / memory), larger at the beginning, where they are those of a line
through all poses of the track). Over the time T to the next frame it is extrapolated with constant rates. The next pose
is at the prediction, except for

    noise      of the pose and of the track, whose variances are propagated with the same gains, and
    reach      how far a constant acceleration within the limits can have taken the body from the estimate of a filter
               that does not know of it: off_m and off_m_s are propagated with the same gains, too, since the filter is
               linear. T^2/2 times the acceleration is added, as long as rates are within their limits.

A pose that is farther off contradicts the track. It starts a candidate. Later poses that continue the candidate also
contradict, even when the reach has grown enough to include them: for them it grows for `_GROW_S` only. When the
candidate is as old as the track was, or after memory_s, it replaces the track. The replaced track is remembered: a pose
that agrees with it shows that the body was there all the time. Nothing contradicts a track that is older than memory_s:
no body is locked out for longer.
"""

import math

from risc_lab.compiled import compiled, record

_MEMORY_S = 0.015  # three frames at 200 Hz: an acceleration puts the prediction off by 0.4 mm for each m/s^2
STEADY_RAD = 0.02  # 1 sigma of an attitude; a worse one gets less weight in the track, see also `body_fit`
_GROW_S = 0.05  # as in risc_control.plausibility
_REMEMBERED = 10.0  # times memory_s: for this long a replaced track may come back
TRACK, CANDIDATE, FORMER = range(3)  # of each body

# What a body can do: parameters of `pose_fit.PoseFitParams`.
REACH = record("noise_m gate memory_s acceleration_m_s2 speed_m_s angular_rad_s2 turn_rad_s")
PATH = record(
    ("lives", bool),
    ("poses", int),  # that it is made of
    "begun_s stamp_s",  # of the first and the newest of them
    ("position_m", float, (3,)),  # cortex frame
    ("velocity_m_s", float, (3,)),
    ("rotation", float, (3, 3)),  # template axes to cortex axes
    ("rate_rad_s", float, (3,)),  # about cortex axes
    # covariance of a coordinate and its rate, by the variance of a pose
    "variance covariance rate_variance",
    "off_m off_m_s off_rad off_rad_s",  # reach, see above
)


@compiled
def begin(path, stamp_s, pose, reach):
    """Start a PATH with a single POSE (`rigid_fit`): only the limits of its rates are known."""
    path.lives, path.poses, path.begun_s, path.stamp_s = True, 1, stamp_s, stamp_s
    path.rotation[:, :] = pose.rotation
    for axis in range(3):
        path.position_m[axis] = pose.position_m[axis]
        path.velocity_m_s[axis] = path.rate_rad_s[axis] = 0.0
    path.variance, path.covariance, path.rate_variance = 1.0, 0.0, 0.0
    path.off_m, path.off_m_s, path.off_rad, path.off_rad_s = 0.0, reach.speed_m_s, 0.0, reach.turn_rad_s


@compiled
def predict(path, stamp_s, reach, ahead):
    """Fill ahead (PATH) with the prediction of a path for another time."""
    step_s = stamp_s - path.stamp_s
    span_s, ahead.stamp_s = abs(step_s), stamp_s
    rate = path.rate_rad_s
    _turn(step_s * rate[0], step_s * rate[1], step_s * rate[2], path.rotation, ahead.rotation)
    for axis in range(3):
        ahead.position_m[axis] = path.position_m[axis] + step_s * path.velocity_m_s[axis]
    ahead.variance = path.variance + step_s * (2.0 * path.covariance + step_s * path.rate_variance)
    ahead.covariance = path.covariance + step_s * path.rate_variance
    faster_m_s, faster_rad_s = span_s * reach.acceleration_m_s2, span_s * reach.angular_rad_s2
    ahead.off_m = path.off_m + span_s * min(path.off_m_s + 0.5 * faster_m_s, reach.speed_m_s)
    ahead.off_m_s = min(path.off_m_s + faster_m_s, reach.speed_m_s)
    ahead.off_rad = path.off_rad + span_s * min(path.off_rad_s + 0.5 * faster_rad_s, reach.turn_rad_s)
    ahead.off_rad_s = min(path.off_rad_s + faster_rad_s, reach.turn_rad_s)


@compiled
def foresee(paths, stamp_s, reach, ahead, near, aside):
    """Predict a known body: fill ahead (its track), near (the track with less reach) and aside (its candidate)."""
    track, candidate = paths[TRACK], paths[CANDIDATE]
    predict(track, stamp_s, reach, ahead)
    aside.lives = candidate.lives and 0.0 < stamp_s - candidate.stamp_s <= reach.memory_s
    if aside.lives:
        predict(candidate, stamp_s, reach, aside)
        predict(track, min(stamp_s, candidate.begun_s + _GROW_S), reach, near)
        near.rotation[:, :], near.position_m[:] = ahead.rotation, ahead.position_m


@compiled
def is_possible(ahead, near, aside, pose, count, has_attitude, reach):
    """Whether a known body can have moved to a POSE fitted to count markers. See `foresee`."""
    if not agrees(ahead, pose, count, has_attitude, reach):
        return False
    return (
        not aside.lives
        or not agrees(aside, pose, count, has_attitude, reach)
        or agrees(near, pose, count, has_attitude, reach)
    )


@compiled
def marker_noise_m(ahead, reach):
    """Largest distance of a marker from its predicted place by noise [m], that of the prediction included."""
    return reach.gate * reach.noise_m * math.sqrt(1.0 + ahead.variance)


@compiled
def agrees(ahead, pose, count, has_attitude, reach):
    """Whether a body that is predicted to be at `ahead` can have moved to a POSE fitted to count markers.

    1 sigma of a position is that of a marker divided by the root of their number; of an attitude, that of a marker
    divided by the second principal extent of the markers, or less.
    """
    square, noise_m = 0.0, marker_noise_m(ahead, reach)
    for axis in range(3):
        off_m = pose.position_m[axis] - ahead.position_m[axis]
        square += off_m * off_m
    if math.sqrt(square) > noise_m / math.sqrt(count) + ahead.off_m:
        return False
    if not has_attitude:
        return True
    trace = 0.0
    for row in range(3):
        for column in range(3):
            trace += pose.rotation[row, column] * ahead.rotation[row, column]
    half_sine = 0.5 * math.sqrt(max(3.0 - trace, 0.0))  # of half the angle between the attitudes
    most_rad = noise_m / pose.spread_m + ahead.off_rad
    return math.pi * half_sine <= most_rad or 2.0 * math.asin(min(half_sine, 1.0)) <= most_rad  # mostly the first


@compiled
def follow(path, ahead, pose, reach):
    """Update a path with a POSE. ahead: prediction for the time of the pose, which is later than that of the path."""
    step_s, path.poses = ahead.stamp_s - path.stamp_s, path.poses + 1
    n, kept = float(path.poses), math.exp(-step_s / _MEMORY_S)
    line = 2.0 / (n * (n + 1.0))
    gain = max(1.0 - kept * kept, line * (2.0 * n - 1.0))
    rate_gain = max((1.0 - kept) * (1.0 - kept), 3.0 * line) / step_s
    path.stamp_s, missed = ahead.stamp_s, 1.0 - gain
    steady = STEADY_RAD * pose.spread_m / reach.noise_m
    weight = min(steady * steady, 1.0) if path.poses > 2 else 1.0
    missed_turn, turn_rate_gain = 1.0 - weight * gain, weight * rate_gain
    R, P = pose.rotation, ahead.rotation
    # the rotation from the predicted attitude to that of the pose, R P^T: its axis times its sine
    x = y = z = trace = 0.0
    for k in range(3):
        x += 0.5 * (R[2, k] * P[1, k] - R[1, k] * P[2, k])
        y += 0.5 * (R[0, k] * P[2, k] - R[2, k] * P[0, k])
        z += 0.5 * (R[1, k] * P[0, k] - R[0, k] * P[1, k])
        trace += R[0, k] * P[0, k] + R[1, k] * P[1, k] + R[2, k] * P[2, k]
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 1.0 + sine * sine / 6.0
    if sine > 1e-3 or trace < 1.0:
        scale = math.atan2(sine, 0.5 * (trace - 1.0)) / max(sine, 1e-12)
    turn = scale * x, scale * y, scale * z
    _turn(-missed_turn * turn[0], -missed_turn * turn[1], -missed_turn * turn[2], R, path.rotation)
    for axis in range(3):
        off_m = pose.position_m[axis] - ahead.position_m[axis]
        path.position_m[axis] = ahead.position_m[axis] + gain * off_m
        path.velocity_m_s[axis] += rate_gain * off_m
        path.rate_rad_s[axis] += turn_rate_gain * turn[axis]
    variance, covariance = ahead.variance, ahead.covariance
    path.variance = missed * missed * variance + gain * gain
    path.covariance = missed * (covariance - rate_gain * variance) + gain * rate_gain
    path.rate_variance += rate_gain * (rate_gain * (variance + 1.0) - 2.0 * covariance)
    path.off_m, path.off_rad = missed * ahead.off_m, missed_turn * ahead.off_rad
    path.off_m_s = max(ahead.off_m_s - rate_gain * ahead.off_m, 0.0)
    path.off_rad_s = max(ahead.off_rad_s - turn_rate_gain * ahead.off_rad, 0.0)


@compiled
def is_known(paths, stamp_s, reach):
    """Whether a body was seen recently enough for a pose to contradict its track. paths: (3,) PATH."""
    return paths[TRACK].lives and abs(stamp_s - paths[TRACK].stamp_s) <= reach.memory_s


@compiled
def go_on(paths, stamp_s, pose, count, has_attitude, reach, ahead):
    """Accept a POSE of a body that is not known, or one that agrees with its track, and continue the track.

    ahead: prediction of the track for this time if the body is known; else overwritten.
    """
    if is_known(paths, stamp_s, reach):
        if stamp_s > paths[TRACK].stamp_s:  # else it is late
            follow(paths[TRACK], ahead, pose, reach)
            paths[CANDIDATE].lives = False
        return
    if paths[CANDIDATE].lives and 0.0 < stamp_s - paths[CANDIDATE].stamp_s <= reach.memory_s:
        predict(paths[CANDIDATE], stamp_s, reach, ahead)
        if agrees(ahead, pose, count, has_attitude, reach):
            follow(paths[CANDIDATE], ahead, pose, reach)
            _replace(paths, reach)
            return
    begin(paths[TRACK], stamp_s, pose, reach)
    paths[CANDIDATE].lives = paths[FORMER].lives = False  # it was out of sight: these are outdated


@compiled
def contradict(paths, stamp_s, pose, count, has_attitude, reach, ahead):
    """Handle a POSE that contradicts the track of a known body. True if it is accepted anyway. Overwrites ahead."""
    if stamp_s <= paths[TRACK].stamp_s:
        return False
    former, candidate = paths[FORMER], paths[CANDIDATE]
    if former.lives and stamp_s - former.stamp_s <= _REMEMBERED * reach.memory_s:
        until_s = min(stamp_s, former.stamp_s + reach.memory_s)
        predict(former, until_s, reach, ahead)
        ahead.off_m += (stamp_s - until_s) * reach.speed_m_s
        ahead.off_rad += (stamp_s - until_s) * reach.turn_rad_s
        if agrees(ahead, pose, count, has_attitude, reach):
            begin(paths[TRACK], stamp_s, pose, reach)
            former.lives = candidate.lives = False
            return True
    if candidate.lives and stamp_s > candidate.stamp_s:
        predict(candidate, stamp_s, reach, ahead)
        if agrees(ahead, pose, count, has_attitude, reach):
            follow(candidate, ahead, pose, reach)
            if stamp_s - candidate.begun_s < paths[TRACK].stamp_s - paths[TRACK].begun_s:
                return False  # until memory_s at most: then the body is not known any more
            _replace(paths, reach)
            return True
    begin(candidate, stamp_s, pose, reach)
    return False


@compiled
def _replace(paths, reach):
    """Make the candidate the track, and the old track the former one if it had lasted for memory_s."""
    track = paths[TRACK]
    if track.lives and track.stamp_s - track.begun_s >= reach.memory_s:
        paths[FORMER] = paths[TRACK]
    paths[TRACK] = paths[CANDIDATE]
    paths[CANDIDATE].lives = False


@compiled
def _turn(x, y, z, R, out):
    """Fill out (3, 3) with R turned about the axis (x, y, z) by its length [rad]: Rodrigues' formula."""
    square = x * x + y * y + z * z
    a, b = 1.0 - square / 6.0, 0.5 - square / 24.0  # of [x]: sin / angle; of [x]^2: (1 - cos) / angle^2
    if square > 1e-4:
        angle = math.sqrt(square)
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
    t00, t01, t02 = 1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    t10, t11, t12 = b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x
    t20, t21, t22 = b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)
    for k in range(3):
        out[0, k] = t00 * R[0, k] + t01 * R[1, k] + t02 * R[2, k]
        out[1, k] = t10 * R[0, k] + t11 * R[1, k] + t12 * R[2, k]
        out[2, k] = t20 * R[0, k] + t21 * R[1, k] + t22 * R[2, k]
