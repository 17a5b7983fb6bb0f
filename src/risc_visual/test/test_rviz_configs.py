"""The rviz configurations: what holds for each. Their topics: test_marker_scene.py; views: test_screenshot.py."""

import pathlib

import pytest
import yaml

CONFIG = pathlib.Path(__file__).resolve().parents[1] / "config"
FILES = sorted(path.name for path in CONFIG.glob("*.rviz"))


def manager(name):
    return yaml.safe_load((CONFIG / name).read_text(encoding="utf-8"))["Visualization Manager"]


@pytest.mark.parametrize("name", FILES)
def test_displays_are_told_apart_by_name_and_their_check_boxes_say_what_they_do(name):
    """rviz keeps a display by its name, and whether it is on in two places."""
    displays = manager(name)["Displays"]
    names = [display["Name"] for display in displays]
    assert names and len(set(names)) == len(names)
    assert all(display["Enabled"] is display["Value"] for display in displays)


@pytest.mark.parametrize("name", FILES)
def test_everything_is_in_the_frame_of_motion_capture_and_goes_stale(name):
    """An Axes display would stay where the frame was last; a TF display fades and vanishes."""
    content = manager(name)
    assert content["Global Options"]["Fixed Frame"] == "cortex"
    for display in content["Displays"]:
        if display["Class"] == "rviz/Axes":
            assert display["Reference Frame"] == "cortex"
        if display["Class"] == "rviz/TF":
            assert 0 < display["Frame Timeout"] <= 1
