"""Calibration of a camera for drivers written in Python, see CameraInfoManager.

Files are read by risc_lab.lab.calibration; manager has the messages and the service.
"""

from camera_info_manager.manager import CameraInfoError, CameraInfoManager, CameraInfoMissingError

__all__ = ["CameraInfoError", "CameraInfoManager", "CameraInfoMissingError"]
