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


def resolved_frame(frame_id, tf_prefix):
    """Frame id with the tf_prefix before it; one that begins with a slash is absolute. No leading slash comes out."""
    prefix = tf_prefix.strip("/")
    if frame_id.startswith("/") or not prefix:
        return frame_id.lstrip("/")
    return "%s/%s" % (prefix, frame_id)
