"""The camera of every vehicle: from its camera_info while it is published, else from the fleet file."""

import threading
import time

import rospy
from sensor_msgs.msg import CameraInfo

from risc_estimation.bearings import calibration_from_info, make_camera
from risc_lab.lab.calibration import load_calibration
from risc_lab.ros.paced_subscriber import PacedSubscriber

_LOOK_HZ = 1.0  # camera_info comes with every picture and hardly ever changes
_PATIENCE_S = 3.0  # the first camera_info may come after the first picture


class VehicleCameras:
    """Cameras by vehicle namespace. Problems are logged once each, with the cure, and listed for diagnostics."""

    def __init__(self, fleet, rectified, camera, default_calibration=""):
        """fleet: FleetVehicles. rectified: which pictures. camera: namespace of the pictures below the vehicle's.

        default_calibration: file for vehicles whose fleet entry names none. Raises ValueError for a bad file.
        """
        self._rectified = rectified
        self._topic = "%%s/%s/camera_info" % camera if camera else "%s/camera_info"
        self._lock = threading.Lock()  # every camera_info has a thread of its own
        self._namespace = {vehicle.template: vehicle.namespace for vehicle in fleet}
        self._known, self._problems = {}, {}  # namespace: (CameraCalibration, Camera, where from); what is wrong
        self._subscribers, self._first_asked_s = {}, {}
        for vehicle in fleet:
            calibration = load_calibration(vehicle.calibration or default_calibration)
            if calibration is not None:
                self._accept(vehicle.namespace, calibration, "fleet")
        for vehicle in fleet:
            self._listen(vehicle.namespace)

    def __getitem__(self, name):
        """Camera of a vehicle, by namespace or mocap template; None, with a warning the first time, if unknown."""
        namespace = self._namespace.get(name, name)
        self._listen(namespace)
        with self._lock:
            _, camera, _ = self._known.get(namespace, (None, None, ""))
            first_s = self._first_asked_s.setdefault(namespace, time.monotonic())
        if camera is None and time.monotonic() - first_s > _PATIENCE_S:
            self._complain(
                namespace,
                "it has no calibration, so its angles are not visible: give `calibration` in the fleet file, or "
                "calibrate the driver's camera (%s says nothing)" % rospy.resolve_name(self._topic % namespace),
            )
        return camera

    def sources(self):
        """{namespace: where its camera comes from}, for diagnostics."""
        with self._lock:
            return {name: source for name, (_, _, source) in self._known.items()}

    def problems(self):
        """{namespace: what is wrong}, for diagnostics; only of vehicles that have no camera."""
        with self._lock:
            return {name: text for name, text in self._problems.items() if name not in self._known}

    def _listen(self, namespace):
        with self._lock:
            if namespace in self._subscribers:
                return
            self._subscribers[namespace] = None  # the next caller need not wait for the subscription
        self._subscribers[namespace] = PacedSubscriber(
            self._topic % namespace, CameraInfo, self._on_info, _LOOK_HZ, (namespace,)
        )

    def _on_info(self, info, namespace):
        try:
            calibration = calibration_from_info(info, namespace)
            if calibration is None:
                return  # the driver is not calibrated: the fleet file may know
            self._accept(namespace, calibration, "camera_info")
        except ValueError as error:
            self._complain(namespace, str(error))

    def _accept(self, namespace, calibration, source):
        with self._lock:
            before, camera, _ = self._known.get(namespace, (None, None, ""))
        if before != calibration:
            camera = make_camera(calibration, self._rectified)
            rospy.loginfo("%s: camera from %s (%s)", namespace, source, calibration.name)
        with self._lock:
            self._known[namespace] = calibration, camera, source

    def _complain(self, namespace, text):
        with self._lock:
            known = self._problems.get(namespace) == text
            self._problems[namespace] = text
        if not known:
            rospy.logwarn("%s: %s", namespace, text)
