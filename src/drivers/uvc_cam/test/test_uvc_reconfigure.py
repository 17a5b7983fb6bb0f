"""dynamic_reconfigure offers the same settings, defaults and ranges as CameraSettings."""

import dataclasses

from uvc_cam.cfg import UVCCamConfig
from uvc_cam.settings import CameraSettings


def test_parameters_are_the_settings():
    assert dict(UVCCamConfig.defaults) == dataclasses.asdict(CameraSettings())
    for ends in (UVCCamConfig.min, UVCCamConfig.max):
        for name, value in ends.items():
            if not isinstance(value, str):  # texts have no range
                CameraSettings(**{name: value})
