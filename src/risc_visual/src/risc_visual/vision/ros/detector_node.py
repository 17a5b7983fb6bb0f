"""The node behind risc_landmarks and quad_tracker: pictures of any number of vehicles -> regions. Wiring only."""

import threading
import time
from dataclasses import dataclass

import cv2
import rospy
from cv_bridge import CvBridge
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image

from risc_estimation.bearings import calibration_from_info, fleet_calibration, make_camera
from risc_lab.images import picture_from_msg
from risc_lab.ros.diagnostics import Growth, age_text, make_updater
from risc_lab.ros.paced_subscriber import PICTURES_BYTES, PacedSubscriber
from risc_lab.ros.params import fleet_vehicles, load_params
from risc_lab.ros.ticker import Ticker
from risc_maap_msgs.msg import Detections
from risc_msgs.msg import Observed_rois
from risc_visual.ros.conversions import detections_of_picture, rois_of_picture
from risc_visual.vision.colours import SIDE_MIN_PX, Planes, shrunk
from risc_visual.vision.landmark_config import load_landmarks
from risc_visual.vision.landmark_detector import LandmarkDetector
from risc_visual.vision.overlay import draw_landmarks, draw_vehicles
from risc_visual.vision.templates.drawing import draw_crosshair
from risc_visual.vision.vehicle_detector import VehicleDetector, load_vehicles

_SILENCE_S = 3.0
_TOLD_S = 10.0  # between two reports of the same trouble
_INFO_HZ = 0.5  # camera_info comes with every picture and hardly ever changes
_LEGACY_NAMESPACES = ("risc1", "risc2", "risc3", "risc4")


@dataclass(frozen=True)
class LookoutParams:
    """Settings of risc_landmarks and quad_tracker; config/risc_landmarks.yaml explains and holds the same values."""

    vehicles: tuple[str, ...] = ()
    image: str = "ardrone/image_rect_color"
    overlay: str = "ardrone/image_modi"
    rectified: bool = True
    rate_hz: float = 0.0
    quads: bool = False
    landmarks_file: str = ""
    vehicles_file: str = ""

    def __post_init__(self):
        for key in ("image", "overlay"):
            if not getattr(self, key):
                raise ValueError("parameter '%s' must name a topic below the vehicle's namespace" % key)
        if not 0.0 <= self.rate_hz < float("inf"):
            raise ValueError("parameter 'rate_hz' must be 0 (every picture) or positive, got %r" % (self.rate_hz,))


class Lookout:
    """Every vehicle's newest picture -> one Observed_rois, and one Detections, with what that vehicle sees."""

    def __init__(self, topic, landmarks, overlay=None):
        """topic: of the regions. landmarks: look for landmarks; else for vehicles only, without Detections.

        overlay: default of ~overlay. Raises ValueError that names a wrong parameter.
        """
        params = load_params(LookoutParams)[0]
        fleet = {vehicle.namespace: vehicle for vehicle in fleet_vehicles()}
        namespaces = params.vehicles or tuple(fleet) or _LEGACY_NAMESPACES
        self._config = load_landmarks(params.landmarks_file or None) if landmarks else None
        self._names = [kind.roi_name for kind in self._config.landmarks] if landmarks else []
        self._others = tuple(fleet) or namespaces
        looks_for_vehicles = params.quads or not landmarks
        self._vehicles = None
        if looks_for_vehicles:
            self._vehicles = VehicleDetector(load_vehicles(params.vehicles_file or None), self._others)
        self._exact = rospy.Publisher("detections", Detections, queue_size=10, tcp_nodelay=True) if landmarks else None
        self._publisher = rospy.Publisher(topic, Observed_rois, queue_size=10, tcp_nodelay=True)
        self._updater = make_updater("none")
        overlay = params.overlay if overlay is None or params.overlay != LookoutParams.overlay else overlay
        self._eyes = [
            Eye(self, namespace, fleet.get(namespace), params, overlay, self._updater) for namespace in namespaces
        ]
        Ticker(1.0, self._updater.update, "the diagnostics")
        for eye in self._eyes:
            eye.open()

    def make_detector(self, camera):
        """LandmarkDetector for a camera; None when landmarks are not looked for."""
        return None if self._config is None else LandmarkDetector(self._config, camera)

    def look(self, namespace, detector, picture):
        """(landmarks, vehicles) of a picture that a vehicle took."""
        if self._vehicles is None or min(picture.shape[:2]) < SIDE_MIN_PX:
            return detector.detect(picture) if detector is not None else [], []
        planes = Planes(shrunk(picture, self._vehicles.shrink))
        vehicles = self._vehicles.detect_in(planes, observer=namespace)
        if detector is None:
            return [], vehicles
        return detector.detect(picture, planes if detector.shrink == self._vehicles.shrink else None), vehicles

    def publish(self, namespace, header, landmarks, vehicles):
        """Tell what a vehicle sees: every landmark and, if they are looked for, every other vehicle; seen or not."""
        others = [] if self._vehicles is None else [name for name in self._others if name != namespace]
        seen = header, namespace, self._names, landmarks, others, vehicles
        if self._exact is not None:  # first: whoever uses it needs no region of the same picture
            self._exact.publish(detections_of_picture(*seen))
        self._publisher.publish(rois_of_picture(*seen))

    def draw(self, picture, landmarks, vehicles):
        """Draw what was found into the picture."""
        draw_crosshair(picture)
        if self._config is not None:
            draw_landmarks(picture, landmarks, self._config.ring_scale)
        draw_vehicles(picture, vehicles)


class Eye:
    """One vehicle's camera. Its pictures, camera_info and diagnostics come in threads of their own."""

    def __init__(self, lookout, namespace, vehicle, params, overlay, updater):
        """vehicle: FleetVehicle, None if it is not in the fleet. Raises ValueError for a bad calibration file."""
        self._lookout, self._namespace, self._rectified = lookout, namespace, params.rectified
        self._topic = rospy.resolve_name("%s/%s" % (namespace, params.image))
        self._calibration, self._camera, self._detector = None, None, lookout.make_detector(None)
        self._lock = threading.Lock()
        self._counts = {"pictures": 0, "refused": 0}
        self._growth = Growth()
        self._last_s, self._age_s, self._work_s, self._longest_s = None, None, 0.0, 0.0
        self._bridge = CvBridge()
        self._period_s = 1.0 / params.rate_hz if params.rate_hz > 0.0 else 0.0
        self._next_s = 0.0  # when the next picture is looked at; monotonic clock
        if vehicle is not None:
            calibration = fleet_calibration(vehicle)
            if calibration is not None:
                self._use(calibration)
        self._overlay = rospy.Publisher("%s/%s" % (namespace, overlay), Image, queue_size=1)
        updater.add("%s: %s" % (rospy.get_name().rsplit("/", 1)[-1], namespace), self._diagnose)

    def open(self):
        """Begin to look."""
        group = self._topic.rsplit("/", 1)[0]
        PacedSubscriber(group + "/camera_info", CameraInfo, self._on_info, _INFO_HZ)
        rospy.Subscriber(self._topic, Image, self._on_image, queue_size=1, buff_size=PICTURES_BYTES, tcp_nodelay=True)

    def _on_image(self, message):
        start_s = time.monotonic()
        if start_s < self._next_s:  # not waited for: unread pictures would grow old in the socket
            return
        self._next_s = max(self._next_s, start_s - self._period_s) + self._period_s
        try:
            picture = picture_from_msg(message)
            landmarks, vehicles = self._lookout.look(self._namespace, self._detector_of(picture), picture)
        except (ValueError, cv2.error) as error:
            with self._lock:
                self._counts["refused"] += 1
            rospy.logerr_throttle_identical(_TOLD_S, "a picture on %s is refused: %s" % (self._topic, error))
            return
        work_s = time.monotonic() - start_s
        try:
            self._lookout.publish(self._namespace, message.header, landmarks, vehicles)
            if self._overlay.get_num_connections():
                self._lookout.draw(picture, landmarks, vehicles)
                drawn = self._bridge.cv2_to_imgmsg(picture, "bgr8")
                drawn.header = message.header
                self._overlay.publish(drawn)
        except rospy.ROSException:
            if not rospy.core.is_shutdown_requested():  # else: its topics were closed while it worked
                raise
            return
        with self._lock:
            self._counts["pictures"] += 1
            self._last_s = time.monotonic()
            self._age_s = (rospy.Time.now() - message.header.stamp).to_sec()
            self._work_s += work_s
            self._longest_s = max(self._longest_s, work_s)

    def _detector_of(self, picture):
        """For pictures of the calibrated size the detector with the camera, else one that knows no camera."""
        with self._lock:
            detector, camera = self._detector, self._camera
        size = picture.shape[1], picture.shape[0]
        if camera is None or size == (camera.width_px, camera.height_px):
            return detector
        rospy.logwarn_throttle_identical(
            _TOLD_S,
            "pictures on %s are %dx%d, the calibration is for %dx%d: centres of tilted landmarks are less exact; "
            "calibrate the camera at this size" % ((self._topic,) + size + (camera.width_px, camera.height_px)),
        )
        return self._lookout.make_detector(None)

    def _on_info(self, info):
        try:
            calibration = calibration_from_info(info, self._namespace)
            if calibration is not None:
                self._use(calibration)
        except ValueError as error:
            rospy.logerr_throttle_identical(_TOLD_S, str(error))

    def _use(self, calibration):
        if calibration == self._calibration:
            return
        camera = make_camera(calibration, self._rectified)
        detector = self._lookout.make_detector(camera)
        with self._lock:
            self._calibration, self._camera, self._detector = calibration, camera, detector

    def _diagnose(self, status):
        now_s = time.monotonic()
        with self._lock:
            counts, last_s, age_s = dict(self._counts), self._last_s, self._age_s
            work_s, longest_s, camera = self._work_s, self._longest_s, self._camera
            self._work_s, self._longest_s = 0.0, 0.0
        new, rates_hz = self._growth(counts)
        if new["refused"]:
            status.summary(DiagnosticStatus.ERROR, "pictures are refused: the log says why")
        elif last_s is None or now_s - last_s > _SILENCE_S:
            status.summary(DiagnosticStatus.WARN, "no pictures on " + self._topic)
        else:
            status.summary(DiagnosticStatus.OK, "looking")
        status.add("rate [Hz]", "%.1f" % rates_hz["pictures"])
        status.add("age of last picture [s]", age_text(last_s))
        status.add("stamp to result [s]", "none yet" if age_s is None else "%.3f" % age_s)
        status.add("work on a picture [ms]", "%.2f" % (1e3 * work_s / max(1, new["pictures"])))
        status.add("longest work on a picture [ms]", "%.2f" % (1e3 * longest_s))
        status.add("pictures", str(counts["pictures"]))
        status.add("refused", str(counts["refused"]))
        status.add("camera", "not calibrated" if camera is None else camera.calibration.name)
        return status
