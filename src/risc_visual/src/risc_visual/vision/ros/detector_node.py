"""The node behind risc_landmarks and quad_tracker: pictures of any number of vehicles -> regions. Wiring only."""

from dataclasses import dataclass

import rospy
from cv_bridge import CvBridge
from sensor_msgs.msg import Image

from risc_estimation.ros.cameras import VehicleCameras
from risc_lab.ros.diagnostics import ticking_updater
from risc_lab.ros.params import fleet_vehicles, load_params
from risc_lab.settings import Name, NotNegative, Settings
from risc_maap_msgs.msg import Detections
from risc_msgs.msg import Observed_rois
from risc_visual.ros.conversions import detections_of_picture, rois_of_picture
from risc_visual.vision.colours import SIDE_MIN_PX, Planes
from risc_visual.vision.landmark_config import load_landmarks
from risc_visual.vision.landmark_detector import LandmarkDetector
from risc_visual.vision.overlay import draw_landmarks, draw_vehicles
from risc_visual.vision.ros.picture_reader import PictureReader
from risc_visual.vision.templates.drawing import draw_crosshair
from risc_visual.vision.vehicle_detector import VehicleDetector, load_vehicles

_TOLD_S = 10.0  # between two reports of the same trouble
_LEGACY_NAMESPACES = ("risc1", "risc2", "risc3", "risc4")


@dataclass(frozen=True)
class LookoutParams(Settings):
    """Settings of risc_landmarks and quad_tracker."""

    vehicles: tuple[str, ...] = ()  # namespaces whose cameras are looked through; () = those of /fleet, else risc1..4
    image: Name = "ardrone/image_rect_color"  # topic of the pictures, below the vehicle's namespace
    # topic of the pictures with what was found, drawn only while it has a subscriber, below the vehicle's namespace;
    # "" = ardrone/image_modi, of quad_tracker ardrone/image_quads
    overlay: str = ""
    rectified: bool = True  # the pictures are image_proc's; false: as the camera takes them
    rate_hz: NotNegative = 0.0  # pictures of each camera that are looked at, at most; 0 = every one
    quads: bool = False  # risc_landmarks only: also look for other vehicles, in the same pass
    landmarks_file: str = ""  # "" = config/landmark_detector.yaml, and the landmarks of risc_lab
    vehicles_file: str = ""  # "" = config/vehicles.yaml


class Lookout:
    """Every vehicle's newest picture -> one Observed_rois, and one Detections, with what that vehicle sees."""

    def __init__(self, topic, landmarks, overlay):
        """topic: of the regions. landmarks: look for landmarks; else for vehicles only, without Detections.

        overlay: default of ~overlay. Raises ValueError that names a wrong parameter.
        """
        params = load_params(LookoutParams)[0]
        fleet = fleet_vehicles()
        known = tuple(vehicle.namespace for vehicle in fleet)
        namespaces = params.vehicles or known or _LEGACY_NAMESPACES
        self._config = load_landmarks(params.landmarks_file or None) if landmarks else None
        self._names = [kind.roi_name for kind in self._config.landmarks] if landmarks else []
        self._others = known or namespaces
        self._vehicles = None
        if params.quads or not landmarks:
            self._vehicles = VehicleDetector(load_vehicles(params.vehicles_file or None), self._others)
        self._cameras = VehicleCameras(fleet, params.rectified, params.image.rpartition("/")[0])
        self._unknown = self._make_detector(None)
        self._detectors = dict.fromkeys(namespaces, (None, self._unknown))  # (camera, detector)
        self._exact = rospy.Publisher("detections", Detections, queue_size=10, tcp_nodelay=True) if landmarks else None
        self._publisher = rospy.Publisher(topic, Observed_rois, queue_size=10, tcp_nodelay=True)
        self._bridge = CvBridge()
        self._overlays = {
            name: rospy.Publisher("%s/%s" % (name, params.overlay or overlay), Image, queue_size=1)
            for name in namespaces
        }
        updater = ticking_updater()
        for name in namespaces:
            PictureReader(
                "%s/%s" % (name, params.image),
                lambda picture, header, name=name: self._look(name, picture, header),
                updater,
                "%s: %s" % (rospy.get_name().rsplit("/", 1)[-1], name),
                params.rate_hz,
                lambda name=name: {"camera": self._calibrated(name)},
            ).open()

    def _make_detector(self, camera):
        return None if self._config is None else LandmarkDetector(self._config, camera)

    def _calibrated(self, name):
        camera, _ = self._detectors[name]
        return "not calibrated" if camera is None else camera.calibration.name

    def _look(self, name, picture, header):
        """Search a vehicle's picture and publish what is in it."""
        detector = self._detector_for(name, picture)
        landmarks, vehicles, planes = [], [], None
        if self._vehicles is not None and min(picture.shape[:2]) >= SIDE_MIN_PX:
            planes = Planes(picture, self._vehicles.shrink)
            vehicles = self._vehicles.detect_in(planes, observer=name)
        if detector is not None:
            landmarks = detector.detect(
                picture, planes if planes and detector.shrink == self._vehicles.shrink else None
            )
        # every landmark and, if they are looked for, every other vehicle; seen or not
        others = [] if self._vehicles is None else [other for other in self._others if other != name]
        seen = header, name, self._names, landmarks, others, vehicles
        if self._exact is not None:  # first: its users need no region of the same picture
            self._exact.publish(detections_of_picture(*seen))
        self._publisher.publish(rois_of_picture(*seen))
        if self._overlays[name].get_num_connections():
            draw_crosshair(picture)
            if self._config is not None:
                draw_landmarks(picture, landmarks, self._config.ring_scale)
            draw_vehicles(picture, vehicles)
            drawn = self._bridge.cv2_to_imgmsg(picture, "bgr8")
            drawn.header = header
            self._overlays[name].publish(drawn)

    def _detector_for(self, name, picture):
        """The detector with the vehicle's camera for pictures of the calibrated size, else the one without a camera."""
        camera = self._cameras[name]
        if camera is not self._detectors[name][0]:
            self._detectors[name] = camera, self._make_detector(camera)
        size = picture.shape[1], picture.shape[0]
        if camera is None or size == (camera.width_px, camera.height_px):
            return self._detectors[name][1]
        rospy.logwarn_throttle_identical(
            _TOLD_S,
            "pictures of %s are %dx%d, the calibration is for %dx%d: centres of tilted landmarks are less exact; "
            "calibrate the camera at this size" % ((name,) + size + (camera.width_px, camera.height_px)),
        )
        return self._unknown
