"""CameraInfoManager: a camera's calibration as sensor_msgs/CameraInfo, and the service that replaces it."""

import copy
import threading

import rospy
from sensor_msgs.msg import CameraInfo
from sensor_msgs.srv import SetCameraInfo, SetCameraInfoResponse

from camera_info_manager import urls
from risc_lab.lab.calibration import CameraCalibration, read_calibration, save_calibration


class CameraInfoError(Exception):
    """Base of the exceptions of this module."""


class CameraInfoMissingError(CameraInfoError):
    """getCameraInfo was called before loadCameraInfo, or after the name or URL has changed."""


class CameraInfoManager:
    """Calibration of one camera.

    cname: name of the camera (letters, digits, underscores); it is written into the file, and ${NAME} in the URL.
    url: of the calibration: file:///PATH or package://PACKAGE/PATH, with ${NAME} and ${ROS_HOME} replaced;
    "" is file://${ROS_HOME}/camera_info/${NAME}.yaml.
    namespace: of the service set_camera_info, which takes a calibration and saves it under the URL.

    Call loadCameraInfo once, before getCameraInfo. A camera without a file, or with a malformed one (one error is
    logged), is not calibrated: its CameraInfo is empty. Raises CameraInfoError for an invalid name.
    """

    def __init__(self, cname="camera", url="", namespace=""):
        if not urls.is_valid_name(cname):
            raise CameraInfoError("the camera name %r must consist of letters, digits and underscores" % cname)
        self._lock = threading.Lock()  # the service is called in its own thread
        self._name = cname
        self._url = url
        self._info = None  # CameraInfo, None before it is loaded
        self._namespace = namespace.rstrip("/")
        self._service = rospy.Service(
            self._namespace + "/set_camera_info" if self._namespace else "set_camera_info",
            SetCameraInfo,
            self.setCameraInfo,
        )

    def __str__(self):
        return "[%s] calibration of %s at %s" % (self._namespace, self._name, self._url or urls.DEFAULT_URL)

    def getCameraInfo(self):
        """Copy of CameraInfo without header; empty if not calibrated. CameraInfoMissingError before loading."""
        with self._lock:
            if self._info is None:
                raise CameraInfoMissingError("the calibration of %s is not loaded: call loadCameraInfo" % self._name)
            return copy.deepcopy(self._info)

    def getCameraName(self):
        """Return the name of the camera."""
        return self._name

    def getURL(self):
        """Return the URL as it was given, variables not replaced."""
        return self._url

    def isCalibrated(self):
        """Whether the camera is calibrated. CameraInfoMissingError before loading."""
        return self.getCameraInfo().K[0] != 0.0

    def loadCameraInfo(self):
        """Read the calibration from the URL. A problem is logged once; the camera is then not calibrated."""
        with self._lock:
            self._info = CameraInfo()
            try:
                path = urls.path_of(self._url, self._name)
                calibration = read_calibration(path)
            except ValueError as error:
                if isinstance(error.__cause__, FileNotFoundError):
                    log = rospy.logwarn if self._url.strip() else rospy.loginfo  # no warning for the default URL
                    log("camera %s is not calibrated: no file %s", self._name, path)
                else:
                    rospy.logerr("camera %s is not calibrated: %s", self._name, error)
                return
            if calibration.name != self._name:
                rospy.logwarn(
                    "the calibration %s is for a camera named %s but used for %s", path, calibration.name, self._name
                )
            self._info = _message(calibration)

    def setCameraInfo(self, request):
        """Callback of the service: use the calibration of a SetCameraInfoRequest and save it.

        The response says whether it could be saved; it is used in any case.
        """
        with self._lock:
            self._info = copy.deepcopy(request.camera_info)
            try:
                path = urls.path_of(self._url, self._name)
                save_calibration(CameraCalibration.from_info(self._info, self._name), path)
            except (ValueError, OSError) as error:
                problem = "used but not saved as %s: %s" % (self._url.strip() or urls.DEFAULT_URL, error)
                rospy.logerr("the new calibration of %s is %s", self._name, problem)
                return SetCameraInfoResponse(success=False, status_message=problem)
            rospy.loginfo("the new calibration of %s is saved in %s", self._name, path)
            return SetCameraInfoResponse(success=True, status_message="saved in %s" % path)

    def setCameraName(self, cname):
        """Change the name; False (and no change) if it is invalid. The calibration must be loaded again."""
        if not urls.is_valid_name(cname):
            return False
        with self._lock:
            self._name = cname
            self._info = None
        return True

    def setURL(self, url):
        """Change the URL; False (and no change) if it names no file. The calibration must be loaded again."""
        try:
            urls.path_of(url, self._name)
        except ValueError:
            return False
        with self._lock:
            self._url = url
            self._info = None
        return True


def _message(calibration):
    return CameraInfo(
        width=calibration.width_px,
        height=calibration.height_px,
        distortion_model=calibration.distortion_model,
        D=list(calibration.D),
        K=list(calibration.K),
        R=list(calibration.R),
        P=list(calibration.P),
    )
