"""What a camera should see: directions, discs, hulls, the border of the picture, what hides what."""

import numpy as np
import pytest

from risc_estimation.bearings import make_camera
from risc_estimation.expected_bearings import Hull, Observer, look
from risc_lab.camera import Camera, cortex_to_camera
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.calibration import FRONT_MOUNT, CameraCalibration, CameraMount, load_calibration
from risc_lab.lab.landmark_catalogue import Disc

PLAIN = Camera(CameraCalibration.from_intrinsics("plain", (640, 360), (600.0, 600.0), (320.0, 180.0)))
AT_NOSE = CameraMount(position_m=(0.0, 0.0, 0.0))
LEVEL = rotation_body_to_cortex(0.0, 0.0, 0.0)  # nose along cortex +x
TOWARDS_US = (-1.0, 0.0, 0.0)


def see(targets, position_m=(0.0, 0.0, 1.0), R=LEVEL, camera=PLAIN, mount=AT_NOSE):
    return look(Observer(camera, mount), position_m, R, targets)


def disc(x, y, z, normal=TOWARDS_US, name="Green_pink"):
    return Disc(name, (x, y, z), normal)


def test_to_camera_is_that_of_one_pose_for_each_of_many():
    random = np.random.default_rng(3)
    positions, angles = random.normal(size=(5, 3)), random.normal(size=(5, 3))
    R = rotation_body_to_cortex(*angles.T)
    points = random.normal(size=(5, 3))
    mount = CameraMount((0.2, 0.01, -0.02), 0.1, -0.2, 0.3)
    many = cortex_to_camera(points, positions, R, mount)
    for k in range(5):
        np.testing.assert_allclose(many[k], cortex_to_camera(points[k], positions[k], R[k], mount), atol=1e-12)


@pytest.mark.parametrize(
    ("place", "azimuth", "elevation"),
    [((2.0, 0.0, 1.0), 0, 0), ((2.0, -0.2, 1.0), 1, 0), ((2.0, 0.2, 1.0), -1, 0), ((2.0, 0.0, 1.2), 0, 1)],
)
def test_each_axis_pushed_has_its_sign(place, azimuth, elevation):
    seen = see([disc(*place)])[0]
    assert np.degrees(seen.azimuth_rad) == pytest.approx(azimuth * np.degrees(np.arctan(0.1)), abs=1e-9)
    assert np.degrees(seen.elevation_rad) == pytest.approx(elevation * np.degrees(np.arctan(0.1)), abs=1e-9)
    assert seen.centre_px == pytest.approx([320 + 60 * azimuth, 180 - 60 * elevation])
    assert seen.fraction == 1.0 and seen.distance_m == pytest.approx(np.linalg.norm(np.subtract(place, (0, 0, 1))))


def test_a_vehicle_that_yaws_right_sees_things_move_left():
    seen = see([disc(2.0, 0.0, 1.0)], R=rotation_body_to_cortex(0.0, 0.0, np.radians(10.0)))[0]
    assert np.degrees(seen.azimuth_rad) == pytest.approx(-10.0)
    seen = see([disc(2.0, 0.0, 1.0)], R=rotation_body_to_cortex(0.0, np.radians(5.0), 0.0))[0]
    assert np.degrees(seen.elevation_rad) == pytest.approx(-5.0), "nose up: things move down"


def test_the_mount_counts():
    ahead = see([disc(2.0, 0.0, 1.0)], mount=FRONT_MOUNT)[0]
    assert ahead.distance_m == pytest.approx(2.0 - 0.21)
    turned = see([disc(2.0, 0.0, 1.0)], mount=CameraMount((0.0, 0.0, 0.0), yaw_rad=np.radians(3.0)))[0]
    assert np.degrees(turned.azimuth_rad) == pytest.approx(-3.0)


def test_a_facing_disc_has_its_size():
    seen = see([disc(2.0, 0.0, 1.0)])[0]
    assert np.array(seen.box_px) == pytest.approx([320 - 45, 180 - 45, 320 + 45, 180 + 45], abs=0.01)
    assert seen.diameter_px == pytest.approx(60.0, rel=5e-3), "of the disc in the middle"
    assert seen.obliqueness_rad == pytest.approx(0.0, abs=1e-6)


def test_an_oblique_disc_is_narrow_and_its_back_is_nothing():
    tilt = np.radians(60.0)
    seen = see([disc(4.0, 0.0, 1.0, (-np.cos(tilt), np.sin(tilt), 0.0))])[0]
    assert np.degrees(seen.obliqueness_rad) == pytest.approx(60.0)
    assert seen.diameter_px == pytest.approx(0.5 * 30.0, rel=0.02)
    back = see([disc(4.0, 0.0, 1.0, (1.0, 0.0, 0.0))])[0]
    assert back.fraction == 0.0 and np.isfinite(back.centre_px).all()
    unknown = see([disc(4.0, 0.0, 1.0, None)])[0]
    assert unknown.fraction == 1.0 and unknown.obliqueness_rad == pytest.approx(0.0, abs=1e-6)


def test_at_the_border_half_is_seen_and_beyond_it_nothing():
    half_width = 320.5 / 600.0
    half = see([disc(2.0, 2.0 * half_width, 1.0)])[0]
    assert half.fraction == pytest.approx(0.5, abs=0.01)
    assert half.box_px[0] == pytest.approx(-0.5)
    for place in ((2.0, 3.0, 1.0), (-2.0, 0.0, 1.0)):
        gone = see([disc(*place)])[0]
        assert gone.fraction == 0.0 and len(gone.outline_px) == 0


def test_what_is_nearer_hides():
    far, near = disc(3.0, 0.0, 1.0), Hull("Raven", (1.5, 0.0, 1.0), LEVEL)
    hidden, hull = see([far, near])
    assert hull.fraction == 1.0
    share = 0.07 / 1.25 / (0.3 / 3.0)  # height of the hull's near side over the disc's, as seen
    assert hidden.fraction == pytest.approx(1.0 - share * 4.0 / np.pi, abs=0.1)
    assert see([far])[0].fraction == 1.0
    beside = Hull("Raven", (1.5, 0.6, 1.0), LEVEL)
    assert see([far, beside])[0].fraction == 1.0
    behind = Hull("Raven", (3.5, 0.0, 1.0), LEVEL)
    assert see([far, behind])[0].fraction == 1.0


def test_a_hull_has_its_size_whichever_way_it_looks():
    seen = see([Hull("Raven", (4.0, 0.0, 1.0), LEVEL)])[0]
    x0, y0, x1, y1 = seen.box_px
    assert x1 - x0 == pytest.approx(600.0 * 0.5 / (4.0 - 0.135), rel=5e-3)
    assert y1 - y0 == pytest.approx(600.0 * 0.07 / 3.75, rel=5e-3)
    corner = see([Hull("Raven", (4.0, 0.0, 1.0), rotation_body_to_cortex(0.0, 0.0, np.pi / 4))])[0]
    assert np.ptp(corner.outline_px[:, 0]) == pytest.approx(600.0 * (2 * 0.135 * np.sqrt(2.0) + 0.23) / 4.0, rel=5e-3)
    rolled = see([Hull("Raven", (4.0, 0.0, 1.0), rotation_body_to_cortex(np.pi / 2, 0.0, 0.0))])[0]
    assert np.ptp(rolled.outline_px[:, 1]) > 5 * np.ptp(rolled.outline_px[:, 0])


@pytest.mark.parametrize("name", ["risc1.yaml", "risc2.yaml", "risc3.yaml", "albatross_ardrone_front.yaml"])
def test_raw_and_rectified_pictures_agree_on_angles(name):
    calibration = load_calibration(name)
    random = np.random.default_rng(5)
    targets = [disc(2.5, y, z) for y, z in random.uniform((-0.5, 0.8), (0.5, 1.3), (12, 2))]
    raw = [see([target], camera=make_camera(calibration, False))[0] for target in targets]
    rectified = [see([target], camera=make_camera(calibration, True))[0] for target in targets]
    for a, b in zip(raw, rectified):
        assert (a.azimuth_rad, a.elevation_rad) == (b.azimuth_rad, b.elevation_rad)
        assert b.fraction <= a.fraction + 1e-9
        both = a.fraction == 1.0 and b.fraction == 1.0
        if both:
            camera = make_camera(calibration, True)
            np.testing.assert_allclose(camera.bearings(b.centre_px), (a.azimuth_rad, a.elevation_rad), atol=1e-9)
    assert sum(item.fraction == 1.0 for item in rectified) >= 3


def test_nothing_to_see():
    assert see([]) == []
