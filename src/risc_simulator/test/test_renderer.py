"""Pictures against geometry that is computed independently: places, sizes, colours, motion, noise, truth."""

import math
import pathlib
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

from risc_lab.camera import Camera, bearings_of_rays
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.calibration import CameraCalibration
from risc_simulator.video.renderer import light_colour, noise_tile, to_camera
from risc_simulator.video.scene import (
    Board,
    CameraPose,
    Disc,
    HullColour,
    Panel,
    Prop,
    Scene,
    VehiclePose,
    Walls,
    bgr_of_hsv,
    load_style,
    plane_axes,
)

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[3] / "tests/benchmarks"))
from picture_truth import LabelledRenderer, corners_of  # noqa: E402

SIZE_PX = (640, 360)
CALIBRATIONS = {  # focal lengths, centre [px], k1, k2, p1, p2, k3; the first three are those of the original laboratory
    "fluffy_II": ((977.994066, 975.285107), (357.362844, 160.919363), (-1.455445, 1.626447, 0.014496, -0.028790, 0.0)),
    "albatross": ((587.475731, 584.474852), (332.151306, 198.136356), (-0.629084, 0.388896, -0.002180, 0.001088, 0.0)),
    "Raven": ((663.931413, 670.012130), (385.105531, 182.633137), (-0.684161, 0.288271, 0.008015, -0.044440, 0.0)),
    "wide": ((455.0, 455.0), (322.0, 176.0), (-0.28, 0.08, 0.0, 0.0, 0.0)),
    "pinhole": ((580.0, 580.0), (319.5, 179.5), (0.0, 0.0, 0.0, 0.0, 0.0)),
}
BLACK, WHITE = (0.0, 0.0, 0.0), (250.0, 250.0, 250.0)
STYLE = load_style()
DARK_ROOM = replace(
    STYLE.room,
    floor=BLACK,
    floor_tiles=BLACK,
    marks=0,
    ceiling=BLACK,
    lamps=BLACK,
    walls=Walls(BLACK, BLACK, BLACK, BLACK),
    skirting=BLACK,
    net=BLACK,
    posts=BLACK,
    panels=(),
)
PERFECT = replace(STYLE.imaging, exposure_s=0.0, defocus_px=0.0, vignette=0.0, read_noise=0.0, shot_noise=0.0)
NOISE = noise_tile(0)  # shared: making one takes longer than a picture


def in_room(room, **things):
    """Scene in another room."""
    return Scene(replace(STYLE, room=room), **things)


def walls_in(hsv):
    """The dark room, larger, with walls of one colour."""
    return replace(DARK_ROOM, half_x_m=9.0, walls=Walls(hsv, hsv, hsv, hsv), height_m=9.0)


DARK = in_room(DARK_ROOM)


def camera_of(name):
    return Camera(CameraCalibration.from_intrinsics(name, SIZE_PX, *CALIBRATIONS[name]))


PINHOLE = camera_of("pinhole")


def renderer(camera=PINHOLE, scene=DARK, imaging=PERFECT, seed=0):
    return LabelledRenderer(camera, replace(scene, style=replace(scene.style, imaging=imaging)), seed, NOISE)


def pose(position=(0.0, 0.0, 1.5), roll=0.0, pitch=0.0, yaw=0.0, velocity=(0, 0, 0), rate=(0, 0, 0)):
    R = rotation_body_to_cortex(roll, pitch, yaw)
    return CameraPose(np.array(position, float), R, np.array(velocity, float), np.array(rate, float))


def disc_at(camera, camera_pose, pixel, distance_m, obliqueness=0.0, leaning=0.0, **colours):
    """White disc whose centre is seen at a pixel."""
    ray = camera_pose.R_camera_to_cortex @ camera.rays(pixel)
    across, upward = plane_axes(-ray)
    side = math.cos(leaning) * across + math.sin(leaning) * upward
    normal = -math.cos(obliqueness) * ray + math.sin(obliqueness) * side
    values = dict(centre_bgr=WHITE, ring_bgr=WHITE, **colours)
    return Disc("disc", tuple(camera_pose.position_m + distance_m * ray), tuple(normal), **values)


def moments(picture):
    """Area [px] and centroid (2,) of the white pixels, from one channel."""
    share = picture[:, :, 1] / WHITE[1]
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]]
    return share.sum(), np.array([(share * x).sum(), (share * y).sum()]) / share.sum()


def outline_px(camera, camera_pose, disc, diameter_m):
    """Outline of the disc's image as 2000 points (n, 2) [px]."""
    across, upward = plane_axes(disc.normal)
    angle = np.linspace(0.0, 2.0 * np.pi, 2001)[:-1, None]
    points = np.asarray(disc.centre_m) + 0.5 * diameter_m * (np.cos(angle) * across + np.sin(angle) * upward)
    return camera.project(to_camera(camera_pose, points))


def area_and_centroid(points):
    """Area and centroid of a polygon (n, 2)."""
    middle = points.mean(axis=0)
    x, y = (points - middle).T
    x1, y1 = np.roll(x, -1), np.roll(y, -1)
    cross = x * y1 - x1 * y
    return 0.5 * abs(cross.sum()), middle + np.array([((x + x1) * cross).sum(), ((y + y1) * cross).sum()]) / (
        3.0 * cross.sum()
    )


@pytest.mark.parametrize("name", sorted(CALIBRATIONS))
def test_the_lens_is_that_of_the_camera_module(name):
    camera = camera_of(name)
    pixels = np.stack(np.meshgrid(np.linspace(-10, 650, 12), np.linspace(-10, 370, 8)), axis=-1).reshape(-1, 2)
    points = camera.rays(pixels) * np.linspace(0.3, 6.0, len(pixels))[:, None]
    camera_pose = pose(roll=0.2, pitch=-0.3, yaw=2.0)
    world = points @ camera_pose.R_camera_to_cortex.T + camera_pose.position_m
    assert np.allclose(renderer(camera).project(world, camera_pose), camera.project(points), atol=1e-8)


@pytest.mark.parametrize("name", sorted(CALIBRATIONS))
@pytest.mark.parametrize(
    "pixel, distance_m, obliqueness, leaning",
    [
        ((320.3, 180.6), 2.0, 0.0, 0.0),
        ((140.0, 110.0), 1.1, 0.6, 0.4),
        ((520.7, 300.2), 3.9, 1.2, 2.0),
        ((410.4, 170.1), 0.8, 0.9, 4.0),
    ],
)
def test_discs_have_their_place_and_their_size(name, pixel, distance_m, obliqueness, leaning):
    camera, camera_pose = camera_of(name), pose(roll=0.1, pitch=0.05, yaw=0.3)
    distance_m *= camera.K[0, 0] / 580.0  # whole discs, with any lens
    disc = disc_at(camera, camera_pose, pixel, distance_m, obliqueness, leaning)
    drawn = renderer(camera, replace(DARK, discs=(disc,)))
    area, centroid = area_and_centroid(outline_px(camera, camera_pose, disc, 0.30))
    found_area, found_centroid = moments(drawn.render(camera_pose))
    assert np.linalg.norm(found_centroid - centroid) < 0.02
    assert found_area == pytest.approx(area, rel=3e-3)
    (truth,) = drawn.truth(camera_pose)
    assert np.linalg.norm(np.array(truth.centre_px) - pixel) < 1e-6
    outline = outline_px(camera, camera_pose, disc, 0.30)
    # the drawn outline has few corners: its box may miss the extremes slightly
    box = np.concatenate((outline.min(axis=0), outline.max(axis=0)))
    assert np.abs(truth.box_px - box).max() < 0.002 * np.ptp(outline, axis=0).max()
    inner = outline_px(camera, camera_pose, disc, 0.20)
    axes = cv2.fitEllipse(inner.astype(np.float32))[1]
    assert truth.diameter_px == pytest.approx(min(axes), rel=0.02)  # perspective: not quite an ellipse when distorted


def test_frontal_discs_of_all_sizes_are_centred_on_their_truth(inputs):
    """Down to discs of 5 px, at any subpixel position."""
    rng = np.random.default_rng(0)
    for distance_m in (1.0, 4.0, 15.0, 35.0):
        for _ in range(inputs(4, 8)):
            pixel = rng.uniform((250.0, 100.0), (400.0, 260.0))
            room = replace(DARK_ROOM, half_x_m=40.0, half_y_m=40.0, height_m=40.0)
            disc = disc_at(PINHOLE, pose(), pixel, distance_m)
            area, centroid = moments(renderer(scene=in_room(room, discs=(disc,))).render(pose()))
            # off the optical axis the centre of a frontal disc is not the centroid of its image
            expected = area_and_centroid(outline_px(PINHOLE, pose(), disc, 0.30))
            assert np.linalg.norm(centroid - expected[1]) < 0.03
            assert area == pytest.approx(expected[0], rel=0.01)


def test_right_left_up_down():
    """Looking along +x: +y is left, +z is up. Looking along -x, +y is right."""
    style = load_style()
    scene = replace(DARK, discs=(style.disc("Green_pink", (3.0, 0.5, 1.8), (-1.0, 0.0, 0.0)),))
    (truth,) = renderer(scene=scene).truth(pose())
    assert truth.centre_px[0] < 320 and truth.centre_px[1] < 180
    assert truth.azimuth_rad < 0.0 < truth.elevation_rad
    scene = replace(DARK, discs=(style.disc("Green_pink", (-3.0, 0.5, 1.2), (1.0, 0.0, 0.0)),))
    (truth,) = renderer(scene=scene).truth(pose(yaw=math.pi))
    assert truth.centre_px[0] > 320 and truth.centre_px[1] > 180
    assert truth.elevation_rad < 0.0 < truth.azimuth_rad


def test_colours_of_centre_and_ring_and_none_from_behind():
    style = load_style()
    front = style.disc("Green_pink", (2.0, 0.0, 1.5), (-1.0, 0.0, 0.0))
    picture = renderer(scene=replace(DARK, discs=(front,))).render(pose())
    scale = PINHOLE.K[0, 0] / 2.0
    centre, ring = front.centre_bgr, front.ring_bgr
    assert np.array_equal(picture[180, 320], centre)
    assert np.array_equal(picture[180, int(320 + 0.125 * scale)], ring)
    assert np.array_equal(picture[180, int(320 + 0.16 * scale)], BLACK)
    behind = renderer(scene=replace(DARK, discs=(replace(front, normal=(1.0, 0.0, 0.0)),)))
    assert np.array_equal(behind.render(pose())[180, 320], bgr_of_hsv(STYLE.disc_backs))
    assert behind.truth(pose()) == []


def test_truth_angles_are_those_of_the_line_of_sight():
    camera = camera_of("Raven")
    camera_pose = pose(roll=0.2, pitch=-0.1, yaw=-2.0)
    disc = disc_at(camera, camera_pose, (200.0, 250.0), 2.5, 0.7, 1.0)
    (truth,) = renderer(camera, replace(DARK, discs=(disc,))).truth(camera_pose)
    assert truth.distance_m == pytest.approx(2.5)
    assert truth.obliqueness_rad == pytest.approx(0.7)
    assert np.allclose((truth.azimuth_rad, truth.elevation_rad), camera.bearings(truth.centre_px), atol=1e-9)
    assert np.allclose(
        (truth.azimuth_rad, truth.elevation_rad), bearings_of_rays(to_camera(camera_pose, np.array([disc.centre_m]))[0])
    )
    assert (truth.kind, truth.seen_fraction) == ("landmark", pytest.approx(1.0, abs=1e-3))


def test_seen_fraction_at_the_border_and_behind_others():
    parallel = replace(disc_at(PINHOLE, pose(), (-0.5, 180.0), 2.0), normal=(-1.0, 0.0, 0.0))  # seen as a circle
    (truth,) = renderer(scene=replace(DARK, discs=(parallel,))).truth(pose())
    assert truth.seen_fraction == pytest.approx(0.5, abs=0.002)
    disc = disc_at(PINHOLE, pose(), (319.5, 179.5), 2.0)
    # a curtain at 1 m in front of its left half, and one that hides all
    for right_edge, share in ((0.0, 0.5), (-0.2, 0.0), (0.2, 1.0)):
        curtain = Prop(
            np.array([(1.0, 1.0, 1.0), (1.0, right_edge, 1.0), (1.0, right_edge, 2.0), (1.0, 1.0, 2.0)]), WHITE
        )
        scene = replace(DARK, discs=(disc,), props=(curtain,))
        (truth,) = renderer(scene=scene).truth(pose())
        assert truth.seen_fraction == pytest.approx(share, abs=0.005)
    further = Prop(curtain.outline_m * (3.0, 1.0, 1.0), WHITE)
    (truth,) = renderer(scene=replace(DARK, discs=(disc,), props=(further,))).truth(pose())
    assert truth.seen_fraction == pytest.approx(1.0)


def test_nothing_beside_or_behind_the_camera_is_listed_or_drawn():
    discs = tuple(
        Disc("d%d" % k, tuple(centre), tuple(-np.array(direction)), WHITE, WHITE)
        for k, direction in enumerate([(-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)])
        for centre in [np.array((0.0, 0.0, 1.5)) + np.array(direction)]
    )
    for name in CALIBRATIONS:
        drawn = renderer(camera_of(name), replace(DARK, discs=discs))
        assert drawn.truth(pose()) == []
        assert not drawn.render(pose()).any()


def test_a_distortion_that_folds_does_not_bring_back_what_is_outside():
    folding = Camera(
        CameraCalibration.from_intrinsics("k1", SIZE_PX, (500.0, 500.0), (319.5, 179.5), (-0.33, 0, 0, 0, 0))
    )
    assert 0.9 < folding.radius_limit < 1.1
    far_out = tuple(
        Disc("d", (math.cos(a), math.sin(a), 1.5), (-math.cos(a), -math.sin(a), 0.0), WHITE, WHITE)
        for a in np.radians((52.0, 58.0, 64.0, 70.0))
    )
    drawn = renderer(folding, replace(DARK, discs=far_out))
    assert not drawn.render(pose()).any()
    assert drawn.truth(pose()) == []


def test_vehicles_nose_and_tail_and_centre():
    red_and_green = {"h": HullColour((0.0, 255.0, 200.0), (60.0, 255.0, 200.0))}
    scene = Scene(replace(DARK.style, hulls=replace(STYLE.hulls, colours=red_and_green)))
    drawn = renderer(scene=scene)
    # its nose points to +y: left in the picture
    vehicle = VehiclePose("other", np.array((2.0, 0.1, 1.5)), rotation_body_to_cortex(0.0, 0.0, -0.5 * math.pi))
    picture = drawn.render(pose(), (vehicle,)).astype(int)
    red = np.argwhere(picture[:, :, 2] > picture[:, :, 1] + 60)[:, 1]
    green = np.argwhere(picture[:, :, 1] > picture[:, :, 2] + 60)[:, 1]
    (truth,) = drawn.truth(pose(), (vehicle,))
    assert red.max() <= green.min()
    assert 0.5 * (red.max() + green.min()) == pytest.approx(truth.centre_px[0], abs=1.0)
    assert (truth.name, truth.kind) == ("other", "vehicle")
    assert np.allclose(truth.centre_px, PINHOLE.project((2.0, -0.1, 0.0)))
    assert len(red) > 300 and len(green) > 300
    rows = np.argwhere(picture.any(axis=2))
    assert np.allclose(truth.box_px[:2], rows.min(axis=0)[::-1], atol=1.0)
    assert np.allclose(truth.box_px[2:], rows.max(axis=0)[::-1], atol=1.0)


def test_vehicle_hides_landmark():
    disc = disc_at(PINHOLE, pose(), (319.5, 179.5), 3.0)
    vehicle = VehiclePose("other", np.array((1.2, 0.0, 1.5)), rotation_body_to_cortex(0.0, 0.4, 0.3))
    drawn = renderer(scene=replace(DARK, discs=(disc,)))
    truths = {truth.name: truth for truth in drawn.truth(pose(), (vehicle,))}
    hidden = truths["disc"].seen_fraction
    assert 0.0 <= hidden < 0.7 and truths["other"].seen_fraction == pytest.approx(1.0)
    whole = moments(drawn.render(pose()))[0]
    seen = (drawn.render(pose(), (vehicle,)) == WHITE).all(axis=2).sum()
    assert seen / whole == pytest.approx(hidden, abs=0.04)  # pixels on the edges are not counted


def test_board_corners_are_found_where_they_are():
    camera = camera_of("albatross")
    camera_pose = pose(roll=0.05, pitch=0.1, yaw=0.2)
    tilt = cv2.Rodrigues(np.array([0.3, 0.4, 0.1]))[0]
    board_axes = np.array([(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])  # columns: x right, y down, z ahead
    R = camera_pose.R_camera_to_cortex @ board_axes @ tilt
    centre = camera_pose.position_m + camera_pose.R_camera_to_cortex @ (0.55, 0.02, -0.01)
    board = Board(8, 6, 0.025, tuple(centre), R)
    drawn = renderer(camera, imaging=replace(PERFECT, defocus_px=0.6))
    grey = cv2.cvtColor(drawn.render(camera_pose, boards=(board,)), cv2.COLOR_BGR2GRAY)
    found, corners = cv2.findChessboardCorners(grey, (8, 6))
    assert found
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
    corners = cv2.cornerSubPix(grey, corners, (5, 5), (-1, -1), criteria)[:, 0]
    expected = camera.project(to_camera(camera_pose, corners_of(board)))
    if np.linalg.norm(corners[0] - expected[0]) > np.linalg.norm(corners[-1] - expected[0]):
        corners = corners[::-1]
    error = np.linalg.norm(corners - expected, axis=1)
    assert np.median(error) < 0.05 and error.max() < 0.15
    assert np.linalg.norm((corners - expected).mean(axis=0)) < 0.02  # no half pixels


def test_board_from_behind_is_blank():
    board_axes = np.array([(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
    turned = pose().R_camera_to_cortex @ board_axes @ np.diag((-1.0, 1.0, -1.0))
    board = Board(8, 6, 0.025, (0.6, 0.0, 1.5), turned)
    picture = renderer().render(pose(), boards=(board,))
    assert set(np.unique(picture[150:210, 280:360])) == {225}


def test_motion_blur_is_the_mean_over_the_exposure():
    exposure_s, turn = 0.01, 1.2  # 7 px to the left at this focal length
    disc = disc_at(PINHOLE, pose(), (319.5, 179.5), 2.0)
    scene = replace(DARK, discs=(disc,))
    still, sharp = moments(renderer(scene=scene).render(pose())), renderer(scene=scene).render(pose())
    blurred = renderer(scene=scene, imaging=replace(PERFECT, exposure_s=exposure_s)).render(pose(rate=(0, 0, turn)))
    area, centroid = moments(blurred)
    assert np.allclose(centroid, still[1], atol=0.03)
    assert area == pytest.approx(still[0], rel=5e-3)
    motion_px = PINHOLE.K[0, 0] * math.tan(turn * exposure_s)
    profile = blurred[180, :, 1] / WHITE[1]
    ramp = np.flatnonzero((profile > 0.02) & (profile < 0.98))
    left = ramp[ramp < 320]
    assert len(left) == pytest.approx(motion_px, abs=1.5)
    assert np.abs(np.diff(profile[left]) - 1.0 / motion_px).max() < 0.05  # a straight ramp
    column = blurred[:, 320, 1] / WHITE[1]
    assert ((column > 0.02) & (column < 0.98)).sum() <= 2  # and none across the motion
    # compare with the mean of many sharp pictures over the exposure
    times = (np.arange(20) + 0.5) / 20 * exposure_s - 0.5 * exposure_s
    mean = np.mean([renderer(scene=scene).render(pose(yaw=turn * t)).astype(float) for t in times], axis=0)
    assert np.abs(mean - blurred).max() < 0.06 * WHITE[0]
    assert np.abs(mean - sharp).max() > 0.4 * WHITE[0]


def test_blur_mixes_centre_ring_and_background_by_their_shares():
    """A small disc that moves by more than its ring's width, in colours of one channel each."""
    disc = disc_at(PINHOLE, pose(), (310.2, 170.8), 6.0)
    disc = replace(disc, centre_bgr=(200.0, 0.0, 0.0), ring_bgr=(0.0, 0.0, 200.0))
    green = (60.0, 255.0, 200.0)
    scene = in_room(replace(walls_in(green), net=green), discs=(disc,))
    imaging = replace(PERFECT, exposure_s=0.015)
    picture = renderer(scene=scene, imaging=imaging).render(pose(rate=(0.0, 0.0, 1.2))).astype(float)
    shares = picture[100:240, 250:380] / 200.0
    assert np.abs(shares.sum(axis=2) - 1.0).max() < 0.013  # rounding of three values
    scale = (PINHOLE.K[0, 0] / 6.0) ** 2 * math.pi / 4.0
    assert shares[:, :, 0].sum() == pytest.approx(scale * 0.20**2, rel=0.01)
    assert shares[:, :, 2].sum() == pytest.approx(scale * (0.30**2 - 0.20**2), rel=0.01)


def test_translation_blurs_near_things_more():
    discs = (disc_at(PINHOLE, pose(), (200.0, 179.5), 1.0), disc_at(PINHOLE, pose(), (450.0, 179.5), 4.0))
    imaging = replace(PERFECT, exposure_s=0.02)
    picture = renderer(scene=replace(DARK, discs=discs), imaging=imaging).render(pose(velocity=(0.0, 0.6, 0.0)))
    profile = picture[180, :, 1] / WHITE[1]
    ramps = np.flatnonzero((profile > 0.02) & (profile < 0.98))
    near, far = (ramps < 200).sum(), (ramps > 450).sum()
    assert near == pytest.approx(0.012 * PINHOLE.K[0, 0] / 1.0, abs=1.5)
    assert far == pytest.approx(0.012 * PINHOLE.K[0, 0] / 4.0, abs=1.5)


def test_room_blurs_along_the_motion_and_stays_in_its_place(inputs):
    panel = Panel("front", (0.0, 1.5), (1.0, 1.0), (0.0, 0.0, 250.0))
    scene = in_room(replace(DARK_ROOM, panels=(panel,)))
    sharp = renderer(scene=scene).render(pose())
    few = (0.0, 0.7, -0.7), (2.0, 0.0, 0.0)
    for rate in inputs(few, (*few, (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))):
        imaging = replace(PERFECT, exposure_s=0.015)
        blurred = renderer(scene=scene, imaging=imaging).render(pose(rate=rate))
        assert np.allclose(moments(blurred)[1], moments(sharp)[1], atol=0.8)
        times = (np.arange(20) + 0.5) / 20 * 0.015 - 0.0075
        mean = np.mean(
            [
                renderer(scene=scene).render(replace(pose(), R_camera_to_cortex=cv2.Rodrigues(R)[0])).astype(float)
                for R in [turned(rate, t) for t in times]
            ],
            axis=0,
        )
        assert np.abs(mean - blurred).mean() < 0.35 * np.abs(mean - sharp).mean() + 0.01


def turned(rate, time_s):
    """Rotation vector of the pose after turning from pose() at a rate in camera axes."""
    return cv2.Rodrigues(pose().R_camera_to_cortex @ cv2.Rodrigues(np.array(rate) * time_s)[0])[0]


def test_rolling_exposure_leans():
    stripe = Prop(np.array([(2.0, 0.02, 0.5), (2.0, -0.02, 0.5), (2.0, -0.02, 2.5), (2.0, 0.02, 2.5)]), WHITE)
    tall = Prop(np.concatenate([np.linspace(a, b, 40)[:-1] for a, b in pairs(stripe.outline_m)]), WHITE)
    imaging = replace(PERFECT, rolling_s=0.02)
    picture = renderer(scene=replace(DARK, props=(tall,)), imaging=imaging).render(pose(rate=(0.0, 0.0, 1.0)))
    x = np.arange(640)
    top, middle, bottom = (picture[row, :, 1] @ x / picture[row, :, 1].sum() for row in (0, 180, 359))
    shift_px = PINHOLE.K[0, 0] * 0.02 * 1.0  # turning right moves things left; the last row comes later
    assert top - bottom == pytest.approx(shift_px, rel=0.02)
    assert middle == pytest.approx(319.5, abs=0.1)
    disc = disc_at(PINHOLE, pose(), (319.5, 60.0), 2.0)
    drawn, turning = renderer(scene=replace(DARK, discs=(disc,)), imaging=imaging), pose(rate=(0.0, 0.0, 1.0))
    shift = np.subtract(drawn.truth(turning)[0].centre_px, drawn.truth(pose())[0].centre_px)
    assert shift[0] == pytest.approx(shift_px * (180.0 - 60.0) / 360.0, rel=0.02)
    assert np.allclose(shift, moments(drawn.render(turning))[1] - moments(drawn.render(pose()))[1], atol=0.1)


def pairs(corners):
    return zip(corners, np.roll(corners, -1, axis=0))


def test_gain_is_linear_and_clips():
    disc = disc_at(PINHOLE, pose(), (319.5, 179.5), 1.0)
    scene = replace(DARK, discs=(replace(disc, centre_bgr=(60.0, 100.0, 200.0)),))
    for gain in (0.3, 1.0, 2.0):
        pixel = renderer(scene=scene).render(pose(), gain=gain)[180, 320]
        assert np.abs(pixel - np.minimum(np.array((60.0, 100.0, 200.0)) * gain, 255.0)).max() <= 0.5


def test_vignette_and_warm_light():
    bright = (0.0, 0.0, 200.0)
    room = replace(walls_in(bright), net=bright)
    at_wall = pose((3.0, 0.0, 4.5))  # outside the net, before a bare wall
    picture = renderer(scene=in_room(room), imaging=replace(PERFECT, vignette=0.3)).render(at_wall)
    assert picture[180, 320, 0] == 200 and picture[0, 0, 0] == pytest.approx(140, abs=1)
    warm = renderer(scene=in_room(room), imaging=replace(PERFECT, temperature_k=4500.0)).render(at_wall)
    blue, green, red = warm[180, 320].tolist()
    assert blue < 180 and green == 200 and red > 215
    assert np.allclose(light_colour(6500.0), 1.0)


def test_noise_has_the_given_deviation_and_no_mean():
    room = walls_in((0.0, 0.0, 100.0))
    imaging = replace(PERFECT, read_noise=2.0, shot_noise=0.3)
    drawn = renderer(scene=in_room(room), imaging=imaging)
    pictures = np.array([drawn.render(pose((3.0, 0.0, 4.5))).astype(float) for _ in range(4)])
    # 2.8 million values: the error of mean and deviation is 0.002; rounding adds 1/12 of variance
    assert pictures.mean() == pytest.approx(100.0, abs=0.05)
    assert pictures.std() == pytest.approx(math.sqrt(4.0 + 0.09 * 100.0 + 1.0 / 12.0), rel=0.01)
    assert np.abs(pictures[0] - pictures[1]).mean() > 2.0  # the noise differs between pictures


def test_same_seed_same_pictures():
    style = load_style()
    vehicle = VehiclePose("v", np.array((2.0, 0.3, 1.4)), rotation_body_to_cortex(0.1, 0.1, 1.0))
    scene = Scene(style, discs=(style.disc("Pink_blue", (2.3, -0.4, 1.5), (-1.0, 0.0, 0.0)),))

    def film(seed):
        drawn = LabelledRenderer(PINHOLE, scene, seed)
        return [drawn.render(pose(rate=(0.1, 0.2, 0.1 * k)), (vehicle,)) for k in range(3)]

    first, second, other = film(5), film(5), film(6)
    assert all(np.array_equal(a, b) for a, b in zip(first, second))
    assert not np.array_equal(first[0], other[0])


def test_pictures_are_new_arrays_of_the_right_kind():
    drawn = renderer(scene=Scene(load_style()))
    first = drawn.render(pose())
    kept = first.copy()
    assert first.shape == (360, 640, 3) and first.dtype == np.uint8 and first.flags.c_contiguous
    drawn.render(pose(yaw=1.0), gain=0.5)
    assert np.array_equal(first, kept)


def test_any_pose_gives_a_picture(inputs):
    """In walls, in discs, upside down, face to face with a vehicle, spinning: nothing raises, nothing is NaN."""
    style = load_style()
    rng = np.random.default_rng(3)
    centres = [(2.3, 0.8, 1.0), (0.1, 0.0, 1.0)]
    scene = Scene(style, discs=tuple(style.disc("Orange_blue", centre, (-1.0, 0.0, 0.0)) for centre in centres))
    drawn = [
        renderer(camera_of(name), scene, replace(style.imaging, rolling_s=0.01)) for name in ("fluffy_II", "Raven")
    ]
    for k in range(inputs(20, 40)):
        vehicles = [
            VehiclePose(
                "v%d" % n, rng.uniform(-0.4, 0.4, 3) + (0.0, 0.0, 1.0), rotation_body_to_cortex(*rng.uniform(-3, 3, 3))
            )
            for n in range(2)
        ]
        board = Board(8, 6, 0.025, tuple(rng.uniform(-0.3, 0.3, 3) + (0.0, 0.0, 1.0)), np.eye(3))
        camera_pose = pose(
            rng.uniform((-5.0, -5.0, -0.5), (5.0, 5.0, 4.5)) if k % 2 else rng.uniform(-0.3, 0.3, 3) + (0.0, 0.0, 1.0),
            *rng.uniform(-3.0, 3.0, 3),
            velocity=rng.normal(0.0, 2.0, 3),
            rate=rng.normal(0.0, 4.0, 3),
        )
        picture = drawn[k % 2].render(camera_pose, vehicles, (board,), 1.0)
        assert picture.shape == (360, 640, 3)
        for truth in drawn[k % 2].truth(camera_pose, vehicles, (board,)):
            numbers = [*truth.centre_px, *truth.box_px, truth.diameter_px, truth.seen_fraction, truth.distance_m]
            assert np.isfinite(numbers).all() and 0.0 <= truth.seen_fraction <= 1.0


def test_a_bottom_camera_sees_the_floor():
    scene = Scene(load_style())
    down = pose((0.0, 0.0, 1.0), pitch=-0.5 * math.pi)
    picture = renderer(scene=scene).render(down)
    hsv = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)[180, 320].astype(int)
    assert abs(hsv[0] - 25) <= 2 and hsv[1] > 120  # the tape that marks the middle of the arena
