"""Colours of landmarks follow the paint of their middle."""

import pytest

from risc_lab.lab.landmark_catalogue import LandmarkKind
from risc_visual.drawing.palette import ray_colours, sphere_colours
from risc_visual.vision.colours import HsvRange
from risc_visual.vision.landmark_config import LandmarksConfig, load_landmarks


def test_spheres_of_the_laboratory_have_the_colours_of_the_original():
    assert sphere_colours(load_landmarks()) == {
        "Orange_blue": (1.0, 0.6, 0.0),
        "Green_pink": (0.0, 1.0, 0.0),
        "Blue_green": (0.0, 0.0, 1.0),
        "Pink_blue": (1.0, 0.0, 0.5),
    }


def test_both_names_of_a_landmark_have_its_colour():
    colours = ray_colours(load_landmarks())
    assert colours["Orange"] == colours["Orange_blue"] == (1.0, 0.27, 0.0)
    assert len(colours) == 8


@pytest.mark.parametrize(
    "hue, rgb",
    [((28, 32), (1, 1, 0)), ((118, 122), (0, 0, 1)), ((175, 5), (1, 0, 0)), ((145, 155), (1, 0, 1))],
)
def test_a_new_paint_has_the_colour_of_its_hue(hue, rgb):
    kinds = (LandmarkKind("New_blue", "new", "new", "blue"),)
    config = LandmarksConfig(kinds, colours={"new": HsvRange(hue), "blue": HsvRange((82, 116))})
    assert sphere_colours(config)["New_blue"] == pytest.approx(rgb)
    assert ray_colours(config)["new"] == pytest.approx(rgb)
