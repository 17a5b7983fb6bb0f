"""Discs in pictures: found where they are, named by both paints, and nothing else taken for one."""

import copy

import cv2
import numpy as np
import pytest
import yaml
from disc_pictures import KINDS, PAINTS, camera, exposed, paint_disc, wall

from risc_lab.lab.landmark_catalogue import landmarks_file
from risc_lab.lab.yaml_reader import package_file
from risc_visual.vision.landmark_config import landmarks_from_dict, load_landmarks
from risc_visual.vision.landmark_detector import LandmarkDetector

CONFIG = load_landmarks()


def content():
    """Content of a file with everything: the detector's settings and its own landmarks."""
    files = package_file("risc_visual", "config/landmark_detector.yaml"), landmarks_file()
    return {key: value for file in files for key, value in yaml.safe_load(file.read_text(encoding="utf-8")).items()}


def find(picture, eye=None, config=CONFIG):
    return LandmarkDetector(config, eye).detect(picture)


def one(picture, name, eye=None):
    """The only detection, which has this name."""
    found = find(picture, eye)
    assert [d.name for d in found] == [name]
    return found[0]


@pytest.mark.parametrize("name", sorted(KINDS))
@pytest.mark.parametrize("gain", [0.3, 1.0, 2.0])
def test_every_landmark_in_dim_and_glaring_light(name, gain):
    eye, picture = camera(), wall()
    truth = paint_disc(picture, eye, name, (300.3, 170.6), 2.0, 30.0, 20.0)
    found = one(exposed(picture, gain), name, eye)
    assert np.hypot(*(truth - (found.x, found.y))) < 0.25
    assert not found.partial
    assert sorted((found.width, found.height)) == pytest.approx([60.0 * np.cos(np.radians(30.0)), 60.0], abs=1.5)


FIRST = ((0.0, 0.0), (45.0, 90.0), (70.0, 200.0))  # tilts and directions; the others with --all
TURNS = [
    pytest.param(tilt_deg, towards_deg, marks=() if (tilt_deg, towards_deg) in FIRST else pytest.mark.release)
    for tilt_deg in (0.0, 45.0, 70.0)
    for towards_deg in (0.0, 90.0, 200.0)
]


@pytest.mark.parametrize(("tilt_deg", "towards_deg"), TURNS)
def test_the_centre_of_a_tilted_disc_is_not_the_middle_of_its_outline(tilt_deg, towards_deg):
    eye, picture = camera(), wall()
    truth = paint_disc(picture, eye, "green", (350.0, 150.0), 0.8, tilt_deg, towards_deg)
    picture = exposed(picture)
    known, guessed = one(picture, "green", eye), one(picture, "green")
    assert np.hypot(*(truth - (known.x, known.y))) < 0.3
    assert np.hypot(*(truth - (guessed.x, guessed.y))) < 0.6
    middle = np.hypot(*(truth - (known.outline.x, known.outline.y)))
    assert middle > 2.0 if tilt_deg else middle < 1.0


def test_sub_pixel_places_are_told_apart():
    eye = camera()
    places = np.arange(0.0, 1.01, 0.2)
    seen = []
    for k, place in enumerate(places):
        picture = wall()
        paint_disc(picture, eye, "blue", (200.0 + place, 200.0), 2.5)
        seen.append(one(exposed(picture, seed=k), "blue", eye).x - 200.0)
    assert seen == pytest.approx(places, abs=0.1)


def test_a_raw_picture_needs_its_camera():
    eye, picture = camera(distortion=(-0.63, 0.39, -0.002, 0.001, 0.0)), wall()
    truth = paint_disc(picture, eye, "pink", (90.0, 70.0), 1.0, 40.0, 60.0)
    found = one(exposed(picture), "pink", eye)
    assert np.hypot(*(truth - (found.x, found.y))) < 0.3


@pytest.mark.parametrize("pixel", [(4.0, 180.0), (635.0, 180.0), (320.0, 3.0), (320.0, 356.0)])
def test_what_the_border_cuts_is_partial(pixel):
    eye, picture = camera(), wall()
    truth = paint_disc(picture, eye, "Orange", pixel, 1.6)
    found = one(exposed(picture), "Orange", eye)
    assert found.partial
    assert np.hypot(*(truth - (found.x, found.y))) < 2.0


def test_what_something_hides_is_partial():
    eye, picture = camera(), wall()
    truth = paint_disc(picture, eye, "green", (320.0, 180.0), 1.5)
    picture[:, 345:420] = 40.0
    found = one(exposed(picture), "green", eye)
    assert found.partial
    assert np.hypot(*(truth - (found.x, found.y))) < 1.5


@pytest.mark.parametrize("count", range(5))
def test_several_at_once(count):
    eye, picture = camera(), wall()
    names = sorted(KINDS)[:count]
    for k, name in enumerate(names):
        paint_disc(picture, eye, name, (80.0 + 150.0 * k, 120.0 + 40.0 * k), 1.5 + 0.5 * k, 15.0 * k, 70.0 * k)
    assert sorted(d.name for d in find(exposed(picture), eye)) == names


def test_the_smallest_that_is_promised():
    eye, picture = camera(), wall()
    paint_disc(picture, eye, "pink", (400.0, 100.0), 600.0 * 0.2 / 14.0)
    found = one(exposed(picture), "pink", eye)
    assert min(found.width, found.height) == pytest.approx(14.0, abs=1.0)


def test_hue_wraps_through_red():
    wanted = content()
    wanted["colours"]["pink"]["hue"] = [160, 5]
    config = landmarks_from_dict(wanted)
    eye = camera()
    for hue in (165, 178, 2):
        PAINTS["reddish"] = cv2.cvtColor(np.uint8([[(hue, 170, 190)]]), cv2.COLOR_HSV2BGR)[0, 0].astype(float)
        picture = wall()
        paint_disc(picture, eye, "pink", (320.0, 180.0), 2.0, kinds={"pink": ("reddish", "blue")})
        picture = exposed(picture)
        assert [d.name for d in find(picture, eye, config)] == ["pink"], hue
    assert find(picture, eye) == []  # hue 2 is outside the range of the file


@pytest.mark.parametrize("centre, ring", [(a, b) for a in PAINTS for b in PAINTS if a != b and len(a + b) < 12])
def test_other_pairs_are_no_landmarks(centre, ring):
    if (centre, ring) in KINDS.values():
        return
    eye, picture = camera(), wall()
    paint_disc(picture, eye, "x", (320.0, 180.0), 1.5, 20.0, kinds={"x": (centre, ring)})
    assert find(exposed(picture), eye) == []


def test_lookalikes_are_no_landmarks():
    paints = {name: tuple(bgr) for name, bgr in PAINTS.items()}
    picture = wall()
    picture[0:180, 0:320] = paints["pink"]
    cv2.circle(picture, (150, 90), 40, paints["green"], cv2.FILLED, cv2.LINE_AA)  # a disc before a wall
    cv2.rectangle(picture, (350, 20), (470, 140), paints["blue"], cv2.FILLED)  # squares in each other
    cv2.rectangle(picture, (370, 40), (450, 120), paints["pink"], cv2.FILLED)
    cv2.circle(picture, (550, 90), 40, paints["orange"], cv2.FILLED, cv2.LINE_AA)  # a ball
    cv2.circle(picture, (100, 270), 60, paints["green"], 20, cv2.LINE_AA)  # a ring around nothing
    cv2.ellipse(picture, (300, 270), (60, 60), 0, 0, 180, paints["green"], cv2.FILLED, cv2.LINE_AA)  # half a disc
    cv2.ellipse(picture, (300, 270), (40, 40), 0, 0, 180, paints["blue"], cv2.FILLED, cv2.LINE_AA)
    cv2.rectangle(picture, (450, 200), (600, 330), paints["green"], cv2.FILLED)  # a bar before a wall
    cv2.rectangle(picture, (480, 250), (570, 280), paints["blue"], cv2.FILLED)
    assert find(exposed(picture)) == []


def test_before_a_wall_of_the_colour_of_its_centre():
    eye, picture = camera(), wall()
    picture[:] = PAINTS["green"]
    paint_disc(picture, eye, "green", (320.0, 180.0), 2.0, 30.0)
    one(exposed(picture), "green", eye)


@pytest.mark.parametrize(
    "shape", [(1, 1, 3), (4, 640, 3), (9, 11, 3), (360, 640, 3), (361, 639, 3), (360, 640), (20, 20, 1)]
)
def test_nothing_is_found_in_nothing(shape):
    rng = np.random.default_rng(3)
    assert find(np.zeros(shape, np.uint8)) == []
    assert find(np.full(shape, 255, np.uint8)) == []
    if len(shape) == 2 or shape[2] == 1:
        assert find(rng.integers(0, 256, shape, dtype=np.uint8)) == []


def test_noise_is_no_landmark():
    noise = np.random.default_rng(4).integers(0, 256, (360, 640, 3), dtype=np.uint8)
    assert find(noise) == []
    assert find(cv2.GaussianBlur(noise, (0, 0), 5.0)) == []


def test_a_filled_picture_of_one_paint():
    for bgr in PAINTS.values():
        assert find(np.full((360, 640, 3), bgr, np.uint8)) == []


@pytest.mark.parametrize("image", [np.zeros((5, 5, 3)), np.zeros((5, 5, 2), np.uint8), np.zeros(5, np.uint8), None])
def test_what_is_no_picture_is_refused(image):
    with pytest.raises(ValueError, match="uint8 of shape"):
        find(image)


def test_transparency_and_views_do_not_matter():
    eye, picture = camera(), wall()
    paint_disc(picture, eye, "green", (320.0, 180.0), 2.0)
    picture = exposed(picture)
    wanted = one(picture, "green", eye)
    with_alpha = np.dstack((picture, np.full(picture.shape[:2], 9, np.uint8)))
    turned = np.asfortranarray(picture)
    before = picture.copy()
    assert find(with_alpha, eye) == find(turned, eye) == [wanted]
    assert (picture == before).all(), "the picture was drawn on"


def test_the_order_of_the_file_changes_nothing():
    eye, picture = camera(), wall()
    for k, name in enumerate(sorted(KINDS)):
        paint_disc(picture, eye, name, (80.0 + 150.0 * k, 180.0), 2.0)
    picture = exposed(picture)
    turned = content()
    turned["landmarks"].reverse()
    turned["colours"] = dict(reversed(list(turned["colours"].items())))
    assert sorted(find(picture, eye, landmarks_from_dict(turned))) == sorted(find(picture, eye))


def test_any_size_of_picture():
    for size, focal in (((320, 180), 300.0), ((1280, 720), 1200.0), ((641, 363), 600.0)):
        eye, picture = camera(size, focal), wall(size)
        truth = paint_disc(picture, eye, "blue", (0.41 * size[0], 0.53 * size[1]), 1.7, 35.0, 40.0)
        found = one(exposed(picture), "blue", eye)
        assert np.hypot(*(truth - (found.x, found.y))) < 0.4


def test_the_picture_need_not_be_shrunk():
    wanted = content()
    wanted["detector"] = {"shrink": 1}
    eye, picture = camera(), wall()
    truth = paint_disc(picture, eye, "blue", (250.0, 140.0), 3.0, 35.0, 40.0)
    (found,) = find(exposed(picture), eye, landmarks_from_dict(wanted))
    assert np.hypot(*(truth - (found.x, found.y))) < 0.3


def spoilt(change):
    wrong = copy.deepcopy(content())
    wrong["detector"] = {}
    change(wrong)
    return wrong


@pytest.mark.parametrize(
    "change, told",
    [
        (lambda c: c["colours"]["green"].update(hue=[50, 200]), "green.*hue"),
        (lambda c: c["colours"]["green"].update(hue=[50.5, 60]), "green.*hue"),
        (lambda c: c["colours"]["green"].update(hue="red"), "green.*hue"),
        (lambda c: c["colours"]["blue"].update(value=[200, 100]), "blue.*'value'.*swap"),
        (lambda c: c["colours"]["blue"].update(vlaue=[0, 1]), "unknown key.*vlaue"),
        (lambda c: c["colours"].pop("orange"), "Orange_blue.*'orange'"),
        (lambda c: c["landmarks"].clear(), "'landmarks' is empty"),
        (lambda c: c["landmarks"][0].update(ring="green"), "Green_pink.*same colour"),
        (lambda c: c["landmarks"][0].update(roi_name="blue"), "same roi_name: blue"),
        (lambda c: c["landmarks"][0].pop("name"), "name' is missing"),
        (lambda c: c["discs"].update(ring_diameter_m=0.1), "'ring_diameter_m'"),
        (lambda c: c["detector"].update(shrink=1.5), "shrink'"),
        (lambda c: c["detector"].update(ring_min=2), "ring_min'"),
        (lambda c: c["detector"].update(diameter_min_px=1), "diameter_min_px'"),
        (lambda c: c.update(detectors={}), "unknown key.*detectors"),
    ],
)
def test_a_wrong_file_is_one_error_that_names_the_key(change, told):
    with pytest.raises(ValueError, match="here.yaml.*" + told):
        landmarks_from_dict(spoilt(change), "here.yaml")
