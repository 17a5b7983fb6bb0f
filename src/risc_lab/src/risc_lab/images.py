"""Pictures from messages and files: arrays (h, w, 3) of uint8 that own their data, blue green red. No ROS."""

import pathlib

import cv2
import numpy as np

MESSAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")  # as the rosbags library names them

# Encoding without its depth -> (numbers per pixel, OpenCV's conversion). Of a Bayer pattern sensor_msgs names the first
# two pixels of the first two rows, OpenCV the second and third pixel of the second row.
_TO_BGR = {
    "bgr": (3, None),
    "rgb": (3, cv2.COLOR_RGB2BGR),
    "bgra": (4, cv2.COLOR_BGRA2BGR),
    "rgba": (4, cv2.COLOR_RGBA2BGR),
    "mono": (1, cv2.COLOR_GRAY2BGR),
    "bayer_rggb": (1, cv2.COLOR_BayerBG2BGR),
    "bayer_bggr": (1, cv2.COLOR_BayerRG2BGR),
    "bayer_gbrg": (1, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg": (1, cv2.COLOR_BayerGB2BGR),
}
_ENCODINGS = {
    name + depth: (number, *layout) for name, layout in _TO_BGR.items() for depth, number in (("8", "u1"), ("16", "u2"))
}
_ENCODINGS["yuv422"] = ("u1", 2, cv2.COLOR_YUV2BGR_UYVY)


class PictureError(ValueError):
    """Not a usable picture, with the cause and, where there is one, the cure."""


def picture_from_msg(message):
    """Picture of a sensor_msgs/Image or CompressedImage, of rospy or of the rosbags library. Raises PictureError.

    Of 16-bit values the upper 8 bits are kept.
    """
    if hasattr(message, "format"):
        damaged, picture = "a compressed picture (%s) is damaged" % message.format, None
        try:
            if len(message.data):
                picture = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
        except cv2.error as error:  # e.g. its header says that it is larger than OpenCV takes
            raise PictureError("%s: %s" % (damaged, error.err)) from error
        if picture is None:
            raise PictureError(damaged)
        return picture
    if not hasattr(message, "encoding"):
        raise PictureError("it is no picture but %s" % type(message).__name__)
    height, width, step = message.height, message.width, message.step
    if not height or not width:
        raise PictureError("it is empty (%d x %d)" % (width, height))
    if message.encoding not in _ENCODINGS:
        raise PictureError(
            "its encoding '%s' cannot be converted to colour; publish one of %s"
            % (message.encoding, ", ".join(_ENCODINGS))
        )
    number, channels, conversion = _ENCODINGS[message.encoding]
    kind = np.dtype((">" if message.is_bigendian else "<") + number)
    row_bytes = width * channels * kind.itemsize
    if step < row_bytes or len(message.data) < height * step:
        raise PictureError(
            "%d x %d in %s needs rows of %d bytes; it has rows of %d and %d bytes in all"
            % (width, height, message.encoding, row_bytes, step, len(message.data))
        )
    rows = np.frombuffer(message.data, np.uint8, height * step).reshape(height, step)[:, :row_bytes]
    picture = np.ascontiguousarray(rows).view(kind).reshape(height, width, channels)
    if kind.itemsize > 1:
        picture = (picture >> 8).astype(np.uint8)
    try:
        return picture.copy() if conversion is None else cv2.cvtColor(picture, conversion)
    except cv2.error as error:  # e.g. a Bayer pattern of one row
        raise PictureError("OpenCV cannot convert %d x %d in %s" % (width, height, message.encoding)) from error


def picture_from_file(path):
    """Picture of a file. Raises PictureError."""
    path = pathlib.Path(path)
    if not path.exists():
        raise PictureError("no such file: check the path")
    if path.is_dir():
        raise PictureError("it is a folder: name the files in it, e.g. %s/*.png" % path)
    try:
        picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    except cv2.error as error:  # e.g. larger than OpenCV takes
        raise PictureError("OpenCV cannot read it: %s" % error.err) from error
    if picture is None:
        raise PictureError("it is no picture that OpenCV can read, or may not be read: convert it to PNG or JPEG")
    return picture
