#!/usr/bin/env python3
"""detections, or land_rois where only these come -> angles. Wiring only; see risc_estimation.bearings."""

import threading
import time

import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from risc_estimation.bearings import ImageSource, bearings_of_regions
from risc_estimation.ros.bearing_conversions import observed_angles, regions_from_msg
from risc_estimation.ros.cameras import VehicleCameras
from risc_estimation.ros.conversions import header_for
from risc_estimation.ros.params import AngleParams
from risc_lab.ros.diagnostics import Growth, add_all, age_text, is_silent, summarise, ticking_updater
from risc_lab.ros.guard import subscribe
from risc_lab.ros.node import run
from risc_lab.ros.params import fleet_vehicles, load_params
from risc_maap_msgs.msg import Detections
from risc_msgs.msg import Observed_angles, Observed_rois

EXACT, REFUSED = "images with exact detections", "regions without a direction"  # counted, as diagnostics call them


class AngleEstimationNode:
    """Answers every image with one message of the same stamp; names pass through."""

    def __init__(self):
        params = load_params(AngleParams)[0]
        self._cameras = VehicleCameras(fleet_vehicles(), params.rectified, params.camera, params.default_calibration)
        self._lock = threading.Lock()  # both topics and the diagnostics have a thread each
        self._counts = dict.fromkeys(("images", EXACT, "angles", REFUSED), 0)
        self._last_s = None  # monotonic clock
        self._growth = Growth()
        self._pub = rospy.Publisher("angles", Observed_angles, queue_size=10, tcp_nodelay=True)
        ticking_updater().add("angle estimation", self._diagnose)
        self._source = ImageSource()
        subscribe("detections", Detections, self._on_detections, queue_size=10)
        subscribe("land_rois", Observed_rois, self._on_rois, queue_size=10)

    def _on_detections(self, msg):
        self._answer(msg.header, [msg], True)

    def _on_rois(self, msg):
        self._answer(msg.header, msg.Obj, False)

    def _answer(self, header, entries, exact):
        """entries: Detections or Risc_rois, one per vehicle."""
        with self._lock:
            stamp_ns = header.stamp.to_nsec()
            taken = [entry for entry in entries if self._source.take(entry.name, stamp_ns, exact)]
        if entries and not taken:
            return
        pictures, wanted, found = [], 0, 0
        for entry in taken:
            landmarks, quads = regions_from_msg(entry.landmarks), regions_from_msg(entry.quads)
            bearings = bearings_of_regions(self._cameras[entry.name], landmarks + quads)
            wanted += sum(region.visible for region in landmarks + quads)
            found += sum(bearing.visible for bearing in bearings)
            pictures.append((entry.name, bearings[: len(landmarks)], bearings[len(landmarks) :]))
        self._pub.publish(observed_angles(header_for(header), pictures))
        with self._lock:
            for what, more in (("images", 1), (EXACT, exact), ("angles", found), (REFUSED, wanted - found)):
                self._counts[what] += more
            self._last_s = time.monotonic()

    def _diagnose(self, status):
        with self._lock:
            counts, last_s = dict(self._counts), self._last_s
        new, rates_hz = self._growth(counts)
        problems = self._cameras.problems()
        nothing = "nothing on %s or land_rois" % rospy.resolve_name("detections")
        summarise(
            status,
            (is_silent(last_s), DiagnosticStatus.WARN, nothing),
            (problems, DiagnosticStatus.WARN, "no camera of " + ", ".join(sorted(problems))),
            (new[REFUSED], DiagnosticStatus.WARN, "%d regions have no direction" % new[REFUSED]),
            (True, DiagnosticStatus.OK, "angles are published"),
        )
        add_all(
            status, {"rate [Hz]": "%.1f" % rates_hz["images"], "age of last regions [s]": age_text(last_s), **counts}
        )
        for said in (self._cameras.sources(), problems):
            add_all(status, {"camera of " + name: said[name] for name in sorted(said)})
        return status


if __name__ == "__main__":
    run("angle_estimation", AngleEstimationNode)
