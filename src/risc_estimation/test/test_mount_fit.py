"""Fitting a camera's mount: accuracy, wrong bearings, the Jacobian, what the views do not tell."""

import functools
import math

import mount_flight
import numpy as np
import pytest
from mount_flight import everything, fly, hovering, noisy, with_wrong_ones
from scipy.spatial.transform import Rotation

from risc_estimation.mount_fit import (
    FitParams,
    Samples,
    _residuals,
    fit_mount,
    pixel_errors,
    ray_errors,
    right_ones,
    root_mean_square,
)
from risc_lab.camera import Camera, rotation_camera_to_body
from risc_lab.lab.calibration import BOTTOM_MOUNT, FRONT_MOUNT, CameraMount, load_calibration, load_mount

TRUE = CameraMount((0.18, 0.02, -0.03), math.radians(2.0), math.radians(6.0), math.radians(-4.0))
ANGLE_MAX_DEG, POSITION_MAX_M = 0.2, 0.01  # what the tuner promises


@functools.lru_cache
def flown():
    """Samples of 30 s about the arena with the camera at TRUE, without noise."""
    return everything(fly(TRUE))


def angle_deg(first, second):
    """Angle between two mounts' attitudes."""
    turn = rotation_camera_to_body(first).T @ rotation_camera_to_body(second)
    return math.degrees(np.linalg.norm(Rotation.from_matrix(turn).as_rotvec()))


def distance_m(first, second):
    return float(np.linalg.norm(np.subtract(first.position_m, second.position_m)))


def displaced(mount, seed, angle=math.radians(15.0), distance=0.10):
    """The mount turned by 15 degrees and moved by 10 cm, each in a random direction."""
    random = np.random.default_rng(seed)
    axis, way = (v / np.linalg.norm(v) for v in random.normal(size=(2, 3)))
    R = rotation_camera_to_body(mount) @ Rotation.from_rotvec(angle * axis).as_matrix()
    yaw, pitch, roll = Rotation.from_matrix(R).as_euler("ZYX")
    return CameraMount(tuple(mount.position_m + distance * way), roll, pitch, yaw)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.2])
@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.release) for seed in range(2, 6))])
def test_a_mount_is_found_from_15_degrees_and_10_cm_away(seed, share):
    samples = with_wrong_ones(noisy(flown(), seed), share, seed)
    start = displaced(TRUE, seed)
    assert angle_deg(start, TRUE) == pytest.approx(15.0) and distance_m(start, TRUE) == pytest.approx(0.1)
    fit = fit_mount(samples, start)
    assert angle_deg(fit.mount, TRUE) <= ANGLE_MAX_DEG
    assert distance_m(fit.mount, TRUE) <= POSITION_MAX_M
    assert fit.warnings == ()
    assert 0.8 * share <= 1.0 - fit.misses.right.mean() <= share + 0.01
    # two axes of 0.3 degrees each
    assert math.degrees(fit.misses.rms_rad) == pytest.approx(0.3 * math.sqrt(2.0), rel=0.1)


def test_the_standard_deviations_are_those_of_many_flights():
    errors, promised = [], []
    for seed in range(30):
        fit = fit_mount(noisy(flown(), seed), displaced(TRUE, seed))
        turn = rotation_camera_to_body(TRUE).T @ rotation_camera_to_body(fit.mount)
        moved = np.subtract(fit.mount.position_m, TRUE.position_m)
        errors.append(np.concatenate((moved, Rotation.from_matrix(turn).as_rotvec())))
        promised.append(fit.std)
    # the spread of 30 is known to 13 %
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(errors), axis=0)), np.mean(promised, axis=0), rtol=0.4)


@pytest.mark.parametrize(
    "vehicle",
    [pytest.param("risc1", marks=pytest.mark.release), pytest.param("risc2", marks=pytest.mark.release), "risc3"],
)
def test_the_mounts_of_the_original_laboratory_are_found_from_the_nominal_one(vehicle):
    mount, camera = load_mount(vehicle + "_mount.yaml"), Camera(load_calibration(vehicle + ".yaml"))
    samples = noisy(everything(fly(mount, duration_s=60.0, camera=camera)), 1, noise_deg=0.1)
    fit = fit_mount(samples, FRONT_MOUNT)
    assert angle_deg(fit.mount, mount) <= ANGLE_MAX_DEG
    assert distance_m(fit.mount, mount) <= POSITION_MAX_M


def test_a_camera_that_looks_down_is_found_although_its_roll_and_yaw_are_one():
    on_the_floor = {"a": (0.6, 0.5, 0.1), "b": (-0.6, 0.5, 0.1), "c": (0.0, -0.7, 0.4)}
    mount = displaced(BOTTOM_MOUNT, 3, math.radians(3.0), 0.02)
    samples = noisy(everything(fly(mount, landmarks=on_the_floor)), 1)
    fit = fit_mount(samples, BOTTOM_MOUNT)
    assert angle_deg(fit.mount, mount) <= ANGLE_MAX_DEG and distance_m(fit.mount, mount) <= POSITION_MAX_M


def test_residuals_are_the_angles_between_rays_and_landmarks():
    """In all directions, also behind the camera and straight up."""
    random = np.random.default_rng(5)
    rays = random.normal(size=(40, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rays[:2] = [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)]  # the poles of azimuth and elevation
    samples = Samples(np.arange(40.0), np.array(["a"] * 40), random.normal(size=(40, 3)), rays)
    away = CameraMount(TRUE.position_m, *np.zeros(3))
    v = _residuals(samples, away, np.zeros(6)).reshape(-1, 3)
    np.testing.assert_allclose(np.linalg.norm(v, axis=1), ray_errors(samples, away), atol=1e-9)


def test_hovering_in_one_place_is_told():
    samples = noisy(everything(fly(TRUE, flight=hovering)), 1)
    fit = fit_mount(samples, displaced(TRUE, 1))
    assert len(fit.warnings) == 1 and "x is " in fit.warnings[0], fit.warnings
    assert fit.std[0] > 0.01
    # what the views do tell is right all the same, the rest stays within what the prior allows
    assert root_mean_square(ray_errors(samples, fit.mount)[fit.misses.right]) < math.radians(0.5)
    assert distance_m(fit.mount, TRUE) < 1.0


def test_one_landmark_from_one_place_tells_two_angles_only():
    one = {"Green_pink": (2.3, 0.8, 1.5)}

    def still(_t_s):
        return np.array((0.0, 0.8, 1.4)), (0.0, 0.0, 0.0)

    start = displaced(TRUE, 2)
    fit = fit_mount(noisy(everything(fly(TRUE, flight=still, landmarks=one)), 1), start)
    for name in ("x", "y", "z", "roll", "pitch", "yaw"):
        assert "%s is unknown" % name in fit.warnings[0]
    assert distance_m(fit.mount, start) < 0.3, "what the samples do not tell stays where it was"
    assert np.isfinite(fit.mount.position_m).all()


def test_too_few_bearings_are_refused_with_the_cure():
    samples = everything(fly(TRUE, duration_s=1.0))
    assert 0 < len(samples.times_s) < 30
    with pytest.raises(ValueError, match="^%d .* 30 " % len(samples.times_s)):
        fit_mount(samples, TRUE)


def test_many_wrong_bearings_are_told():
    samples = with_wrong_ones(noisy(flown(), 1), 0.42, 1)
    fit = fit_mount(samples, displaced(TRUE, 1))
    assert any("42 %" in text for text in fit.warnings), fit.warnings


def test_errors_in_pixels_are_those_of_the_picture():
    samples = flown()
    assert np.nanmax(pixel_errors(samples, TRUE, mount_flight.CAMERA)) < 0.1
    turned = CameraMount(TRUE.position_m, TRUE.roll_rad, TRUE.pitch_rad + math.radians(1.0), TRUE.yaw_rad)
    near_axis = samples.take(np.abs(samples.rays[:, 0] - 1.0) < 0.01)
    pixels = pixel_errors(near_axis, turned, mount_flight.CAMERA)
    assert len(pixels) > 20
    np.testing.assert_allclose(pixels, 580.0 * math.radians(1.0), rtol=0.05)


def test_what_is_right_is_judged_by_the_others():
    params = FitParams(noise_deg=0.1, gate=4.0)
    errors = np.radians(np.concatenate((np.full(80, 15.0), np.full(20, 70.0))))
    np.testing.assert_array_equal(right_ones(errors, params), [True] * 80 + [False] * 20)
    assert not right_ones(np.zeros(0), params).size
    np.testing.assert_array_equal(right_ones(np.radians([0.0, 0.0, 0.0, 0.39, 0.41]), params), [True] * 4 + [False])
    assert math.isnan(root_mean_square([])) and root_mean_square([3.0, math.nan, 4.0]) == pytest.approx(math.sqrt(12.5))


@pytest.mark.parametrize("bad", [{"noise_deg": 0.0}, {"wrong_max": 1.0}, {"samples_min": 5}, {"prior_m": -1.0}])
def test_bad_settings_are_named(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        FitParams(**bad)
