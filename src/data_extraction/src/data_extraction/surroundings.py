"""What a bag tells of the cameras' surroundings: where vehicles and landmarks were, and what the cameras are like."""

import math
from collections import defaultdict

import numpy as np

from data_extraction.camera_topics import is_bottom, namespace_of
from data_extraction.flatten import seconds
from data_extraction.samples import Samples
from risc_estimation.bearings import calibration_from_info
from risc_estimation.expected_bearings import Hull
from risc_estimation.pose_track import PoseTrack
from risc_lab.lab.calibration import BOTTOM_MOUNT, FRONT_MOUNT, load_calibration, load_mount
from risc_lab.lab.fleet import laboratory_vehicles
from risc_lab.lab.landmark_catalogue import load_landmark_catalogue
from risc_lab.lab.templates import load_templates

CAMERA_INFO = "/camera_info"
LANDMARKS, MOCAP = "/states3", "/mocap_data"
_MARKER_FRAMES = 200  # enough to average the noise of the markers
_LANDMARK_ROWS = 60_000  # five minutes at 200 Hz; what stands still needs no more


class Surroundings:
    """Takes the messages of a bag one by one; afterwards it is asked."""

    def __init__(self, fleet=None, states_topics=("/cortex_raw",)):
        """fleet: risc_lab.lab.Fleet; None = the original laboratory's names, no calibrations.

        states_topics: which topics say where vehicles are. Raises ValueError for calibrations, mounts, templates or a
        landmarks file that are not usable.
        """
        vehicles = fleet.vehicles if fleet else laboratory_vehicles()
        self._fleet = fleet
        self._template = {vehicle.namespace: vehicle.template for vehicle in vehicles}
        self._namespace = {vehicle.template: vehicle.namespace for vehicle in vehicles}
        self._fleet_calibrations = {vehicle.namespace: load_calibration(vehicle.calibration) for vehicle in vehicles}
        self._mounts = {vehicle.namespace: load_mount(vehicle.camera_mount) for vehicle in vehicles}
        self._templates = load_templates(fleet=fleet)
        self.catalogue = load_landmark_catalogue()
        self.tracks = {topic: defaultdict(PoseTrack) for topic in states_topics}
        self._landmarks = defaultdict(lambda: Samples(3, _LANDMARK_ROWS))
        self._rims = {}  # name -> [frames, sum of the markers' positions (n, 3)]
        self._infos = {}  # (namespace, is bottom) -> CameraInfo

    def __call__(self, topic, _receipt_s, message):
        """Take one message; topics that are of no interest are passed over."""
        if topic in self.tracks:
            stamp_s = seconds(message.header.stamp)
            tracks = self.tracks[topic]
            for state in message.Obj:
                if state.visible:
                    angles_rad = (math.radians(state.phi), math.radians(state.theta), math.radians(state.psi))
                    tracks[state.name].append(stamp_s, (state.x, state.y, state.z), angles_rad)
        elif topic == LANDMARKS:
            for landmark in message.Obj:
                self._landmarks[landmark.name].append((landmark.x, landmark.y, landmark.z))
        elif topic == MOCAP:
            self._keep_rims(message)
        elif topic.endswith(CAMERA_INFO):
            self._infos[namespace_of(topic), is_bottom(message)] = message

    def wants(self, topic):
        """Whether messages of this topic say anything here."""
        return topic in self.tracks or topic in (LANDMARKS, MOCAP) or topic.endswith(CAMERA_INFO)

    def vehicle(self, name):
        """Mocap template of a vehicle that is named by its namespace or by its template. Raises ValueError.

        "" (topics without a namespace) is the only vehicle of a fleet of one.
        """
        if not name and len(self._template) == 1:
            return next(iter(self._template.values()))
        if name in self._namespace:
            return name
        if name not in self._template:
            raise ValueError(
                "no vehicle has the namespace '%s'; known are %s: give the fleet file of this flight"
                % (name, ", ".join("%s (%s)" % item for item in self._template.items()))
            )
        return self._template[name]

    def calibration(self, name, bottom=False):
        """CameraCalibration of a vehicle (namespace or template): the bag's camera_info, else the fleet's; or None.

        Raises ValueError for a camera_info that is not usable.
        """
        namespace = self._namespace.get(name, name)
        info = self._infos.get((namespace, bottom))
        calibration = None if info is None else calibration_from_info(info, namespace)
        if calibration is None and not bottom:
            calibration = self._fleet_calibrations.get(namespace)
        return calibration

    def mount(self, name, bottom=False):
        """CameraMount of a vehicle's camera (namespace or template)."""
        return BOTTOM_MOUNT if bottom else self._mounts.get(self._namespace.get(name, name), FRONT_MOUNT)

    def landmarks(self, from_fleet=False):
        """{name: place (3,) [m], cortex frame} of the landmarks.

        from_fleet: their places are those of the fleet file (that is where the virtual lab puts them), not what
        motion capture measured.
        """
        if from_fleet:
            return {landmark.name: np.array(landmark.position_m) for landmark in self._fleet.landmarks}
        return {name: np.nanmedian(rows.table(), axis=0) for name, rows in self._landmarks.items()}

    def discs(self, from_fleet=False):
        """The landmarks, as a list of Disc named by template. from_fleet: see `landmarks`."""
        places = self.landmarks(from_fleet)
        return [self.catalogue.disc(name, place, self._normal(name, place)) for name, place in sorted(places.items())]

    def hulls(self, topic, time_s, without=""):
        """The vehicles at a time, as a list of Hull; those whose pose is not known then are left out."""
        hulls = []
        for name, track in self.tracks[topic].items():
            template = self._templates.get(name)
            if name == without or (template is not None and template.kind != "vehicle"):
                continue
            poses = track.at(time_s)
            if poses.known[0]:
                hulls.append(Hull(name, poses.positions_m[0], poses.R_body_to_cortex[0]))
        return hulls

    def _keep_rims(self, message):
        for body in message.Obj:
            template = self._templates.get(body.name)
            if template is None or template.kind != "landmark" or len(body.marker) != len(template.markers_m):
                continue
            frames, total = self._rims.get(body.name, (0, 0.0))
            if frames < _MARKER_FRAMES:
                markers_m = np.array([(marker.x, marker.y, marker.z) for marker in body.marker])
                if np.all(np.abs(markers_m) < 100.0):  # False for NaN, too
                    self._rims[body.name] = (frames + 1, total + markers_m)

    def _normal(self, name, place):
        """Unit vector (3,) out of the painted side, cortex frame; None when nothing tells.

        The plane is that of the markers on the rim, as measured or else as in the template; which of its sides is
        painted says the fleet file, else it is the one towards the middle of the arena.
        """
        towards = -np.asarray(place, dtype=float) * (1.0, 1.0, 0.0)
        facing = {landmark.name: landmark.facing_rad for landmark in self._fleet.landmarks} if self._fleet else {}
        if facing.get(name) is not None:
            towards = np.array([np.cos(facing[name]), -np.sin(facing[name]), 0.0])
        if name in self._rims:
            frames, total = self._rims[name]
            markers_m = total / frames
        elif name in facing:
            return tuple(towards)
        elif name in self._templates:
            markers_m = self._templates[name].markers_m
        else:
            return None
        if len(markers_m) < 3:
            return None
        normal = np.linalg.svd(markers_m - markers_m.mean(axis=0))[2][2]
        return tuple(-normal if normal @ towards < 0.0 else normal)
