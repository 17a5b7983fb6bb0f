"""Parameters of uvc_cam_node, and what a change of them requires from the camera."""

import re
from dataclasses import dataclass, fields

from risc_lab.settings import Name, Settings, between

FORMATS = {1: "", 2: "YUYV", 3: "MJPG"}  # format_mode -> four letters of V4L2; "": any that OpenCV converts to RGB
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
class CameraSettings(Settings):
    """Parameters with the names and defaults of the original, the same as in cfg/UVCCam.cfg."""

    device: Name = "/dev/video0"  # camera (path or number), video file, or folder of pictures
    camera_name: str = "camera"
    format_mode: int = 1  # 1 RGB, 2 YUYV, 3 MJPEG
    width: between(1, 16384) = 640  # [px] requested from a camera; files keep their own size
    height: between(1, 16384) = 480
    frame_rate: between(1.875, 240.0) = 15.0  # [Hz] requested from a camera; playing rate of files
    frame_id: str = "camera"
    camera_info_url: str = ""
    loop: bool = True  # start again at the end of a file or folder
    # Controls of a camera in its own units. A control is not changed until its parameter differs from this default.
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
        super().__post_init__()
        if not re.fullmatch("[A-Za-z0-9_]+", self.camera_name):
            raise ValueError(
                "camera_name is %r, which cannot name a calibration file: use letters, digits and underscores only"
                % self.camera_name
            )
        if self.format_mode not in FORMATS:
            raise ValueError(
                "format_mode is %d, an unknown format: set it to 1 (whatever the camera has), 2 (YUYV) or 3 (MJPEG)"
                % self.format_mode
            )


def changed_controls(before, after):
    """Return {name: new value} of the camera controls that differ between two `CameraSettings`."""
    return {name: getattr(after, name) for name in CONTROLS if getattr(after, name) != getattr(before, name)}


def needs_reopening(before, after):
    """Whether a change affects more than camera controls and names."""
    live = {*CONTROLS, "camera_name", "camera_info_url", "frame_id"}
    return any(
        getattr(before, item.name) != getattr(after, item.name)
        for item in fields(CameraSettings)
        if item.name not in live
    )
