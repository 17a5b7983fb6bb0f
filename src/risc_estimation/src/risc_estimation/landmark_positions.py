"""Positions of landmarks from whichever of their markers are in view."""

import math

from risc_lab.compiled import compiled, record

_LEARNING_GAIN = 0.02  # per frame in full view: averages the markers' noise over about 50 frames

LANDMARK = record(
    ("markers", int),  # that it has
    ("learnt", bool),  # it has been in full view
    ("first", int),  # index in the frame of its first marker; count: their number
    ("count", int),
)


@compiled
def locate_landmark(landmark, offsets, measured, visible, residual_max_m, position_m):
    """Centre of a landmark: mean over its visible markers of (marker - that marker's offset from the centre).

    With all markers in view this is their mean, as in the original release. The offsets are the template's until
    the landmark has once been in full view and are then those seen, so that a landmark mounted at another angle
    than the template says does not jump when one of its markers is hidden.

    landmark: LANDMARK.   offsets: (>= n, 3) [m], the template's at first.   measured: (>= n, 3) [m], cortex frame.
    visible: (n,) bool.   residual_max_m: a partial view whose markers fit the offsets worse than this (rms) is refused.
    Fills position_m (3,) and returns whether it counts.
    """
    count = 0
    position_m[:] = 0.0
    for i in range(len(visible)):
        if visible[i]:
            count += 1
            for axis in range(3):
                position_m[axis] += measured[i, axis] - offsets[i, axis]
    if count < min(2, landmark.markers) or count == 0:
        return False
    for axis in range(3):
        position_m[axis] /= count
    if count == landmark.markers:
        gain = _LEARNING_GAIN if landmark.learnt else 1.0
        for i in range(count):
            for axis in range(3):
                offsets[i, axis] += gain * (measured[i, axis] - offsets[i, axis] - position_m[axis])
        landmark.learnt = True
        return True
    squares = 0.0
    for i in range(len(visible)):
        if visible[i]:
            for axis in range(3):
                error = measured[i, axis] - offsets[i, axis] - position_m[axis]
                squares += error * error
    return math.sqrt(squares / count) <= residual_max_m
