"""Where a camera sits on its vehicle, from its bearings of landmarks whose places are known (thesis 4.4.4, figure 4.5).

The thesis turns six values by hand until rays and spheres meet; here least squares does it. Needs no ROS.

A mount is a position t (body axes) and a rotation R, v_body = R v_camera (risc_lab.camera). A landmark at w in body
axes, w = R_body_to_cortex^T (landmark - vehicle) at the picture's exposure, lies for the camera at d = R^T (w - t) and
should be seen along u = d / |d|. It was seen along the unit vector m. The residual is the turn from m to u,

    v = theta (m x u) / |m x u|,   theta = atan2(|m x u|, m . u)                                        (3,) [rad]

so that |v| is the angle between ray and landmark, up to 180 degrees, wherever in the picture it is. (Differences of
azimuth and elevation are not: towards the poles azimuth counts for nothing.) Unknown are t and a turn delta (3,) about
the camera's axes, R = R_start Exp(delta).

Wrong bearings (false detections, mistaken identities) must not count. Cauchy's loss with a falling scale finds the
mount that most bearings agree on, from far away; then those that are not within `gate` standard deviations are left
out and the rest is fitted by plain least squares. A weak prior (`prior_m`, `prior_deg`) keeps values that the views do
not determine near the start.

Covariance: sigma^2 (J^T J)^-1 of the bearings that counted, without the prior; sigma is what their residuals show, at
least `noise_deg`. It assumes independent errors: a constant delay of the stamps or a rotated marker template moves the
mount by more, and no number here shows it.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import approx_fprime, least_squares
from scipy.spatial.transform import Rotation

from risc_lab.camera import rotation_camera_to_body
from risc_lab.frames import euler_from_body_to_ned
from risc_lab.lab.calibration import CameraMount
from risc_lab.settings import Positive, Settings, between

VALUES = ("x", "y", "z", "roll", "pitch", "yaw")  # position: body axes; turns: about the camera's own axes
_SCALES_DEG = (20.0, 5.0, 1.0)  # of Cauchy's loss, one after the other
_GATINGS = 3  # rounds of leaving out wrong bearings and fitting again
_RAYLEIGH_MEDIAN = math.sqrt(2.0 * math.log(2.0))  # median length of a vector of two normal deviates
_TINY = 1e-9
_SINGULAR = 1e-6  # singular values below this part of the greatest are rounding


@dataclass(frozen=True)
class FitParams(Settings):
    """Settings of the fit; also parameters of transform_tuner of risc_visual."""

    noise_deg: Positive = 0.1  # least standard deviation of a bearing, along each of its two axes
    gate: Positive = 4.0  # [standard deviations] bearings farther from the fit than this are wrong
    wrong_max: between(0.01, 0.99) = 0.35  # largest share of wrong bearings without a warning, and to pass the check
    std_max_m: Positive = 0.01  # greatest standard deviation of a position that counts as known, and
    std_max_deg: Positive = 0.2  # of an angle
    prior_m: Positive = 0.3  # standard deviation of the mount before anything was seen
    prior_deg: Positive = 30.0
    samples_min: between(6, 10**6) = 30  # least number of bearings for a fit


class Samples(NamedTuple):
    """n bearings of landmarks by one camera."""

    times_s: np.ndarray  # (n,) stamps
    names: np.ndarray  # (n,) of the landmarks
    points_body_m: np.ndarray  # (n, 3) where the landmark was, in body axes from the vehicle's centre
    rays: np.ndarray  # (n, 3) unit vectors in camera axes, as measured

    def take(self, rows):
        """Samples selected by a boolean mask or by indices."""
        return Samples(*(values[rows] for values in self))


class Misses(NamedTuple):
    """By how much rays miss their landmarks."""

    right: np.ndarray  # (n,) bool: bearings that count; the others are too far off to be believed
    rms_rad: float  # of the angles between rays and landmarks, over the bearings that count; NaN: none
    rms_px: float  # the same in the picture; NaN: none counts, or the camera is not known

    @property
    def wrong_share(self):
        """Share of wrong bearings; 0 if there are no bearings."""
        return 1.0 - self.right.mean() if self.right.size else 0.0

    def __str__(self):
        count, pixels = int(self.right.sum()), "" if math.isnan(self.rms_px) else " (%.1f px)" % self.rms_px
        wrong = "" if self.right.all() else ", %d wrong left out" % (self.right.size - count)
        return "%.2f deg%s RMS of %d bearings%s" % (math.degrees(self.rms_rad), pixels, count, wrong)


class MountFit(NamedTuple):
    """A mount fitted to bearings."""

    mount: CameraMount
    misses: Misses
    std: np.ndarray  # (6,) standard deviations, as VALUES [m, rad]; inf: not known at all
    warnings: tuple[str, ...]  # sentences; empty = nothing to object to


def fit_mount(samples, start, params=None, camera=None):
    """MountFit of Samples. start: CameraMount, within some 30 degrees and 0.3 m. camera: for misses in pixels.

    Raises ValueError with cause and cure when there are too few bearings.
    """
    params = params or FitParams()
    if len(samples.times_s) < params.samples_min:
        raise ValueError(
            "%d bearings of landmarks are too few, %d are needed: let the camera see landmarks, then try again"
            % (len(samples.times_s), params.samples_min)
        )
    x = np.zeros(6)
    for scale_deg in _SCALES_DEG:
        x = _solve(samples, start, params, x, loss="cauchy", f_scale=math.radians(scale_deg))
    for _ in range(_GATINGS):
        right = right_ones(ray_errors(samples, _mount(start, x)), params)
        x = _solve(samples.take(right), start, params, x)
    mount = _mount(start, x)
    found = misses(samples, mount, params, camera)
    # degrees of freedom: two per bearing, less the six fitted values
    count = int(found.right.sum())
    noise_rad = found.rms_rad * math.sqrt(count / max(2 * count - len(VALUES), 1))
    std = standard_deviations(samples.take(found.right), mount, params, noise_rad)
    warnings = weak_values(std, params)
    if found.wrong_share > params.wrong_max:
        warnings += (
            "%.0f %% of the bearings do not fit: landmarks may be taken for each other, or stamps be late"
            % (100.0 * found.wrong_share),
        )
    return MountFit(mount, found, std, warnings)


def misses(samples, mount, params, camera=None):
    """Misses of Samples with a mount. camera: risc_lab.camera.Camera of their pictures, for rms_px."""
    errors = ray_errors(samples, mount)
    right = right_ones(errors, params)
    errors_px = pixel_errors(samples.take(right), mount, camera) if camera is not None and right.any() else ()
    return Misses(right, root_mean_square(errors[right]), root_mean_square(errors_px))


def directions(samples, mount):
    """Vectors (n, 3) [m] in camera axes from the camera to where the landmarks were."""
    return (samples.points_body_m - mount.position_m) @ rotation_camera_to_body(mount)


def ray_errors(samples, mount):
    """Angles (n,) [rad] between each ray and the direction of its landmark."""
    seen, true = samples.rays, directions(samples, mount)
    return np.arctan2(np.linalg.norm(np.cross(seen, true), axis=1), np.einsum("ij,ij->i", seen, true))


def pixel_errors(samples, mount, camera):
    """Distances (n,) [px] in the picture between where each landmark is seen and should be; NaN where it has no pixel.

    camera: risc_lab.camera.Camera of the pictures that the bearings were taken from.
    """
    seen, true = camera.project(samples.rays), camera.project(directions(samples, mount))
    return np.linalg.norm(seen - true, axis=1)


def right_ones(errors_rad, params):
    """(n,) bool: which errors are no outliers. At least half must be right; the limit is scaled by their median."""
    if not len(errors_rad):
        return np.zeros(0, dtype=bool)
    noise_rad = max(np.median(errors_rad) / _RAYLEIGH_MEDIAN, math.radians(params.noise_deg))
    return errors_rad <= params.gate * noise_rad


def root_mean_square(values):
    """Root mean square of the finite values; NaN if there are none."""
    finite = np.asarray(values)[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else math.nan


def standard_deviations(samples, mount, params, noise_rad=0.0):
    """Standard deviations (6,) of a mount from such views, as VALUES [m, rad]; inf where they determine nothing.

    noise_rad: of a bearing along each axis; at least params.noise_deg is assumed.
    """
    J = approx_fprime(np.zeros(6), lambda x: _residuals(samples, mount, x)).reshape(-1, 6)
    units = _limits(params)  # scaled by these, metres and radians are comparable
    _, strengths, axes = np.linalg.svd(J * units, full_matrices=False)
    noise_rad = max(noise_rad, math.radians(params.noise_deg))
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.where(strengths > _SINGULAR * strengths.max(initial=1.0), noise_rad / strengths, np.inf)
        parts = np.where(np.abs(axes) > 1e-6, axes**2 * along[:, None] ** 2, 0.0)
    known = np.sqrt(parts.sum(axis=0)) if len(strengths) == 6 else np.full(6, np.inf)
    return known * units


def weak_values(std, params):
    """Sentences on values that are known less well than they should be. std: (6,), from `standard_deviations`."""
    weak = []
    for name, value, limit in zip(VALUES, std, _limits(params)):
        if value > limit:
            is_angle = name in VALUES[3:]
            scale, unit, digits = (math.degrees(1.0), "deg", 1) if is_angle else (100.0, "cm", 0)
            prior = math.radians(params.prior_deg) if is_angle else params.prior_m
            known = "unknown" if value > prior else "known to %.*f %s only" % (digits, scale * value, unit)
            weak.append("%s is %s" % (name, known))
    if not weak:
        return ()
    return (", ".join(weak) + ": show the camera landmarks near and far, in the middle and at the edges",)


def _solve(samples, start, params, x, **robust):
    """x = (t - t_start, delta) of least cost, starting from x. robust: loss and scale of `least_squares`."""
    # the prior counts as one bearing along each value
    prior = math.radians(params.noise_deg) / np.repeat((params.prior_m, math.radians(params.prior_deg)), 3)
    return least_squares(lambda x: np.append(_residuals(samples, start, x), prior * x), x, "3-point", **robust).x


def _residuals(samples, start, x):
    """(3 n,) turns [rad] from the rays to where the landmarks should be seen."""
    R = rotation_camera_to_body(start) @ Rotation.from_rotvec(x[3:]).as_matrix()
    d = (samples.points_body_m - np.asarray(start.position_m) - x[:3]) @ R
    u = d / np.maximum(np.linalg.norm(d, axis=1), _TINY)[:, None]
    across = np.cross(samples.rays, u)
    sine = np.linalg.norm(across, axis=1)
    theta = np.arctan2(sine, np.einsum("ni,ni->n", samples.rays, u))
    return (np.where(sine > _TINY, theta / np.maximum(sine, _TINY), 1.0)[:, None] * across).ravel()


def _mount(start, x):
    R = rotation_camera_to_body(start) @ Rotation.from_rotvec(x[3:]).as_matrix()
    roll, pitch, yaw = (float(angle) for angle in euler_from_body_to_ned(R))
    position_m = np.asarray(start.position_m) + x[:3]
    return CameraMount(tuple(position_m.tolist()), roll, pitch, yaw)


def _limits(params):
    """(6,) greatest standard deviations [m, rad], as VALUES."""
    return np.repeat((params.std_max_m, math.radians(params.std_max_deg)), 3)
