"""Camera calibration files (the YAML of ROS' camera_info) and where a camera sits on its vehicle. Needs no ROS.

camera_info_manager.calibration_file reads and writes the same files for the drivers. The two stay apart: that
package stands in for one of ROS and must do without ours, and this module without ROS.
"""

import math
import pathlib
from dataclasses import dataclass

import numpy as np
import yaml

from risc_lab.lab.yaml_reader import Section, errors_of, load_yaml, package_file

DISTORTION_MODEL = "plumb_bob"
_FOLDER = "package://risc_lab/config/cameras/"  # what a bare file name means


@dataclass(frozen=True)
class CameraCalibration:
    """Intrinsics of one camera (thesis 4.4.3), as its calibration file holds them."""

    name: str
    width_px: int
    height_px: int
    K: tuple[float, ...]  # 3 x 3 camera matrix, row by row [px]
    D: tuple[float, ...]  # k1, k2, p1, p2, k3
    R: tuple[float, ...]  # 3 x 3 rectification rotation
    P: tuple[float, ...]  # 3 x 4 projection of the rectified image [px]

    def __post_init__(self):
        if self.width_px < 1 or self.height_px < 1:
            raise ValueError("camera %s: the image has no size (%d x %d)" % (self.name, self.width_px, self.height_px))
        for what, length in (("K", 9), ("D", 5), ("R", 9), ("P", 12)):
            values = getattr(self, what)
            if len(values) != length or not np.all(np.isfinite(values)):
                raise ValueError("camera %s: %s must be %d finite numbers" % (self.name, what, length))
        if self.K[0] <= 0.0 or self.K[4] <= 0.0:
            raise ValueError("camera %s: not calibrated (focal length 0)" % self.name)

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
        )


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


def resolve_url(url):
    """Path of a calibration or mount: file://, package://PACKAGE/, a path, or a name in risc_lab/config/cameras.

    The file need not be there: a driver writes it when its camera is calibrated. ValueError when the package is not.
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


def load_calibration(url):
    """Read a calibration file. Raises ValueError that names the file, the key and what is wrong with it."""
    path = resolve_url(url)
    root = Section(load_yaml(path), str(path))
    model = root.text("distortion_model", DISTORTION_MODEL)
    if model != DISTORTION_MODEL:
        raise ValueError("%s: distortion_model must be %s, found %s" % (path, DISTORTION_MODEL, model))
    with errors_of(path):
        calibration = CameraCalibration(
            name=root.text("camera_name", path.stem),
            width_px=root.whole("image_width", minimum=1),
            height_px=root.whole("image_height", minimum=1),
            K=_matrix(root, "camera_matrix", 3, 3),
            D=_matrix(root, "distortion_coefficients", 1, 5),
            R=_matrix(root, "rectification_matrix", 3, 3),
            P=_matrix(root, "projection_matrix", 3, 4),
        )
    root.done()
    return calibration


def save_calibration(calibration, path):
    """Write a calibration file that camera_info_manager, image_proc and load_calibration read. Raises OSError."""
    content = {
        "image_width": calibration.width_px,
        "image_height": calibration.height_px,
        "camera_name": calibration.name,
        "camera_matrix": _entry(3, 3, calibration.K),
        "distortion_model": DISTORTION_MODEL,
        "distortion_coefficients": _entry(1, 5, calibration.D),
        "rectification_matrix": _entry(3, 3, calibration.R),
        "projection_matrix": _entry(3, 4, calibration.P),
    }
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    pathlib.Path(path).write_text(text, encoding="utf-8")


def load_mount(url):
    """Read a camera mount: position_m, roll_deg, pitch_deg, yaw_deg. Raises ValueError that names file and key."""
    path = resolve_url(url)
    root = Section(load_yaml(path), str(path))
    mount = CameraMount(
        position_m=root.vector("position_m", 3, FRONT_MOUNT.position_m),
        roll_rad=math.radians(root.number("roll_deg", 0.0, -180.0, 180.0)),
        pitch_rad=math.radians(root.number("pitch_deg", 0.0, -90.0, 90.0)),
        yaw_rad=math.radians(root.number("yaw_deg", 0.0, -180.0, 180.0)),
    )
    root.done()
    return mount


def save_mount(mount, path):
    """Write a camera mount that load_mount reads. Raises OSError."""
    content = {
        "position_m": [float(value) for value in mount.position_m],
        "roll_deg": math.degrees(mount.roll_rad),
        "pitch_deg": math.degrees(mount.pitch_rad),
        "yaw_deg": math.degrees(mount.yaw_rad),
    }
    text = "# Front camera in body axes (x nose, y right wing, z belly).\n"
    text += yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    pathlib.Path(path).write_text(text, encoding="utf-8")


def _matrix(root, key, rows, columns):
    section = root.section(key)
    section.number("rows", rows, rows, rows)
    section.number("cols", columns, columns, columns)
    values = section.vector("data", rows * columns)
    section.done()
    return values


def _entry(rows, columns, data):
    return {"rows": rows, "cols": columns, "data": [float(value) for value in data]}
