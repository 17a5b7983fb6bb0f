"""camera_info of a picture, and the frame it is in."""

import pytest
from sensor_msgs.msg import CameraInfo

from uvc_cam.camera_info import info_for, resolved_frame


def calibration(width, height, focal_px):
    return CameraInfo(width=width, height=height, K=[focal_px, 0, 0, 0, focal_px, 0, 0, 0, 1], D=[0.1] * 5)


def test_a_calibration_of_the_right_size_is_used():
    info, fits = info_for(calibration(320, 240, 300.0), 320, 240)
    assert fits and info.K[0] == 300.0 and len(info.D) == 5


def test_a_calibration_of_another_size_is_not_used():
    info, fits = info_for(calibration(640, 480, 600.0), 320, 240)
    assert not fits
    assert (info.width, info.height, info.K[0], len(info.D)) == (320, 240, 0.0, 0)


def test_without_calibration_the_size_is_the_pictures():
    info, fits = info_for(calibration(0, 0, 0.0), 320, 240)
    assert fits and (info.width, info.height, info.K[0]) == (320, 240, 0.0)


@pytest.mark.parametrize(
    "frame_id, prefix, resolved",
    [
        ("camera", "", "camera"),
        ("camera", "risc1", "risc1/camera"),
        ("camera", "/risc1/", "risc1/camera"),
        ("/camera", "risc1", "camera"),
    ],
)
def test_frames_get_the_prefix_and_no_slash(frame_id, prefix, resolved):
    assert resolved_frame(frame_id, prefix) == resolved
