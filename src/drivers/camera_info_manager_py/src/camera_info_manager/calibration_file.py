"""The YAML of a camera calibration, as camera_calibration and the camera drivers of ROS write and read it.

risc_lab.lab.calibration reads the same files, more narrowly. It is not used here: this package stands in for one of
ROS and works in workspaces without our own packages.
"""

import math
import os
import tempfile
from collections import namedtuple

import yaml

# Number of coefficients; models that are not listed are passed on as they are.
_COEFFICIENTS = {"plumb_bob": (4, 5), "rational_polynomial": (8,), "equidistant": (4,)}
_DEFAULT_MODEL = "plumb_bob"
_UNKNOWN_NAME = "unknown"

Calibration = namedtuple(
    "Calibration",
    (
        "name",  # of the camera
        "width_px",
        "height_px",
        "distortion_model",
        "D",  # distortion coefficients
        "K",  # 3 x 3 camera matrix, row by row [px]
        "R",  # 3 x 3 rectification rotation
        "P",  # 3 x 4 projection of the rectified image [px]
    ),
)


class CalibrationFileError(ValueError):
    """A calibration file that cannot be read or written; the text names the file, the place and the cause."""


def read_calibration(path):
    """Calibration of a file. CalibrationFileError when it is missing or malformed."""
    try:
        with open(path, encoding="utf-8") as file:
            text = file.read()
    except (OSError, UnicodeDecodeError) as error:
        raise CalibrationFileError("cannot read the calibration %s: %s" % (path, error)) from None
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise CalibrationFileError(
            "%s is not valid YAML (%s): mend the line or calibrate again" % (path, " ".join(str(error).split()))
        ) from None
    if not isinstance(content, dict):
        raise CalibrationFileError("%s holds no calibration: keys like image_width are needed" % path)
    try:
        return _calibration(content)
    except ValueError as error:
        raise CalibrationFileError("%s: %s" % (path, error)) from None


def write_calibration(calibration, path):
    """Write the file, and the folders above it where they are missing. CalibrationFileError when that fails.

    The old file stays whole until the new one is complete.
    """
    content = {
        "image_width": int(calibration.width_px),
        "image_height": int(calibration.height_px),
        "camera_name": calibration.name,
        "camera_matrix": _entry(3, 3, calibration.K),
        "distortion_model": calibration.distortion_model,
        "distortion_coefficients": _entry(1, len(calibration.D), calibration.D),
        "rectification_matrix": _entry(3, 3, calibration.R),
        "projection_matrix": _entry(3, 4, calibration.P),
    }
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    path = os.path.realpath(path)  # a link stays a link
    folder = os.path.dirname(path)
    temporary = None
    try:
        os.makedirs(folder, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", encoding="utf-8", dir=folder, delete=False) as file:
            temporary = file.name
            file.write(text)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None and os.path.exists(temporary):
            os.unlink(temporary)
        raise CalibrationFileError("cannot write the calibration %s: %s" % (path, error)) from None


def _entry(rows, columns, data):
    return {"rows": rows, "cols": columns, "data": [float(value) for value in data]}


def _calibration(content):
    model = content.get("distortion_model", _DEFAULT_MODEL)
    if not isinstance(model, str):
        raise ValueError("distortion_model must be a text, found %r" % (model,))
    coefficients = _matrix(content, "distortion_coefficients", None)
    allowed = _COEFFICIENTS.get(model)
    if allowed is not None and len(coefficients) not in allowed:
        raise ValueError(
            "distortion_coefficients: %s has %s numbers, found %d"
            % (model, " or ".join(map(str, allowed)), len(coefficients))
        )
    return Calibration(
        name=str(content.get("camera_name", _UNKNOWN_NAME)),
        width_px=_size(content, "image_width"),
        height_px=_size(content, "image_height"),
        distortion_model=model,
        D=coefficients,
        K=_matrix(content, "camera_matrix", (3, 3)),
        R=_matrix(content, "rectification_matrix", (3, 3)),
        P=_matrix(content, "projection_matrix", (3, 4)),
    )


def _size(content, key):
    value = content.get(key)
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError("%s must be a number of pixels, found %r" % (key, value))
    return value


def _matrix(content, key, shape):
    """Tuple of the numbers of one matrix, row by row; shape: (rows, columns), or None for any single row or column."""
    section = content.get(key)
    if not isinstance(section, dict):
        raise ValueError("%s is missing, or has no rows, cols and data" % key)
    data = section.get("data")
    if not isinstance(data, list):
        raise ValueError("%s: data must be a list of numbers, found %r" % (key, data))
    numbers = tuple(_number(key, value) for value in data)
    if shape is None:
        shape = (1, len(numbers)) if section.get("rows") == 1 else (len(numbers), 1)
    if (section.get("rows"), section.get("cols")) != shape or len(numbers) != shape[0] * shape[1]:
        raise ValueError(
            "%s must be %d x %d, found rows %r, cols %r and %d numbers"
            % (key, *shape, section.get("rows"), section.get("cols"), len(numbers))
        )
    return numbers


def _number(key, value):
    try:
        number = math.nan if isinstance(value, bool) else float(value)  # YAML takes 1e-05 for a text
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise ValueError("%s: %r is not a finite number" % (key, value))
    return number
