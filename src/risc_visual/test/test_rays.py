"""Rays: where they end, what they look like, and which pictures have a place."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from risc_estimation.bearings import Bearing
from risc_lab.camera import cortex_to_camera
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.calibration import CameraMount
from risc_lab.vehicle_frames import camera_transform
from risc_visual.drawing.palette import vehicle_colour
from risc_visual.drawing.params import RayParams
from risc_visual.drawing.rays import RayStyles, Shown, Whereabouts
from risc_visual.vision.landmark_config import load_landmarks

LANDMARKS = load_landmarks()


def bearing(name, azimuth_deg, elevation_deg, visible=True):
    return Bearing(name, visible, math.radians(azimuth_deg), math.radians(elevation_deg))


def styles(**params):
    return RayStyles(RayParams(**params), LANDMARKS, [("risc1", "fluffy_II"), ("risc2", "albatross")])


@pytest.mark.parametrize(
    "azimuth_deg, elevation_deg, end_m",
    [
        (0, 0, (4, 0, 0)),  # along the optical axis
        (30, 0, (4 * math.cos(math.pi / 6), 2, 0)),  # to the right
        (-30, 0, (4 * math.cos(math.pi / 6), -2, 0)),
        (0, 20, (4 * math.cos(math.pi / 9), 0, -4 * math.sin(math.pi / 9))),  # up is against z
        (0, -20, (4 * math.cos(math.pi / 9), 0, 4 * math.sin(math.pi / 9))),
    ],
)
def test_known_bearing_has_a_known_end(azimuth_deg, elevation_deg, end_m):
    (ray,) = styles().rays([bearing("green", azimuth_deg, elevation_deg)])
    np.testing.assert_allclose(ray.end_m, end_m, atol=1e-12)


def test_every_ray_is_as_long_as_asked():
    rays = styles(length_m=2.5).rays([bearing(str(k), 7 * k - 30, 3 * k - 12) for k in range(9)])
    np.testing.assert_allclose([np.linalg.norm(ray.end_m) for ray in rays], 2.5)


def test_ray_in_the_camera_frame_of_tf_points_at_the_landmark():
    """From a landmark's position to the bearing in a camera, and back into the cortex frame by the transforms of tf."""
    vehicle_m, euler_rad, landmark_m = np.array([0.4, -0.3, 1.2]), (0.1, -0.15, 0.7), np.array([1.9, -1.4, 1.6])
    mount = CameraMount((0.2, 0.01, 0.03), *np.radians((2.0, 5.0, -5.0)))
    R = rotation_body_to_cortex(*euler_rad)
    x, y, z = cortex_to_camera(landmark_m, vehicle_m, R, mount)
    (ray,) = styles(azimuth_max_deg=89.0).rays(
        [Bearing("green", True, math.atan2(y, x), math.atan2(-z, math.hypot(x, y)))]
    )
    to_body = camera_transform("fluffy_II", mount)
    end_body = Rotation.from_quat(to_body.quaternion_xyzw).apply(ray.end_m) + to_body.position_m
    start_m, end_m = vehicle_m + R @ to_body.position_m, vehicle_m + R @ end_body
    direction, wanted = end_m - start_m, landmark_m - start_m
    np.testing.assert_allclose(direction / np.linalg.norm(direction), wanted / np.linalg.norm(wanted), atol=1e-12)


def test_limits_and_numbers_that_are_none():
    drawn = [
        bearing("inside", 39.9, -29.9),
        bearing("right", 40.1, 0),
        bearing("left", -40.1, 0),
        bearing("above", 0, 30.1),
        bearing("below", 0, -30.1),
        bearing("unseen", 0, 0, visible=False),
        bearing("none", float("nan"), float("nan")),
        bearing("half", 0, float("nan")),
        bearing("endless", float("inf"), 0),
    ]
    assert [ray.name for ray in styles().rays(drawn)] == ["inside"]
    assert {ray.name for ray in styles(azimuth_max_deg=60.0).rays(drawn)} == {"inside", "right", "left"}
    assert styles().rays([]) == []


def test_a_name_has_one_ray():
    rays = styles().rays([bearing("green", 1, 0), bearing("green", 9, 0), bearing("blue", 5, 0)])
    assert [ray.name for ray in rays] == ["green", "blue"]
    np.testing.assert_allclose(rays[0].end_m[1], 4 * math.sin(math.radians(1)))


def test_colours_and_widths_of_the_original():
    names = ["green", "blue", "pink", "Orange", "Green_pink", "Blue_green", "Pink_blue", "Orange_blue", "new"]
    rays = {ray.name: ray for ray in styles().rays([bearing(name, 0, 0) for name in names])}
    wanted = {"green": (0, 1, 0), "blue": (0, 0, 1), "pink": (0.78, 0.082, 0.52), "Orange": (1, 0.27, 0)}
    wanted.update(zip(("Green_pink", "Blue_green", "Pink_blue", "Orange_blue"), list(wanted.values())), new=(1, 1, 1))
    assert {name: ray.rgb for name, ray in rays.items()} == wanted
    assert {name for name, ray in rays.items() if ray.width_m == 0.01} == {name for name in names if "_" in name}
    assert {ray.width_m for ray in rays.values()} == {0.01, 0.04}


def test_rays_to_vehicles_have_the_colours_of_the_vehicles():
    seen = [bearing("risc2", 0, 0), bearing("albatross", 1, 0), bearing("fluffy_II", 2, 0), bearing("stranger", 3, 0)]
    rays = styles().rays(seen, to_vehicles=True)
    assert [ray.rgb for ray in rays] == [vehicle_colour(1), vehicle_colour(1), vehicle_colour(0), (1.0, 1.0, 1.0)]
    assert all(ray.is_vehicle and ray.width_m == 0.04 for ray in rays)


def test_a_picture_has_a_place_near_the_last_sight_of_its_vehicle():
    known = Whereabouts(max_age_s=5.0)
    assert known.stamp_of("Raven", 10.0) == 10.0  # never named: a camera on a stand
    known.note(100.0, {"Raven": True, "Kahn": False})
    assert known.stamp_of("Raven", 99.9) == 99.9
    assert known.stamp_of("Raven", 100.1) == 100.1  # motion capture is behind by a little
    assert known.stamp_of("Raven", 94.0) is None  # too old for tf
    assert known.stamp_of("Raven", 102.0) is None  # it was not seen any more
    assert known.stamp_of("Kahn", 100.0) is None
    known.note(100.5, {"Raven": False})
    assert known.stamp_of("Raven", 100.2) == 100.2  # it was seen up to 100
    assert known.stamp_of("Raven", 100.6) is None
    known.note(20.0, {"Raven": True})  # a bag that starts again
    assert known.stamp_of("Raven", 19.9) == 19.9


def test_a_picture_without_a_stamp_is_placed_where_its_vehicle_was_seen_last():
    known = Whereabouts(max_age_s=5.0)
    known.note(100.0, {"Raven": True, "Kahn": False})
    assert known.stamp_of("Raven", 0.0) == 100.0
    assert known.stamp_of("Kahn", 0.0) is None


def test_what_is_not_renewed_is_told_once():
    shown = Shown(lifetime_s=0.3)
    shown.renew(["a", "b"], 10.0)
    shown.renew(["b"], 10.2)
    assert shown.pop_expired(10.25) == []
    assert shown.pop_expired(10.35) == ["a"]
    assert shown.pop_expired(10.35) == []
    shown.renew(["c"], 3.0)  # the clock was set back
    assert shown.pop_expired(3.1) == ["b"]
    assert shown.pop_expired(3.4) == ["c"]
