"""camera_info of one picture."""

from sensor_msgs.msg import CameraInfo


def info_for(calibration, width, height):
    """Return (CameraInfo of a picture of this size, whether the calibration is for this size).

    calibration: CameraInfo from camera_info_manager, zeros when there is none. A calibration for another size is not
    used: an uncalibrated CameraInfo of the picture's size is returned instead.
    """
    calibrated = calibration.K[0] != 0.0
    fits = not calibrated or (calibration.width, calibration.height) == (width, height)
    if calibrated and fits:
        return calibration, True
    return CameraInfo(width=width, height=height), fits
