#!/usr/bin/env python3
"""cortex_raw, states3 -> angles_synthetic (Observed_angles). Wiring only; see risc_estimation.synthetic_bearings."""

import threading
import time

import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Header

from risc_estimation.bearings import make_camera
from risc_estimation.expected_bearings import Observer
from risc_estimation.ros.bearing_conversions import observed_angles, states_from_msg
from risc_estimation.ros.conversions import FRAME_ID
from risc_estimation.ros.params import SyntheticNodeParams
from risc_estimation.synthetic_bearings import SyntheticBearings, SyntheticParams
from risc_lab.lab.calibration import load_calibration, load_mount
from risc_lab.lab.landmark_catalogue import load_landmark_catalogue
from risc_lab.ros.diagnostics import Growth, add_all, age_text, is_silent, summarise, ticking_updater
from risc_lab.ros.guard import subscribe
from risc_lab.ros.node import run
from risc_lab.ros.params import load_params, vehicles
from risc_msgs.msg import Cortex, Landmarks, Observed_angles


class SyntheticAnglesNode:
    """What the vehicles' cameras would see of the landmarks and of each other, from motion capture."""

    def __init__(self):
        self._params, synthetic_params = load_params(SyntheticNodeParams, SyntheticParams)
        fleet = vehicles()
        self._namespace = {vehicle.template: vehicle.namespace for vehicle in fleet}
        self._catalogue = load_landmark_catalogue()
        self._region = self._catalogue.region_of_template
        observers = {vehicle.template: self._observer(vehicle) for vehicle in fleet}
        self._blind = sorted(self._namespace[name] for name, observer in observers.items() if observer is None)
        if self._blind:
            rospy.logwarn(
                "%s: no calibration, so nothing is seen: give `calibration` in the fleet file, or default_calibration",
                ", ".join(self._blind),
            )
        self._synthetic = SyntheticBearings(observers, synthetic_params)
        self._lock = threading.Lock()  # states, landmarks and diagnostics have a thread each
        self._pictures, self._last_s = 0, None
        self._growth = Growth()
        self._pub = rospy.Publisher("angles_synthetic", Observed_angles, queue_size=10, tcp_nodelay=True)
        ticking_updater().add("synthetic angles", self._diagnose)
        subscribe("states3", Landmarks, self._on_landmarks, queue_size=1)
        subscribe("cortex_raw", Cortex, self._on_states, queue_size=100)

    def _observer(self, vehicle):
        calibration = load_calibration(vehicle.calibration or self._params.default_calibration)
        return calibration and Observer(make_camera(calibration, False), load_mount(vehicle.camera_mount))

    def _on_landmarks(self, msg):
        # states3 has the position of a disc, not its orientation: it is assumed to face every camera
        discs = [
            self._catalogue.disc(self._region.get(entry.name, entry.name), (entry.x, entry.y, entry.z))
            for entry in msg.Obj
        ]
        with self._lock:
            self._synthetic.see_landmarks(discs)

    def _on_states(self, msg):
        with self._lock:
            due = self._synthetic.update(msg.header.stamp.to_sec(), states_from_msg(msg))
            self._pictures += len(due)
            self._last_s = time.monotonic()
        for stamp_s, pictures in due:
            header = Header(stamp=rospy.Time.from_sec(stamp_s), frame_id=FRAME_ID)
            named = []
            for item in pictures:
                quads = [quad._replace(name=self._called(quad.name)) for quad in item.quads]
                named.append((self._called(item.vehicle), item.landmarks, quads))
            self._pub.publish(observed_angles(header, named))

    def _called(self, template):
        """Name of a vehicle in vision messages: its namespace."""
        return self._namespace.get(template, template)

    def _diagnose(self, status):
        with self._lock:
            pictures, last_s = self._pictures, self._last_s
        _, rates_hz = self._growth({"pictures": pictures})
        summarise(
            status,
            (is_silent(last_s), DiagnosticStatus.WARN, "nothing on " + rospy.resolve_name("cortex_raw")),
            (self._blind, DiagnosticStatus.WARN, "no camera of " + ", ".join(self._blind)),
            (True, DiagnosticStatus.OK, "angles are published"),
        )
        add_all(status, {"rate [Hz]": "%.1f" % rates_hz["pictures"], "age of last states [s]": age_text(last_s)})
        return status


if __name__ == "__main__":
    run("synthetic_angles", SyntheticAnglesNode)
