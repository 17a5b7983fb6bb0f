"""Vehicles by their hulls: told apart by both paints, by one only when that is enough."""

import cv2
import numpy as np
import pytest
import yaml

from risc_lab.lab.yaml_reader import package_file
from risc_lab.settings import settings_from
from risc_visual.vision.vehicle_detector import VehicleDetector, VehiclesConfig, load_vehicles

CONFIG = load_vehicles()
NAMES = ("risc1", "risc2", "risc3", "risc4")  # red_yellow, violet_lime, lime_red, yellow_violet
HSV = {"red": (179, 235, 175), "yellow": (28, 225, 215), "lime": (44, 200, 180), "violet": (132, 170, 160)}
PAINTS = {name: cv2.cvtColor(np.uint8([[hsv]]), cv2.COLOR_HSV2BGR)[0, 0].tolist() for name, hsv in HSV.items()}


def content():
    return yaml.safe_load(package_file("risc_visual", "config/vehicles.yaml").read_text(encoding="utf-8"))


def wall():
    return np.full((360, 640, 3), 120, np.uint8)


def hull(picture, x, y, left, right, size=40):
    """A hull from the side: two shrouds and the body between; its middle is (x, y)."""
    for paint, side in ((left, -1), (right, 1)):
        middle = x + side * size
        cv2.rectangle(
            picture, (middle - size + 3, y - size // 3), (middle + size - 3, y + size // 3), PAINTS[paint], -1
        )
    cv2.rectangle(picture, (x - 3, y - size // 4), (x + 3, y + size // 4), (45, 45, 45), -1)


def find(picture, observer=None, names=NAMES):
    return {found.name: found for found in VehicleDetector(CONFIG, names).detect(picture, observer)}


@pytest.mark.parametrize("gain", [0.4, 1.0, 1.8])
def test_every_hull_from_either_side(gain):
    rng = np.random.default_rng(1)
    for name, shape in zip(NAMES, CONFIG.hulls):
        for left, right in ((shape.nose, shape.tail), (shape.tail, shape.nose)):
            picture = wall()
            hull(picture, 300, 150, left, right)
            picture = np.clip(gain * picture + rng.normal(0.0, 2.0, picture.shape), 0, 255).astype(np.uint8)
            found = find(picture)
            assert list(found) == [name]
            assert (found[name].x, found[name].y) == pytest.approx((300.0, 150.0), abs=2.0)
            assert sorted((found[name].width, found[name].height)) == pytest.approx([27.0, 155.0], abs=4.0)
            assert not found[name].partial


def test_several_at_once_and_a_cut_one():
    picture = wall()
    hull(picture, 120, 80, "red", "yellow")
    hull(picture, 400, 90, "violet", "lime")
    hull(picture, 620, 280, "lime", "red")
    found = find(picture)
    assert sorted(found) == ["risc1", "risc2", "risc3"]
    assert [name for name in found if found[name].partial] == ["risc3"]


def test_one_paint_is_enough_when_only_one_vehicle_has_it():
    picture = wall()
    hull(picture, 300, 150, "red", "red")
    assert find(picture) == {}  # nose of risc1, or tail of risc3?
    assert list(find(picture, observer="risc1")) == ["risc3"]
    assert list(find(picture, names=NAMES[:2])) == ["risc1"]
    hull(picture, 300, 300, "red", "yellow")
    assert sorted(find(picture)) == ["risc1", "risc3"]


def test_nobody_sees_itself():
    picture = wall()
    hull(picture, 300, 150, "violet", "lime")
    assert list(find(picture)) == ["risc2"]
    assert find(picture, observer="risc2", names=NAMES[:2]) == {}


def test_other_things_are_no_vehicles():
    picture = wall()
    cv2.rectangle(picture, (20, 20), (80, 200), PAINTS["red"], -1)  # higher than wide
    cv2.circle(picture, (300, 100), 4, PAINTS["violet"], -1)  # too small
    for k, hsv in enumerate(((15, 160, 230), (66, 150, 170), (98, 150, 170), (167, 150, 200), (174, 140, 165))):
        bgr = cv2.cvtColor(np.uint8([[hsv]]), cv2.COLOR_HSV2BGR)[0, 0].tolist()
        cv2.rectangle(picture, (100 * k + 20, 250), (100 * k + 110, 290), bgr, -1)  # paints of landmarks, a poster
    assert find(picture, observer="risc1") == {}
    assert find(np.zeros((360, 640, 3), np.uint8)) == find(np.zeros((4, 4, 3), np.uint8)) == {}
    assert find(np.zeros((360, 640), np.uint8)) == {}


def test_what_is_no_picture_is_refused():
    with pytest.raises(ValueError, match="uint8 of shape"):
        find(np.zeros((360, 640, 3)))


def test_more_vehicles_than_hulls():
    with pytest.raises(ValueError, match="5 vehicles, but only 4 hulls"):
        VehicleDetector(CONFIG, NAMES + ("risc5",))


@pytest.mark.parametrize(
    "change, told",
    [
        (lambda c: c["colours"]["red"].update(hue=[170]), "red.*hue"),
        (lambda c: c["colours"].pop("lime"), "violet_lime.*'lime'"),
        (lambda c: c["hulls"][0].pop("tail"), "tail' is missing"),
        (lambda c: c["hulls"][2].update(nose="yellow"), "red_yellow.*same two colours"),
        (lambda c: c["hulls"].clear(), "'hulls' is empty"),
        (lambda c: c["detector"].update(gap=-1), "gap'"),
        (lambda c: c["detector"].update(gaps=1), "unknown key.*gaps"),
    ],
)
def test_a_wrong_file_is_one_error_that_names_the_key(change, told):
    wrong = dict(content(), detector={})
    change(wrong)
    with pytest.raises(ValueError, match="here.yaml.*" + told):
        settings_from(VehiclesConfig, wrong, "here.yaml")
