"""Where a camera sits on its vehicle, from its bearings of landmarks whose places are known (thesis 4.4.4, figure 4.5).

The thesis turns six values by hand until rays and spheres meet; here least squares does it. Needs no ROS.

A mount is a position t (body axes) and a rotation R, v_body = R v_camera (risc_lab.camera). A landmark at w in body
axes, w = R_body_to_cortex^T (landmark - vehicle) at the picture's exposure, lies for the camera at d = R^T (w - t) and
should be seen along u = d / |d|. It was seen along the unit vector m. The residual is the way from m to u on the unit
sphere: with B (2, 3) an orthonormal basis of the tangent plane at m, a = B u, s = |a|, c = m . u,

    v = (theta / s) a,   theta = atan2(s, c)                                                        (2,) [rad]

so that |v| is the angle between ray and landmark, up to 180 degrees, wherever in the picture it is. (Differences of
azimuth and elevation are not: towards the poles azimuth counts for nothing.)

Unknown are t and a turn delta (3,) about the camera's axes, R = R_start Exp(delta). With J_r the right Jacobian of
SO(3), Exp(delta + e) = Exp(delta) Exp(J_r e), to first order:

    dd/dt = -R^T,   dd/ddelta = [d]x J_r,   du = (I - u u^T) dd / |d|,   da = B du,   dc = m . du,
    ds = a . da / s,   dtheta = c ds - s dc,   dv = (theta / s) da + a (dtheta - theta ds / s) / s

Wrong bearings (false detections, mistaken identities) must not count. Cauchy's loss with a falling scale finds the
mount that most bearings agree on, from far away; then those that are not within `gate` standard deviations are left
out and the rest is fitted by plain least squares. A weak prior (`prior_m`, `prior_deg`) leaves what the views do not
tell where it was.

Covariance: sigma^2 (J^T J)^-1 of the bearings that counted, without the prior; sigma is what their residuals show, at
least `noise_deg`. It takes errors as independent: a stamp that is always late or a marker template that is turned
moves the mount by more, and no number here would say so.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from risc_lab.camera import rotation_camera_to_body
from risc_lab.frames import euler_from_body_to_ned
from risc_lab.lab.calibration import CameraMount

VALUES = ("x", "y", "z", "roll", "pitch", "yaw")  # position: body axes; turns: about the camera's own axes
_SCALES_DEG = (20.0, 5.0, 1.0)  # of Cauchy's loss, one after the other
_GATINGS = 3  # how often the wrong ones are chosen afresh
_RAYLEIGH_MEDIAN = math.sqrt(2.0 * math.log(2.0))  # of the length of two normal deviates
_TINY = 1e-9


@dataclass(frozen=True)
class FitParams:
    """Settings of the fit."""

    noise_deg: float = 0.1  # least standard deviation of a bearing, along each of its two axes
    gate: float = 4.0  # [standard deviations] bearings farther from the fit than this are wrong
    wrong_max: float = 0.35  # share of wrong bearings that is not worth a warning, and passes the tuner's check
    std_max_m: float = 0.01  # greatest standard deviation of a position that counts as known, and
    std_max_deg: float = 0.2  # of an angle
    prior_m: float = 0.3  # standard deviation of the mount before anything was seen
    prior_deg: float = 30.0
    samples_min: int = 30  # bearings without which there is no fit

    def __post_init__(self):
        for key in ("noise_deg", "gate", "std_max_m", "std_max_deg", "prior_m", "prior_deg"):
            if not getattr(self, key) > 0.0:
                raise ValueError("parameter '%s' must be positive, got %r" % (key, getattr(self, key)))
        if not 0.0 < self.wrong_max < 1.0:
            raise ValueError("parameter 'wrong_max' must be in (0, 1), got %r" % (self.wrong_max,))
        if self.samples_min < 6:
            raise ValueError("parameter 'samples_min' must be 6 at least, got %r" % (self.samples_min,))


class Samples(NamedTuple):
    """n bearings of landmarks by one camera."""

    times_s: np.ndarray  # (n,) stamps
    names: np.ndarray  # (n,) of the landmarks
    points_body_m: np.ndarray  # (n, 3) where the landmark was, in body axes from the vehicle's centre
    rays: np.ndarray  # (n, 3) unit vectors in camera axes, as measured

    def take(self, rows):
        """Those of a boolean mask or of indices."""
        return Samples(*(values[rows] for values in self))


class MountFit(NamedTuple):
    """What the bearings say of a mount."""

    mount: CameraMount
    right: np.ndarray  # (n,) bool: bearings that counted
    rms_rad: float  # of the angles between rays and landmarks, of those that counted
    std: np.ndarray  # (6,) standard deviations, as VALUES [m, rad]; inf: not known at all
    warnings: tuple[str, ...]  # sentences; empty = nothing to object to


def fit_mount(samples, start, params=None):
    """MountFit of Samples. start: CameraMount, within some 30 degrees and 0.3 m.

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
        x = _Problem(samples, start, params).solve(x, math.radians(scale_deg))
    for _ in range(_GATINGS):
        errors = ray_errors(samples, _mount(start, x))
        right = right_ones(errors, params)
        x = _Problem(samples.take(right), start, params).solve(x)
    mount = _mount(start, x)
    errors = ray_errors(samples, mount)
    right = right_ones(errors, params)
    rms_rad = root_mean_square(errors[right])
    # two axes a bearing, six values are taken from them
    freedom = max(2 * int(right.sum()) - len(VALUES), 1)
    noise_rad = rms_rad * math.sqrt(right.sum() / freedom)
    std = standard_deviations(samples.take(right), mount, params, noise_rad)
    warnings = weak_values(std, params)
    wrong = 1.0 - right.mean()
    if wrong > params.wrong_max:
        warnings += (
            "%.0f %% of the bearings do not fit: landmarks may be taken for each other, or stamps be late"
            % (100.0 * wrong),
        )
    return MountFit(mount, right, rms_rad, std, warnings)


def directions(samples, mount):
    """Vectors (n, 3) [m] in camera axes from the camera to where the landmarks were."""
    return (samples.points_body_m - mount.position_m) @ rotation_camera_to_body(mount)


def ray_errors(samples, mount):
    """Angles (n,) [rad] between each ray and the direction of its landmark."""
    seen, true = samples.rays, directions(samples, mount)
    return np.arctan2(np.linalg.norm(np.cross(seen, true), axis=1), np.einsum("ij,ij->i", seen, true))


def pixel_errors(samples, mount, camera):
    """Distances (n,) [px] in the picture between each landmark as seen and as it should be; NaN where it cannot be.

    camera: risc_lab.camera.Camera of the pictures that the bearings were taken from.
    """
    seen, true = camera.project(samples.rays), camera.project(directions(samples, mount))
    return np.linalg.norm(seen - true, axis=1)


def right_ones(errors_rad, params):
    """(n,) bool: which errors fit the others. Half of them must be right; their own spread says how far that is."""
    if not len(errors_rad):
        return np.zeros(0, dtype=bool)
    noise_rad = max(np.median(errors_rad) / _RAYLEIGH_MEDIAN, math.radians(params.noise_deg))
    return errors_rad <= params.gate * noise_rad


def root_mean_square(values):
    """Of the finite ones; NaN if there are none."""
    finite = np.asarray(values)[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else math.nan


def standard_deviations(samples, mount, params, noise_rad=0.0):
    """Standard deviations (6,) of a mount, as VALUES [m, rad], that such views allow; inf where they tell nothing.

    noise_rad: of a bearing along each axis; at least params.noise_deg is assumed.
    """
    _, J = _errors_and_jacobian(samples, np.asarray(mount.position_m), rotation_camera_to_body(mount), np.zeros(3))
    units = _limits(params)  # in these metres and radians are comparable
    _, strengths, axes = np.linalg.svd(J.reshape(-1, 6) * units, full_matrices=False)
    noise_rad = max(noise_rad, math.radians(params.noise_deg))
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.where(strengths > _TINY * strengths.max(initial=1.0), noise_rad / strengths, np.inf)
        parts = np.where(np.abs(axes) > 1e-6, axes**2 * along[:, None] ** 2, 0.0)
    known = np.sqrt(parts.sum(axis=0)) if len(strengths) == 6 else np.full(6, np.inf)
    return known * units


def weak_values(std, params):
    """Sentences on what is known less well than it should be. std: (6,), from `standard_deviations`."""
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


class _Problem:
    """Residuals and Jacobian of x = (t - t_start, delta), bearings first, then the prior."""

    def __init__(self, samples, start, params):
        self._samples = samples
        self._t_start = np.array(start.position_m)
        self._R_start = rotation_camera_to_body(start)
        # the prior counts as one bearing along each value
        prior = np.repeat((params.prior_m, math.radians(params.prior_deg)), 3)
        self._prior = np.diag(math.radians(params.noise_deg) / prior)

    def solve(self, x, scale_rad=None):
        """x at the least cost. scale_rad: of Cauchy's loss; None: plain squares."""
        robust = {} if scale_rad is None else {"loss": "cauchy", "f_scale": scale_rad}
        return least_squares(self.residuals, x, self.jacobian, **robust).x

    def residuals(self, x):
        return np.concatenate((self._parts(x)[0].ravel(), self._prior @ x))

    def jacobian(self, x):
        return np.vstack((self._parts(x)[1].reshape(-1, 6), self._prior))

    def _parts(self, x):
        R = self._R_start @ Rotation.from_rotvec(x[3:]).as_matrix()
        return _errors_and_jacobian(self._samples, self._t_start + x[:3], R, x[3:])


def _errors_and_jacobian(samples, position_m, R, delta):
    """Residuals v (n, 2) and their derivatives (n, 2, 6) by position and delta; R is R_start Exp(delta)."""
    n = len(samples.rays)
    d = (samples.points_body_m - position_m) @ R
    distance = np.maximum(np.linalg.norm(d, axis=1), _TINY)
    u = d / distance[:, None]
    dd = np.empty((n, 3, 6))
    dd[:, :, :3] = -R.T
    dd[:, :, 3:] = _cross_matrices(d) @ _right_jacobian(delta)
    du = (dd - u[:, :, None] * np.einsum("ni,nij->nj", u, dd)[:, None, :]) / distance[:, None, None]
    B = _tangents(samples.rays)
    a, da = np.einsum("nki,ni->nk", B, u), B @ du
    c, dc = np.einsum("ni,ni->n", samples.rays, u), np.einsum("ni,nij->nj", samples.rays, du)
    s = np.linalg.norm(a, axis=1)
    theta = np.arctan2(s, c)
    safe = np.maximum(s, _TINY)
    ratio = np.where(s > _TINY, theta / safe, 1.0)
    ds = np.einsum("nk,nkj->nj", a, da) / safe[:, None]
    dtheta = c[:, None] * ds - s[:, None] * dc
    bend = (dtheta - ratio[:, None] * ds) / safe[:, None]  # d(theta / s); next to m it is nothing
    bend[s <= 1e-6] = 0.0
    return ratio[:, None] * a, ratio[:, None, None] * da + a[:, :, None] * bend[:, None, :]


def _tangents(rays):
    """Orthonormal bases (n, 2, 3) of the tangent planes at unit vectors (n, 3): to the right, and across."""
    level = np.hypot(rays[:, 0], rays[:, 1])
    upright = level < 1e-6  # straight up or down any direction is to the right
    right = np.column_stack((-rays[:, 1], rays[:, 0], np.zeros(len(rays)))) / np.where(upright, 1.0, level)[:, None]
    right[upright] = (0.0, 1.0, 0.0)
    return np.stack((right, np.cross(rays, right)), axis=1)


def _cross_matrices(vectors):
    """(n, 3, 3) with [v]x w = v x w."""
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    return np.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=1).reshape(-1, 3, 3)


def _right_jacobian(delta):
    """J_r (3, 3) of SO(3)."""
    angle = np.linalg.norm(delta)
    K = _cross_matrices(delta[None])[0]
    if angle < 1e-6:
        return np.eye(3) - 0.5 * K
    return np.eye(3) - (1.0 - np.cos(angle)) / angle**2 * K + (angle - np.sin(angle)) / angle**3 * K @ K


def _mount(start, x):
    R = rotation_camera_to_body(start) @ Rotation.from_rotvec(x[3:]).as_matrix()
    roll, pitch, yaw = (float(angle) for angle in euler_from_body_to_ned(R))
    position_m = np.asarray(start.position_m) + x[:3]
    return CameraMount(tuple(position_m.tolist()), roll, pitch, yaw)


def _limits(params):
    """(6,) greatest standard deviations [m, rad], as VALUES."""
    return np.repeat((params.std_max_m, math.radians(params.std_max_deg)), 3)
