"""Parameters of uvc_cam_node, and what a change of them asks of the camera."""

import math
import re
from dataclasses import dataclass, fields

FORMATS = {1: "", 2: "YUYV", 3: "MJPG"}  # format_mode -> four letters of V4L2; "": whatever can become RGB
CONTROLS = (
    "absolute_exposure",
    "exposure",
    "sharpness",
    "power_line_frequency",
    "white_balance_temperature",
    "gain",
    "saturation",
    "contrast",
    "brightness",
)


@dataclass(frozen=True)
class Settings:
    """Names and defaults of the original."""

    device: str = "/dev/video0"  # camera (path or number), video file, or folder of pictures
    camera_name: str = "camera"
    format_mode: int = 1  # 1 RGB, 2 YUYV, 3 MJPEG
    width: int = 640  # [px] asked of a camera; files keep their own size
    height: int = 480
    frame_rate: float = 15.0  # [Hz] asked of a camera; at which files are played
    frame_id: str = "camera"
    camera_info_url: str = ""
    loop: bool = True  # begin anew at the end of a file or folder
    # Controls of a camera in its own units. They are left as the camera has them until they differ from these.
    absolute_exposure: int = 2089  # [100 us]
    exposure: int = 1  # V4L2's mode: 0 automatic, 1 manual, 2 shutter priority, 3 aperture priority
    sharpness: int = 142
    power_line_frequency: int = 0  # 0 off, 1 50 Hz, 2 60 Hz
    white_balance_temperature: bool = True  # automatic white balance
    gain: int = 82
    saturation: int = 50
    contrast: int = 50
    brightness: int = 66

    def __post_init__(self):
        if not self.device:
            raise ValueError("parameter 'device' is empty: name a camera, a video file or a folder of pictures")
        if not re.fullmatch("[A-Za-z0-9_]+", self.camera_name):
            raise ValueError(
                "parameter 'camera_name' must consist of letters, digits and underscores, got %r" % self.camera_name
            )
        if self.format_mode not in FORMATS:
            raise ValueError("parameter 'format_mode' must be 1 RGB, 2 YUYV or 3 MJPEG, got %r" % self.format_mode)
        for key in ("width", "height"):
            if not 1 <= getattr(self, key) <= 16384:
                raise ValueError("parameter '%s' must be 1 to 16384 px, got %r" % (key, getattr(self, key)))
        if not (math.isfinite(self.frame_rate) and 1.875 <= self.frame_rate <= 240.0):
            raise ValueError("parameter 'frame_rate' must be 1.875 to 240 Hz, got %r" % self.frame_rate)


def changed_controls(before, after):
    """Dict of the camera controls whose value differs between two `Settings`."""
    return {name: getattr(after, name) for name in CONTROLS if getattr(after, name) != getattr(before, name)}


def needs_reopening(before, after):
    """Whether a change asks for more than camera controls and names."""
    live = set(CONTROLS) | {"camera_name", "camera_info_url", "frame_id"}
    return any(
        getattr(before, item.name) != getattr(after, item.name) for item in fields(Settings) if item.name not in live
    )


def settings_from_params(values):
    """(Settings, sorted names of unknown keys) of a dict as the parameter server has it.

    Raises ValueError that names the key for a value of the wrong type or out of range.
    """
    defaults = {item.name: item.default for item in fields(Settings)}
    chosen = {key: _converted(key, values[key], default) for key, default in defaults.items() if key in values}
    return Settings(**chosen), sorted(set(values) - set(defaults) - {"diagnostic_period"})  # of diagnostic_updater


def _converted(key, value, default):
    if isinstance(default, str):
        if isinstance(value, str) or (key == "device" and isinstance(value, int) and not isinstance(value, bool)):
            return str(value)  # _device:=0 arrives as a number
        wanted = "a text"
    elif isinstance(default, bool):
        if isinstance(value, bool):
            return value
        wanted = "true or false"
    elif isinstance(value, bool) or not isinstance(value, (int, float)):
        wanted = "a number"
    elif isinstance(default, float):
        return float(value)
    elif math.isfinite(value) and value == int(value):
        return int(value)
    else:
        wanted = "a whole number"
    raise ValueError("parameter '%s' must be %s, got %r" % (key, wanted, value))
