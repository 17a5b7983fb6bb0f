"""Tuning of a paint's thresholds, and saving them in the landmarks file."""

import cv2
import numpy as np
import pytest

from risc_lab.lab.yaml_reader import package_file
from risc_visual.vision.colours import HsvRange
from risc_visual.vision.landmark_config import load_landmarks
from risc_visual.vision.mask_tuning import MaskSettings, draw_mask, make_mask, save_colour

OTHERS = "  blue: {hue: [82, 116]}\n  pink: {hue: [140, 179]}\n  orange: {hue: [5, 36]}\n"
PAINT = HsvRange((170, 5), (80, 255), (40, 250))


def picture_of(*hues):
    """Columns of 40 px, one a hue."""
    hsv = np.zeros((60, 40 * len(hues), 3), np.uint8)
    for k, hue in enumerate(hues):
        hsv[:, 40 * k : 40 * k + 40] = (hue, 150, 170)
    return cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)


def settings(**changes):
    return MaskSettings(**dict({"kernel": 0, "blur": 0}, **changes))


def columns(mask):
    return [bool(mask[:, k : k + 40].all()) for k in range(0, mask.shape[1], 40)]


def test_thresholds():
    picture = picture_of(50, 60, 75, 90)
    assert columns(make_mask(picture, settings())) == [False, True, True, False]
    assert columns(make_mask(picture, settings(value_low=171))) == [False] * 4
    assert columns(make_mask(picture, settings(saturation_high=140))) == [False] * 4
    assert columns(make_mask(picture, settings(hue_low=85, hue_high=55))) == [True, False, False, True]  # wraps
    assert columns(make_mask(picture, settings(hue_low=0, hue_high=180))) == [True] * 4


def test_kernel_closes_holes_and_blur_softens():
    picture = picture_of(60, 120)
    picture[30, 20] = 0
    assert make_mask(picture, settings())[30, 20] == 0
    assert make_mask(picture, settings(kernel=1))[30, 20] == 255
    soft = make_mask(picture, settings(blur=3))
    assert 0 < soft[10, 41] < 255
    assert soft.shape == picture.shape[:2]


def test_what_is_outside_is_drawn_grey():
    picture = picture_of(60, 120)
    drawn = draw_mask(picture, make_mask(picture, settings()))
    assert (drawn[20:40, 10:30] == picture[20:40, 10:30]).all()
    assert np.ptp(drawn[20:40, 50:70], axis=2).max() == 0


@pytest.mark.parametrize(
    "wrong", [{"kernel": 21}, {"blur": -1}, {"hue_low": -1}, {"value_low": 200, "value_high": 100}]
)
def test_wrong_settings_are_named(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong)).split("_")[0]):
        settings(**wrong)


def test_a_new_file_is_the_package_s_with_the_colour(tmp_path):
    path = tmp_path / "my.yaml"
    assert save_colour(path, "pink", PAINT) == path
    shipped, saved = load_landmarks(), load_landmarks(path)
    assert saved.colours.pop("pink") == PAINT
    shipped.colours.pop("pink")
    assert saved == shipped
    before = package_file("risc_visual", "config/landmark_detector.yaml").read_text(encoding="utf-8").splitlines()
    after = path.read_text(encoding="utf-8").splitlines()
    assert sum(a != b for a, b in zip(before, after)) == 1
    assert len(before) == len(after)


def test_a_relative_path_is_told_in_full(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert save_colour("my.yaml", "pink", PAINT) == tmp_path / "my.yaml"
    assert load_landmarks(tmp_path / "my.yaml").colours["pink"] == PAINT


def test_a_colour_is_added_and_changed_and_the_rest_stays(tmp_path):
    path = tmp_path / "my.yaml"
    save_colour(path, "red", PAINT)
    save_colour(path, "red", HsvRange((1, 9)))
    save_colour(path, "green", PAINT)
    saved = load_landmarks(path)
    assert saved.colours["red"] == HsvRange((1, 9))
    assert saved.colours["green"] == PAINT
    assert path.read_text(encoding="utf-8").count("red:") == 1
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    "file, name, told",
    [
        ("", "red", "~file"),
        ("my.yaml", "bad name", "bad name"),
        ("gone/my.yaml", "red", "gone/my.yaml"),
        ("list.yaml", "red", "list.yaml"),
    ],
)
def test_what_cannot_be_saved_is_told_and_changes_nothing(tmp_path, file, name, told):
    (tmp_path / "list.yaml").write_text("[1, 2]\n")
    before = {path: path.read_text() for path in tmp_path.iterdir()}
    with pytest.raises(ValueError, match=told):
        save_colour(tmp_path / file if file else "", name, PAINT)
    assert {path: path.read_text() for path in tmp_path.iterdir()} == before


def test_a_file_in_block_style_with_comments_is_saved_into(tmp_path):
    path = tmp_path / "my.yaml"
    path.write_text("colours:  # mine\n  green:\n    hue:\n    - 50\n    - 70\n" + OTHERS)
    save_colour(path, "green", PAINT)
    assert load_landmarks(path).colours["green"] == PAINT
    assert "# mine" in path.read_text() and "pink: {hue: [140, 179]}" in path.read_text()
    path.write_text(path.read_text() + "colours: {}\n")
    with pytest.raises(ValueError, match="my.yaml"):
        save_colour(path, "green", PAINT)
