"""Surroundings of the cameras, from a bag: poses of vehicles, places of landmarks, calibrations and mounts."""

import math
from collections import defaultdict

import numpy as np

from data_extraction.camera_topics import is_bottom
from data_extraction.flatten import seconds
from data_extraction.report.recorded_topics import Collector, vehicle_of
from data_extraction.samples import Samples
from risc_estimation.bearings import calibration_from_info
from risc_estimation.expected_bearings import Hull
from risc_estimation.pose_track import PoseTrack
from risc_lab.lab.calibration import BOTTOM_MOUNT, load_calibration, load_mount
from risc_lab.lab.fleet import laboratory_vehicles
from risc_lab.lab.landmark_catalogue import load_landmark_catalogue
from risc_lab.lab.templates import load_templates

CAMERA_INFO = "/camera_info"
LANDMARKS, MOCAP = "/states3", "/mocap_data"
_MARKER_FRAMES = 200  # enough to average the noise of the markers
_LANDMARK_ROWS = 60_000  # five minutes at 200 Hz; what stands still needs no more


class Surroundings(Collector):
    """Takes the messages of a bag one by one; query it afterwards."""

    ends = (CAMERA_INFO,)

    def __init__(self, fleet=None, states_topics=("/cortex_raw",)):
        """fleet: risc_lab.lab.Fleet; None = the original laboratory's names, no calibrations.

        states_topics: which topics say where vehicles are. Raises ValueError for calibrations, mounts, templates or a
        landmarks file that are not usable.
        """
        self.topics = (*states_topics, LANDMARKS, MOCAP)
        vehicles = fleet.vehicles if fleet else laboratory_vehicles()
        self._template = {vehicle.namespace: vehicle.template for vehicle in vehicles}
        self._cameras = {
            v.template: (v.namespace, load_calibration(v.calibration), load_mount(v.camera_mount)) for v in vehicles
        }
        self._placed = {landmark.name: landmark for landmark in fleet.landmarks} if fleet else {}
        self._templates = load_templates(fleet=fleet)
        self._others = {name for name, template in self._templates.items() if template.kind != "vehicle"}
        self.catalogue = load_landmark_catalogue()
        self.tracks = {topic: defaultdict(PoseTrack) for topic in states_topics}
        self._landmarks = defaultdict(lambda: Samples(3, _LANDMARK_ROWS))
        self._rims = defaultdict(list)  # name -> positions (n, 3) of the markers in each of its first frames
        self._infos = {}  # (namespace or "", is bottom) -> CameraInfo

    def __call__(self, topic, _receipt_s, message):
        """Take one message; topics that are not needed are ignored."""
        if topic in self.tracks:
            stamp_s = seconds(message.header.stamp)
            for state in message.Obj:
                if state.visible:
                    angles_rad = (math.radians(state.phi), math.radians(state.theta), math.radians(state.psi))
                    self.tracks[topic][state.name].append(stamp_s, (state.x, state.y, state.z), angles_rad)
        elif topic == LANDMARKS:
            for landmark in message.Obj:
                self._landmarks[landmark.name].append((landmark.x, landmark.y, landmark.z))
        elif topic == MOCAP:
            for body in message.Obj:
                self._keep_rim(body)
        elif topic.endswith(CAMERA_INFO):
            self._infos[vehicle_of(topic, 2, ""), is_bottom(message)] = message

    def vehicle(self, name):
        """Mocap template of a vehicle that is named by its namespace or by its template. Raises ValueError.

        "" (topics without a namespace) is the only vehicle of a fleet of one.
        """
        if name in self._cameras:
            return name
        if name in self._template:
            return self._template[name]
        if not name and len(self._template) == 1:
            return next(iter(self._cameras))
        raise ValueError(
            "no vehicle has the namespace '%s'; known are %s: give the fleet file of this flight"
            % (name, ", ".join("%s (%s)" % item for item in self._template.items()))
        )

    def camera(self, vehicle, bottom=False):
        """(CameraCalibration or None, CameraMount) of a vehicle's camera; calibration: camera_info, else the fleet's.

        vehicle: template. Raises ValueError for a camera_info that is not usable.
        """
        namespace, calibration, mount = self._cameras[vehicle]
        info = self._infos.get((namespace, bottom))
        of_bag = calibration_from_info(info, namespace) if info is not None else None
        return (of_bag, BOTTOM_MOUNT) if bottom else (of_bag or calibration, mount)

    def landmarks(self, from_fleet=False):
        """{name: place (3,) [m], cortex frame} of the landmarks.

        from_fleet: use the places in the fleet file (that is where the virtual lab puts them), not those that motion
        capture measured.
        """
        if from_fleet:
            return {name: np.array(landmark.position_m) for name, landmark in self._placed.items()}
        return {name: np.nanmedian(rows.table(), axis=0) for name, rows in self._landmarks.items()}

    def discs(self, from_fleet=False):
        """The landmarks, as a list of Disc named by template. from_fleet: see `landmarks`."""
        places = self.landmarks(from_fleet)
        return [self.catalogue.disc(name, place, self._normal(name, place)) for name, place in sorted(places.items())]

    def hulls(self, topic, time_s, without=""):
        """The vehicles at a time, as a list of Hull; those whose pose is not known then are left out."""
        names = [name for name in self.tracks[topic] if name != without and name not in self._others]
        poses = ((name, self.tracks[topic][name].at(time_s)) for name in names)
        return [Hull(name, p.positions_m[0], p.R_body_to_cortex[0]) for name, p in poses if p.known[0]]

    def _keep_rim(self, body):
        template, rims = self._templates.get(body.name), self._rims[body.name]
        if template is not None and template.kind == "landmark" and len(rims) < _MARKER_FRAMES:
            markers_m = np.array([(marker.x, marker.y, marker.z) for marker in body.marker])
            if markers_m.shape == template.markers_m.shape and np.all(np.abs(markers_m) < 100.0):  # False for NaN, too
                rims.append(markers_m)

    def _normal(self, name, place):
        """Unit vector (3,) out of the painted side, cortex frame; None when unknown.

        The plane is that of the rim markers as measured, else that in the fleet file, else that of the template's
        markers. The fleet file says which side is painted, else it is the one towards the middle of the arena.
        """
        towards = -np.asarray(place, dtype=float) * (1.0, 1.0, 0.0)
        facing_rad = self._placed[name].facing_rad if name in self._placed else None
        if facing_rad is not None:
            towards = np.array([np.cos(facing_rad), -np.sin(facing_rad), 0.0])
        if self._rims.get(name):
            markers_m = np.mean(self._rims[name], axis=0)
        elif name in self._placed:
            return tuple(towards)
        elif name in self._templates:
            markers_m = self._templates[name].markers_m
        else:
            return None
        if len(markers_m) < 3:
            return None
        normal = np.linalg.svd(markers_m - markers_m.mean(axis=0))[2][2]
        return tuple(-normal if normal @ towards < 0.0 else normal)
