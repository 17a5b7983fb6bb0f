"""Ellipses in pictures: from moments, from edge points, and where the centre of a tilted circle is seen.

Coordinates: x right, y down; angles clockwise as seen. Needs no ROS.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

_POINTS_MIN = 6  # of a fit
_ROUNDS = 3  # of the robust fit; more change nothing that could be measured
_LEAST_LIMIT = 0.75  # [px] distances up to this always count
_PRIOR_PX, _PRIOR_COUNT = 0.05, 10  # prior noise of an edge point, worth this many points
_SYSTEMATIC = 5e-4  # error of the middle of an outline / its size, however many points there are


class Ellipse(NamedTuple):
    """One ellipse; `angle_rad` is the direction of its major axis. Unit of lengths: that of the points, e.g. px."""

    x: float
    y: float
    semi_major: float
    semi_minor: float
    angle_rad: float

    @property
    def area(self):
        """Its area."""
        return math.pi * self.semi_major * self.semi_minor

    def grown(self, scale):
        """The concentric ellipse that is `scale` times as large."""
        return self._replace(semi_major=scale * self.semi_major, semi_minor=scale * self.semi_minor)

    def axes(self):
        """(2, 2) matrix of the semi-axes as columns: centre + axes @ unit circle is the outline."""
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        return np.array([[self.semi_major * c, -self.semi_minor * s], [self.semi_major * s, self.semi_minor * c]])

    def at(self, points):
        """Where points (..., 2) of a disc with radius 1 are on the disc whose outline this ellipse is."""
        placed = points.reshape(-1, 2) @ self.axes().T.astype(points.dtype)
        placed += np.array((self.x, self.y), points.dtype)
        return placed.reshape(points.shape)

    def rectangle(self):
        """(width, height, angle [deg]) of the enclosing rotated rectangle as OpenCV's minAreaRect: 0 < angle <= 90."""
        angle_deg = math.degrees(self.angle_rad) % 180.0
        sides = 2.0 * self.semi_major, 2.0 * self.semi_minor
        if 0.0 < angle_deg <= 90.0:
            return sides + (angle_deg,)
        return sides[1], sides[0], angle_deg - 90.0 if angle_deg else 90.0

    def conic(self):
        """(3, 3) symmetric C with (x, y, 1) C (x, y, 1)' = 0 on the outline and < 0 inside."""
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        p, q = self.semi_major**-2, self.semi_minor**-2
        xx, xy, yy = p * c * c + q * s * s, (p - q) * c * s, p * s * s + q * c * c
        x, y = xx * self.x + xy * self.y, xy * self.x + yy * self.y
        return np.array([[xx, xy, -x], [xy, yy, -y], [-x, -y, x * self.x + y * self.y - 1.0]])


def ellipse_of_moments(moments):
    """The ellipse with the centroid and second moments (thesis eq. 4.3) of a shape; None for one without extent.

    moments: dict of cv2.moments.
    """
    area = moments["m00"]
    if area <= 0.0:
        return None
    # the variance of a filled ellipse along an axis is a quarter of the semi-axis squared
    xx, xy, yy = (4.0 / area * moments[key] for key in ("mu20", "mu11", "mu02"))
    mean, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
    reach = math.hypot(half, xy)
    if not mean - reach > 0.0:  # also NaN
        return None
    semi_major, semi_minor = math.sqrt(mean + reach), math.sqrt(mean - reach)
    x, y = moments["m10"] / area, moments["m01"] / area
    return Ellipse(x, y, semi_major, semi_minor, 0.5 * math.atan2(xy, half))


def unit_circle(count):
    """(count, 2) points, evenly spaced."""
    angles = np.arange(count) * (2.0 * math.pi / count)
    return np.column_stack((np.cos(angles), np.sin(angles)))


def fit_ellipse(points, least_outlier=0.3, outlier=3.0):
    """Ellipse through edge points (n, 2) by OpenCV's direct least squares, repeated once without outliers.

    Distances above `outlier` (robust) standard deviations are left out, but none below least_outlier (unit of the
    points). Returns (ellipse, distances (n,), with sign, + outside), or (None, None) if there is none.
    """
    points = points.astype(np.float32)
    ellipse = direct_ellipse(points)
    if ellipse is None:
        return None, None
    off = distances(points, ellipse)
    spread = np.abs(off)
    keep = spread <= max(least_outlier, outlier * 1.4826 * _median(spread))
    if _POINTS_MIN <= np.count_nonzero(keep) < len(keep):
        ellipse = direct_ellipse(points[keep])
        if ellipse is None:
            return None, None
        off = distances(points, ellipse)
    return ellipse, off


def direct_ellipse(points):
    """Ellipse through points (n, 2) float32; None if there is none."""
    if len(points) < _POINTS_MIN:
        return None
    (x, y), (first, second), angle_deg = cv2.fitEllipseDirect(points)
    if not (first > 0.0 and second > 0.0 and math.isfinite(x + y + first + second)):
        return None
    if first < second:
        first, second, angle_deg = second, first, angle_deg + 90.0
    return Ellipse(x, y, 0.5 * first, 0.5 * second, math.radians(angle_deg))


def distances(points, ellipse):
    """Distances (n,) of points (n, 2) from an ellipse that they are near, with sign, + outside."""
    lengths = np.array([ellipse.semi_major, ellipse.semi_minor])
    local = (points - (ellipse.x, ellipse.y)) @ (ellipse.axes() / lengths**2)  # the ellipse is the unit circle
    local *= local
    # (square - 1) over its gradient
    return (local.sum(axis=1) - 1.0) / (2.0 * np.sqrt(np.maximum(local @ lengths**-2, 1e-12)))


def _median(values):
    """Median; faster than numpy's, which is made for large arrays."""
    return float(np.sort(values)[len(values) // 2])


def fit_grown(points, inner, scale):
    """The ellipse `inner`, grown about `scale` times and shifted, through edge points (n, 2), and their distances.

    The outline of a concentric circle is nearly that; three numbers instead of five are robust against points that
    belong to something else. Returns (ellipse, distances (n,), with sign, + outside), or (None, None).
    """
    if len(points) < _POINTS_MIN:
        return None, None
    a, b = inner.semi_major, inner.semi_minor
    u, v = ((points - (inner.x, inner.y)) @ (inner.axes() / (a * a, b * b))).T  # `inner` is the unit circle
    found = np.array([0.0, 0.0, scale])  # shift of the middle and radius there
    for _ in range(_ROUNDS):
        outwards = np.array((u - found[0], v - found[1], np.ones(len(u))))
        radius = np.hypot(outwards[0], outwards[1])
        if not radius.all():
            return None, None
        outwards[:2] /= radius
        off = radius - found[2]
        pixels = 1.0 / np.hypot(outwards[0] / a, outwards[1] / b)  # of one unit across the outline
        off_px = off * pixels
        limit = max(_LEAST_LIMIT, 4.0 * _median(np.abs(off_px)))
        weight = np.maximum(0.0, 1.0 - np.square(off_px / limit)) * pixels  # Tukey's
        rows = outwards * weight
        solved, step = cv2.solve(rows @ rows.T, rows @ (off * weight), flags=cv2.DECOMP_CHOLESKY)
        if not solved:
            return None, None
        found += step[:, 0]
    if not 0.5 * scale < found[2] < 2.0 * scale:
        return None, None
    x, y = inner.at(found[:2]).tolist()
    return inner.grown(float(found[2]))._replace(x=x, y=y), off_px


def circle_centres(conic, ring_scale):
    """The two possible images of the centre of a circle whose outline in normalised coordinates is this conic.

    conic: (3, 3) of the outline in coordinates right, down at depth 1 (C as Ellipse.conic). Two circles have the same
    outline, tilted to opposite sides. Returns (centres, rings), each (2, 2): the images of their centres, and the
    middles of the ellipses that the concentric circles `ring_scale` times as large are seen as; both rows are equal for
    a circle seen frontally.
    """
    values, vectors = np.linalg.eigh(conic)  # ascending: one negative, two positive
    a, b, c = values.tolist()
    across, along = math.sqrt((c - b) / (c - a)), math.sqrt((b - a) / (c - a))
    # The normal n of the circle's plane, (along, 0, +-across) in the axes of the eigenvectors, is also the line that is
    # the image of the plane's line at infinity; the image of the centre is that line's pole: C^-1 n.
    poles = np.array(((along / a, 0.0, across / c), (along / a, 0.0, -across / c))) @ vectors.T
    # All concentric circles: C + m n n'. In the plane C = diag(1, 1, -r^2) and the pole is (0, 0, 1), hence
    # m n' C^-1 n = ring_scale^2 - 1. The middle of an ellipse is the pole of (0, 0, 1), by Sherman and Morrison:
    share = (1.0 - ring_scale**-2) / (along * along / a + across * across / c)
    rings = vectors @ (vectors[2] / values) - share * poles[:, 2:] * poles
    return poles[:, :2] / poles[:, 2:], rings[:, :2] / rings[:, 2:]


def centre_covariance(ellipse, directions, rms_px, focal_px, apart, share, turn=None):
    """Covariance (xx, xy, yy) [px^2] of the image of a tilted circle's centre, taken between both `circle_centres`.

    ellipse: the outline. directions: (n, 2) of its measured points, on the unit circle; rms_px: of their distances
    from it. focal_px: of the camera. apart: (2,) [px] from the second to the first hypothesis, share: probability of
    the first. turn: (2, 2) Jacobian of the picture's pixels by undistorted ones (in which `apart` is); None: the same.
    None for points that do not determine an ellipse.

    Three parts. The middle of the outline: sigma^2 (sum h h' w^2)^-1 with w pixels across the outline for a unit there,
    and a systematic error that more points do not reduce; h = (cos t, sin t, 1, cos 2t, sin 2t), by how much the point
    at t moves outwards when the ellipse moves along both axes, grows, and changes its shape in two ways. The shift to
    the image of the centre: kappa tau for a tilt with the sine tau, kappa = a b / f, where the shape tells tau^2. Which
    of both tilts it is: the variance of this choice.
    """
    count, (a, b), (u, v) = len(directions), ellipse[2:4], directions.T
    if count <= 5:
        return None
    rows = np.array((u, v, np.ones(count), u * u - v * v, 2.0 * u * v))
    solved, inverse = cv2.invert(rows / (u * u / a**2 + v * v / b**2) @ rows.T, flags=cv2.DECOMP_CHOLESKY)
    if not solved:
        return None
    sigma2 = (count * rms_px**2 + _PRIOR_COUNT * _PRIOR_PX**2) / (count - 5 + _PRIOR_COUNT)
    axes = ellipse.axes()
    kappa = a * b / focal_px
    spread = 2.0 * (1.0 + (b / a) ** 2) * math.sqrt(sigma2 * inverse[3, 3])  # of tau^2
    tau = 0.5 * math.hypot(*apart) / kappa
    noise, choice = (kappa * spread) ** 2 / (4.0 * tau**2 + 2.0 * spread), share * (1.0 - share)
    x, y = apart
    shift = np.array(((choice * x * x + noise, choice * x * y), (choice * x * y, choice * y * y + noise)))
    shift = shift if turn is None else turn @ shift @ turn.T
    (xx, xy), (_, yy) = (sigma2 * axes @ inverse[:2, :2] @ axes.T + shift).tolist()
    return xx + (_SYSTEMATIC * b) ** 2, xy, yy + (_SYSTEMATIC * b) ** 2
