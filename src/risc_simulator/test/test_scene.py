"""The scene file, and the shapes made from it."""

import copy
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml

from risc_lab.lab import Arena, load_fleet
from risc_lab.lab.yaml_reader import load_yaml, package_file
from risc_lab.settings import settings_from
from risc_simulator.video.scene import (
    Board,
    Disc,
    Scene,
    Style,
    VehiclePose,
    load_scene,
    load_style,
    normal_of_facing,
    plane_axes,
    room_layers,
)

PAINTS_HSV = {"green": (66, 150, 170), "blue": (98, 150, 170), "pink": (167, 150, 200), "orange": (15, 160, 230)}
LANDMARKS = {
    "Green_pink": ("green", "pink"),
    "Pink_blue": ("pink", "blue"),
    "Orange_blue": ("orange", "blue"),
    "Blue_green": ("blue", "green"),
}


@pytest.fixture(scope="module")
def content():
    return load_yaml(package_file("risc_simulator", "config/scene.yaml"))


def hsv_of(bgr):
    return cv2.cvtColor(np.uint8([[bgr]]), cv2.COLOR_BGR2HSV)[0, 0].astype(int)


def test_landmarks_have_the_paints_of_the_laboratory():
    style = load_style()
    for template, names in LANDMARKS.items():
        disc = style.disc(template, (0, 0, 1), (1, 0, 0))
        for bgr, name in zip((disc.centre_bgr, disc.ring_bgr), names):
            assert np.abs(hsv_of(bgr) - PAINTS_HSV[name]).max() <= 1  # 8-bit rounding
        assert (disc.centre_diameter_m, disc.ring_diameter_m) == (0.20, 0.30)


def test_hulls_differ_from_each_other_and_in_front_from_behind():
    hulls = load_style().hulls.colours.values()
    assert len(hulls) >= 4
    pairs = {frozenset((hull.nose, hull.tail)) for hull in hulls}
    assert len(pairs) == len(hulls) and all(len(pair) == 2 for pair in pairs)


@pytest.mark.parametrize(
    "path, value, message",
    [
        ("paints.green", [300, 0, 0], r"'paints.green\[0\]' .* < 180"),
        ("paints.green", [1, 2], "'paints.green' .*length 3"),
        ("disc_backs", None, "'disc_backs' .*missing"),
        ("hulls.colours", {}, "hull"),
        ("hulls.colours.red_yellow.wing", [0, 0, 0], " wing; "),
        ("room.tile_m", None, "'room.tile_m' .*missing"),
        ("room.marks", 2.5, "'room.marks' .*whole number"),
        ("room.walls.front", None, "'room.walls.front' .*missing"),
        ("room.panels.0.surface", "roof", r"'room.panels\[0\].surface' .* front, back, left, right, floor"),
        ("room.panels.0.size_m", [0.0, 1.0], r"'room.panels\[0\].size_m\[0\]' .* > 0"),
        ("imaging.exposure_s", -1.0, "'imaging.exposure_s' .* >= 0"),
        ("imaging.shutter", 1.0, " shutter; "),
        ("boards.margin_squares", True, "'boards.margin_squares' .*number"),
        ("lights", {}, " lights; "),
    ],
)
def test_every_mistake_in_the_file_is_named(content, path, value, message):
    broken = copy.deepcopy(content)
    keys = [int(key) if key.isdigit() else key for key in path.split(".")]
    place = broken
    for key in keys[:-1]:
        place = place[key]
    if value is None:
        del place[keys[-1]]
    else:
        place[keys[-1]] = value
    with pytest.raises(ValueError, match="file.yaml.*" + message):
        settings_from(Style, broken, "file.yaml")


def test_a_room_within_the_net_is_refused(content, tmp_path):
    file = tmp_path / "scene.yaml"
    file.write_text(yaml.safe_dump({**content, "room": {**content["room"], "half_x_m": 1.0}}))
    with pytest.raises(ValueError, match="scene.yaml: .*half_x_m 2.49"):
        load_style(file)


def test_missing_file_is_one_error(tmp_path):
    with pytest.raises(ValueError, match="none.yaml"):
        load_style(tmp_path / "none.yaml")


def test_facing_is_clockwise_from_above_as_yaw():
    assert np.allclose(normal_of_facing(0.0), (1.0, 0.0, 0.0))
    assert np.allclose(normal_of_facing(math.radians(90.0)), (0.0, -1.0, 0.0))


def test_plane_axes_are_right_and_up_for_somebody_in_front():
    across, upward = plane_axes((-1.0, 0.0, 0.0))  # for a viewer looking along +x: right is -y
    assert np.allclose(across, (0.0, -1.0, 0.0)) and np.allclose(upward, (0.0, 0.0, 1.0))
    across, upward = plane_axes((0.0, 0.0, 1.0))  # a disc on the floor
    assert np.allclose(np.cross(across, upward), (0.0, 0.0, 1.0))


def test_disc_outline_lies_in_its_plane_and_has_the_area_of_the_circle():
    normal = np.array([0.6, -0.64, 0.48])
    disc = Disc("d", (1.0, 2.0, 3.0), tuple(normal), (0, 0, 0), (1, 1, 1))
    relative = disc.outline(0.30) - (1.0, 2.0, 3.0)
    assert np.allclose(relative @ normal, 0.0, atol=1e-12)
    assert np.allclose(np.linalg.norm(relative, axis=1), 0.15, rtol=2e-3)
    area = 0.5 * np.linalg.norm(np.cross(relative, np.roll(relative, -1, axis=0)).sum(axis=0))
    assert area == pytest.approx(math.pi * 0.15**2, rel=1e-9)


def test_board_axes_are_opencvs():
    # an upright board, for a viewer looking along +x: its x is -y, its y is down, its z is +x
    R = np.array([(0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)])
    corners = Board(3, 2, 0.1, (5.0, 0.0, 1.0), R).to_cortex([(-1.0, -0.5), (0.0, -0.5), (-1.0, 0.5)])
    assert np.allclose(corners, [(5.0, 0.1, 1.05), (5.0, 0.0, 1.05), (5.0, 0.1, 0.95)])


def test_board_squares_meet_at_the_corners():
    board = Board(8, 6, 0.025, (0.0, 0.0, 0.0), np.eye(3))
    white, black = board.layers(Scene(load_style()), np.array([0.0, 0.0, -1.0]))
    assert len(black.outlines) == 32  # of 9 x 7 squares
    assert np.ptp(white.outlines[0], axis=0) == pytest.approx([0.025 * 11, 0.025 * 9, 0.0])
    points = np.concatenate(black.outlines)
    column, row = np.meshgrid(np.arange(8) - 3.5, np.arange(6) - 2.5)
    corners = np.stack((column.ravel(), row.ravel()), axis=1)
    for corner in board.to_cortex(corners):  # each inner corner is shared by two black squares
        assert (np.linalg.norm(points - corner, axis=1) < 1e-9).sum() == 2


def test_hull_by_order_and_by_number():
    scene = Scene(load_style(), colour_of_vehicle={"risc2": 1})
    hulls = scene.style.hulls.hulls

    def hull_of(vehicle, colour=None):
        return scene.hull(VehiclePose(vehicle, (0, 0, 0), np.eye(3), colour))

    assert hull_of("risc2") is hulls[1]
    assert hull_of("stranger") is hulls[0]
    assert hull_of("risc2", 2) is hulls[2]
    assert hull_of("risc2", len(hulls)) is hulls[0]


def test_a_landmark_or_paint_that_is_not_known_is_named(content):
    with pytest.raises(ValueError, match="Red_white"):
        load_style().disc("Red_white", (0, 0, 1), (1, 0, 0))
    paints = {name: hsv for name, hsv in content["paints"].items() if name != "pink"}
    with pytest.raises(ValueError, match="Green_pink: 'ring' .*'pink'"):
        settings_from(Style, dict(content, paints=paints)).disc("Green_pink", (0, 0, 1), (1, 0, 0))


def test_imaging_out_of_range_is_named():
    with pytest.raises(ValueError, match="'defocus_px' .* >= 0"):
        replace(load_style().imaging, defocus_px=-1.0)


def test_room_encloses_the_net():
    layers = room_layers(load_style().room, Arena())
    points = np.concatenate([outline for layer in layers if not layer.are_lines for outline in layer.outlines])
    (ends,) = [np.array(layer.outlines) for layer in layers if layer.are_lines]
    low, high = points.min(axis=0), points.max(axis=0)
    cords = ends.reshape(-1, 3)
    assert (cords >= low).all() and (cords <= high).all()
    assert np.linalg.norm(np.diff(ends, axis=1), axis=2).max() <= 0.5 + 1e-9


def test_the_room_goes_with_the_net_around_it():
    fleet = load_fleet(package_file("risc_simulator", "test/two_ardrones.yaml"))
    assert load_scene(replace(fleet, arena=Arena(0.5, 0.5))).style.room.half_x_m > 0.5
    room, larger = (load_scene(f).style.room for f in (fleet, replace(fleet, arena=Arena(6.0, 5.0))))
    assert room == load_style().room
    assert larger.half_x_m - 6.0 == pytest.approx(room.half_x_m - Arena().half_x_m)
    (cords,) = [np.concatenate(x.outlines) for x in room_layers(larger, Arena(6.0, 5.0)) if x.are_lines]
    assert np.abs(cords).max(axis=0)[:2] == pytest.approx([6.0, 5.0])


def test_scene_of_a_fleet():
    fleet = load_fleet(package_file("risc_simulator", "test/two_ardrones.yaml"))
    scene = load_scene(fleet)
    assert [disc.name for disc in scene.discs] == [landmark.name for landmark in fleet.landmarks]
    for disc, landmark in zip(scene.discs, fleet.landmarks):
        assert disc.centre_m == landmark.position_m
        assert disc.normal == normal_of_facing(landmark.facing_rad)
    first, second = (scene.hull(VehiclePose(v.namespace, (0, 0, 0), np.eye(3))) for v in fleet.vehicles[:2])
    assert first is not second
