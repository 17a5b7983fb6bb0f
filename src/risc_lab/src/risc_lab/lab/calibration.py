"""Camera calibration files (the YAML of ROS' camera_info) and where a camera sits on its vehicle. Needs no ROS."""

import math
import os
import pathlib
from dataclasses import dataclass, replace

import numpy as np
import yaml

from risc_lab.lab.yaml_reader import load_yaml, package_file
from risc_lab.settings import Count, Settings, Vector, between, settings_from

DISTORTION_MODEL = "plumb_bob"
_FOLDER = "package://risc_lab/config/cameras/"  # what a bare file name means
_SHAPES = {  # of K, D, R, P in a file; D may have any number of coefficients, in a row or a column
    "camera_matrix": (3, 3),
    "distortion_coefficients": None,
    "rectification_matrix": (3, 3),
    "projection_matrix": (3, 4),
}


@dataclass(frozen=True)
class CameraCalibration:
    """Calibration of one camera (thesis 4.4.3), as its file and a sensor_msgs/CameraInfo hold it."""

    name: str
    width_px: int
    height_px: int
    K: tuple[float, ...]  # 3 x 3 camera matrix, row by row [px]
    D: tuple[float, ...]  # distortion coefficients; for plumb_bob k1, k2, p1, p2, k3
    R: tuple[float, ...]  # 3 x 3 rectification rotation
    P: tuple[float, ...]  # 3 x 4 projection of the rectified image [px]
    distortion_model: str = DISTORTION_MODEL

    @classmethod
    def from_intrinsics(cls, name, size_px, focal_px, centre_px, distortion=(0.0, 0.0, 0.0, 0.0, 0.0)):
        """Calibration of (width, height), (fx, fy), (cx, cy) and k1, k2, p1, p2, k3; rectified with the same K."""
        (fx, fy), (cx, cy) = focal_px, centre_px
        return cls(
            name=name,
            width_px=size_px[0],
            height_px=size_px[1],
            K=(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0),
            D=tuple(distortion),
            R=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
            P=(fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0),
        ).usable()

    @classmethod
    def from_info(cls, info, name):
        """Calibration of a sensor_msgs/CameraInfo (of rospy or of the rosbags library)."""
        matrices = [tuple(float(value) for value in matrix) for matrix in (info.K, info.D, info.R, info.P)]
        return cls(name, int(info.width), int(info.height), *matrices, info.distortion_model or DISTORTION_MODEL)

    def usable(self):
        """This calibration with five coefficients. Raises ValueError when `risc_lab.camera` cannot use it."""
        where = "camera %s: " % self.name
        if self.distortion_model != DISTORTION_MODEL or len(self.D) > 5:
            found = DISTORTION_MODEL, self.distortion_model, len(self.D)
            raise ValueError(where + "distortion_model must be %s with 5 coefficients, found %s with %d" % found)
        if self.width_px < 1 or self.height_px < 1:
            raise ValueError(where + "the image has no size (%d x %d)" % (self.width_px, self.height_px))
        if not np.all(np.isfinite(self.K + self.D + self.R + self.P)):
            raise ValueError(where + "K, D, R and P must be finite")
        if self.K[0] <= 0.0 or self.K[4] <= 0.0:
            raise ValueError(where + "not calibrated (focal length 0)")
        return replace(self, D=self.D + (0.0,) * (5 - len(self.D)))


@dataclass(frozen=True)
class _Matrix(Settings):
    rows: Count
    cols: Count
    data: tuple[float, ...]  # row by row


@dataclass(frozen=True)
class _CalibrationFile(Settings):
    image_width: Count
    image_height: Count
    camera_matrix: _Matrix
    distortion_coefficients: _Matrix
    rectification_matrix: _Matrix
    projection_matrix: _Matrix
    camera_name: str = "unknown"
    distortion_model: str = DISTORTION_MODEL

    def __post_init__(self):
        super().__post_init__()
        for key, shape in _SHAPES.items():
            matrix, count = getattr(self, key), len(getattr(self, key).data)
            shapes = [shape] if shape else [(1, count), (count, 1)]
            if (matrix.rows, matrix.cols) not in shapes or count != matrix.rows * matrix.cols:
                found = key, *shapes[0], matrix.rows, matrix.cols, count
                raise ValueError("'%s' must be %d x %d, found %d rows, %d cols and %d numbers" % found)


@dataclass(frozen=True)
class CameraMount:
    """Where a camera sits on its vehicle.

    Camera axes: x along the optical axis, y right, z down in the picture; body axes: x nose, y right wing, z belly.
    """

    position_m: tuple[float, float, float] = (0.21, 0.0, 0.0)  # of the focal point, body axes; AR.Drone front camera
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0


FRONT_MOUNT = CameraMount()
BOTTOM_MOUNT = CameraMount(position_m=(0.0, 0.02, 0.0), pitch_rad=-0.5 * math.pi)  # looks down, nose up in the picture


@dataclass(frozen=True)
class _MountFile(Settings):
    position_m: Vector = FRONT_MOUNT.position_m
    roll_deg: between(-180.0, 180.0) = 0.0
    pitch_deg: between(-90.0, 90.0) = 0.0
    yaw_deg: between(-180.0, 180.0) = 0.0


def resolve_url(url):
    """Path of a calibration or mount: file://, package://PACKAGE/, a path, or a name in risc_lab/config/cameras.

    The file need not exist: a driver writes it when its camera is calibrated. ValueError when the package does not.
    """
    if url.startswith("file://"):
        return pathlib.Path(url[len("file://") :])
    if not url.startswith("package://"):
        path = pathlib.Path(url).expanduser()
        if path.is_absolute() or len(path.parts) > 1:
            return path
        url = _FOLDER + url
    package, _, relative = url[len("package://") :].partition("/")
    return package_file(package, "package.xml").parent / relative


def read_calibration(path):
    """CameraCalibration of a file, read as ROS' camera drivers do: any distortion model, unknown keys ignored.

    Raises ValueError that names the file, the key and what is wrong with it.
    """
    content = load_yaml(path)
    known = {key: content[key] for key in _CalibrationFile.__dataclass_fields__ if key in content}
    file = settings_from(_CalibrationFile, known, str(path), lenient=True)
    matrices = [getattr(file, key).data for key in _SHAPES]
    return CameraCalibration(file.camera_name, file.image_width, file.image_height, *matrices, file.distortion_model)


def load_calibration(url):
    """A calibration that `risc_lab.camera` can use, from a file (`resolve_url`); None for "". Raises ValueError."""
    if not url:
        return None
    path = resolve_url(url)
    calibration = read_calibration(path)
    try:
        return calibration.usable()
    except ValueError as error:
        raise ValueError("%s: %s" % (path, error)) from error


def save_calibration(calibration, path):
    """Write a calibration file, and missing folders above it. Raises OSError.

    The old file stays whole until the new one is complete.
    """
    content = {
        "image_width": int(calibration.width_px),
        "image_height": int(calibration.height_px),
        "camera_name": calibration.name,
        "distortion_model": calibration.distortion_model,
    }
    for (key, shape), data in zip(_SHAPES.items(), (calibration.K, calibration.D, calibration.R, calibration.P)):
        rows, cols = shape or (1, len(data))
        content[key] = {"rows": rows, "cols": cols, "data": [float(value) for value in data]}
    pathlib.Path(path).resolve().parent.mkdir(parents=True, exist_ok=True)
    _replace(path, yaml.safe_dump(content, sort_keys=False, default_flow_style=None))


def load_mount(url):
    """CameraMount of a file: position_m, roll_deg, pitch_deg, yaw_deg; for "" the nominal one of a front camera.

    Raises ValueError that names file and key.
    """
    if not url:
        return FRONT_MOUNT
    path = resolve_url(url)
    file = settings_from(_MountFile, load_yaml(path), str(path))
    return CameraMount(file.position_m, *map(math.radians, (file.roll_deg, file.pitch_deg, file.yaw_deg)))


def save_mount(mount, path):
    """Write a camera mount that load_mount reads; the old file stays whole until it is complete. Raises OSError."""
    degrees = map(math.degrees, (mount.roll_rad, mount.pitch_rad, mount.yaw_rad))
    content = {
        "position_m": [float(value) for value in mount.position_m],
        **dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), degrees)),
    }
    text = "# Front camera in body axes (x nose, y right wing, z belly).\n"
    text += yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    _replace(path, text)


def _replace(path, text):
    """Write a file atomically: it is never half written, even when the computer is switched off."""
    path = pathlib.Path(path).resolve()  # a link stays a link
    temporary = path.with_name("%s.%d" % (path.name, os.getpid()))
    try:
        with temporary.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
