"""Calibration of a camera for drivers written in Python, see CameraInfoManager.

calibration_file and urls are pure; manager has the messages and the service.
"""

from camera_info_manager.manager import CameraInfoError, CameraInfoManager, CameraInfoMissingError

__all__ = ["CameraInfoError", "CameraInfoManager", "CameraInfoMissingError"]
