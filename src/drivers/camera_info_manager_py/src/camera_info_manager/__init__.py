"""Calibration of a camera for drivers written in Python, see CameraInfoManager.

risc_lab.lab.calibration reads the files; `manager` has the messages and the service.
"""

from camera_info_manager.manager import CameraInfoError, CameraInfoManager, CameraInfoMissingError

__all__ = ["CameraInfoError", "CameraInfoManager", "CameraInfoMissingError"]
