"""camera_info of one picture."""

from sensor_msgs.msg import CameraInfo


def info_for(calibration, width, height):
    """(CameraInfo of a picture of this size, whether the calibration is for this size).

    calibration: CameraInfo as camera_info_manager hands it out, zeros when there is none. One that is for another size
    is not used: an uncalibrated CameraInfo of the picture's size comes instead.
    """
    calibrated = calibration.K[0] != 0.0
    fits = not calibrated or (calibration.width, calibration.height) == (width, height)
    if calibrated and fits:
        return calibration, True
    return CameraInfo(width=width, height=height), fits
