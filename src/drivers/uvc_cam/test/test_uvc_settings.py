"""Parameters: the table's defaults, errors that name the parameter, and what a change requires of the camera."""

import dataclasses

import pytest

from risc_lab.settings import settings_from
from uvc_cam.settings import CONTROLS, CameraSettings, changed_controls, needs_reopening


def test_defaults_are_those_of_the_original():
    assert dataclasses.asdict(CameraSettings()) == {
        "device": "/dev/video0",
        "camera_name": "camera",
        "format_mode": 1,
        "width": 640,
        "height": 480,
        "frame_rate": 15.0,
        "frame_id": "camera",
        "camera_info_url": "",
        "loop": True,
        "absolute_exposure": 2089,
        "exposure": 1,
        "sharpness": 142,
        "power_line_frequency": 0,
        "white_balance_temperature": True,
        "gain": 82,
        "saturation": 50,
        "contrast": 50,
        "brightness": 66,
    }


def test_values_of_launch_files_are_taken():
    settings = settings_from(CameraSettings, {"width": 320.0, "frame_rate": 20}, lenient=True)
    assert (settings.width, settings.frame_rate) == (320, 20.0)
    assert isinstance(settings.width, int) and isinstance(settings.frame_rate, float)


@pytest.mark.parametrize(
    "wrong",
    [
        {"device": ""},
        {"device": True},
        {"camera_name": "my camera"},
        {"format_mode": 4},
        {"width": 0},
        {"height": "tall"},
        {"width": 320.5},
        {"height": float("inf")},
        {"frame_rate": 1.0},
        {"frame_rate": float("nan")},
        {"loop": "yes"},
        {"gain": False},
    ],
)
def test_a_wrong_value_is_named(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        settings_from(CameraSettings, wrong)


@pytest.mark.parametrize(
    "wrong, cure",
    [
        ({"camera_name": "my camera"}, "letters, digits and underscores"),
        ({"format_mode": 4}, r"1 .*, 2 \(YUYV\) or 3 \(MJPEG\)"),
    ],
)
def test_a_wrong_value_is_told_with_its_cure(wrong, cure):
    with pytest.raises(ValueError, match="parameters: %s is .*%s" % (next(iter(wrong)), cure)):
        settings_from(CameraSettings, wrong, "parameters")


@pytest.mark.parametrize(
    "change, reopen, controls",
    [
        ({}, False, {}),
        ({"width": 320}, True, {}),
        ({"device": "/dev/video1", "gain": 3}, True, {"gain": 3}),
        ({"loop": False}, True, {}),
        ({"frame_id": "eye", "camera_name": "left", "camera_info_url": "file:///x.yaml"}, False, {}),
        ({"white_balance_temperature": False, "brightness": 10}, False,
         {"white_balance_temperature": False, "brightness": 10}),
    ],
)  # fmt: skip
def test_what_a_change_asks_of_the_camera(change, reopen, controls):
    after = dataclasses.replace(CameraSettings(), **change)
    assert needs_reopening(CameraSettings(), after) is reopen
    assert changed_controls(CameraSettings(), after) == controls


def test_every_control_is_a_setting():
    assert set(CONTROLS) < {item.name for item in dataclasses.fields(CameraSettings)}
