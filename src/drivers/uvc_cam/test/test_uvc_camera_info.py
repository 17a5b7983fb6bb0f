"""camera_info of a picture."""

from sensor_msgs.msg import CameraInfo

from uvc_cam.camera_info import info_for


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
