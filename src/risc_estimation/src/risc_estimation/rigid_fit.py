"""Pose of a rigid body from its markers (least-squares rigid fit).

The rotation R and translation p minimise  sum_i |m_i - (R t_i + p)|^2  over the visible markers, t_i being the
template's marker and m_i the measured one (Kabsch's solution: singular value decomposition of the cross-covariance).
No axis is singled out, so there is no attitude at which the fit degenerates. Compiled: for every body in every frame.
"""

import math

from risc_lab.compiled import compiled, record

MIN_MARKERS = 3
_SWEEPS = 30  # of Jacobi's rotations; four to six are enough
_ORTHOGONAL = 1e-15  # rows with a smaller cosine between them count as orthogonal
_FLAT = 1e-14  # ratio of singular values below which the smaller one is rounding

POSE = record(
    ("rotation", float, (3, 3)),  # template frame -> measured frame
    ("position_m", float, (3,)),  # template origin in the measured frame [m]
    ("residual_m", float),  # rms distance of the used markers from the fitted template [m]
    ("spread_m", float),  # second principal extent of the used markers [m]; 0 = on one line
)
WORK = record(  # work space of a fit
    ("axes", float, (3, 3)),
    ("turns", float, (3, 3)),
    ("template_m", float, (3,)),
    ("measured_m", float, (3,)),
)


@compiled
def fit_pose(template, measured, visible, work, pose):
    """Fit one body; fills pose (POSE). template, measured: (>= n, 3) [m]; visible: (n,) bool, one at least.

    With fewer than three visible markers, or markers on one line, the spread is (nearly) zero and the rotation means
    nothing.
    """
    t, m, axes = work.template_m, work.measured_m, work.axes  # centroids; cross-covariance, measured by template
    t[:], m[:], axes[:, :], count = 0.0, 0.0, 0.0, 0
    for i in range(len(visible)):
        if visible[i]:
            count += 1
            for axis in range(3):
                t[axis] += template[i, axis]
                m[axis] += measured[i, axis]
    for axis in range(3):
        t[axis], m[axis] = t[axis] / count, m[axis] / count
    for i in range(len(visible)):
        if visible[i]:
            for row in range(3):
                for column in range(3):
                    axes[row, column] += (measured[i, row] - m[row]) * (template[i, column] - t[column])
    pose.spread_m = math.sqrt(_rotation_of(axes, work.turns, pose.rotation))

    R, p = pose.rotation, pose.position_m
    for row in range(3):
        p[row] = m[row] - (R[row, 0] * t[0] + R[row, 1] * t[1] + R[row, 2] * t[2])
    squares = 0.0
    for i in range(len(visible)):
        if visible[i]:
            x, y, z = template[i, 0], template[i, 1], template[i, 2]
            for row in range(3):
                error = R[row, 0] * x + R[row, 1] * y + R[row, 2] * z + p[row] - measured[i, row]
                squares += error * error
    pose.residual_m = math.sqrt(squares / count)


@compiled
def _rotation_of(axes, turns, rotation):
    """Fills the rotation R that maximises trace(R^T axes); returns the second singular value of axes.

    One-sided Jacobi: pairs of rows of `axes` are turned until all are orthogonal; axes = turns^T diag(s) U then. Only
    the two longest rows count. The third axes of both frames are their cross products, so that R is a rotation even
    where a mirror image would fit as well (flat templates) or better.
    """
    for row in range(3):
        for column in range(3):
            turns[row, column] = 1.0 if row == column else 0.0
    for _ in range(_SWEEPS):
        turned = _make_orthogonal(axes, turns, 0, 1)
        turned |= _make_orthogonal(axes, turns, 0, 2)
        turned |= _make_orthogonal(axes, turns, 1, 2)
        if not turned:
            break
    longest, second = 0, 1
    if _dot(axes, 1, 1) > _dot(axes, 0, 0):
        longest, second = 1, 0
    if _dot(axes, 2, 2) > _dot(axes, longest, longest):
        longest, second = 2, longest
    elif _dot(axes, 2, 2) > _dot(axes, second, second):
        second = 2
    s1, s2 = math.sqrt(_dot(axes, longest, longest)), math.sqrt(_dot(axes, second, second))

    if s1 > 0.0:
        ax, ay, az = axes[longest, 0] / s1, axes[longest, 1] / s1, axes[longest, 2] / s1
    else:
        ax, ay, az = 1.0, 0.0, 0.0
    if s2 > _FLAT * s1:
        bx, by, bz = axes[second, 0] / s2, axes[second, 1] / s2, axes[second, 2] / s2
    else:  # markers on a line: any direction across it
        bx, by, bz = (ay, -ax, 0.0) if abs(az) < 0.5 else (0.0, az, -ay)
        across = math.sqrt(bx * bx + by * by + bz * bz)
        bx, by, bz = bx / across, by / across, bz / across
    cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    for row in range(3):
        # the same three axes in the measured frame
        p, q = turns[longest, row], turns[second, row]
        j, k = (row + 1) % 3, (row + 2) % 3
        r = turns[longest, j] * turns[second, k] - turns[longest, k] * turns[second, j]
        rotation[row, 0] = p * ax + q * bx + r * cx
        rotation[row, 1] = p * ay + q * by + r * cy
        rotation[row, 2] = p * az + q * bz + r * cz
    return s2


@compiled
def _dot(rows, i, j):
    return rows[i, 0] * rows[j, 0] + rows[i, 1] * rows[j, 1] + rows[i, 2] * rows[j, 2]


@compiled
def _make_orthogonal(axes, turns, i, j):
    """Turn rows i and j within their plane so that they are orthogonal in `axes`. Returns whether they were not."""
    along = _dot(axes, i, j)
    first, other = _dot(axes, i, i), _dot(axes, j, j)
    if abs(along) <= _ORTHOGONAL * math.sqrt(first * other):
        return False
    zeta = (other - first) / (2.0 * along)
    tangent = math.copysign(1.0, zeta) / (abs(zeta) + math.sqrt(1.0 + zeta * zeta))
    cosine = 1.0 / math.sqrt(1.0 + tangent * tangent)
    sine = cosine * tangent
    for rows in (axes, turns):
        for k in range(3):
            a, b = rows[i, k], rows[j, k]
            rows[i, k] = cosine * a - sine * b
            rows[j, k] = sine * a + cosine * b
    return True
