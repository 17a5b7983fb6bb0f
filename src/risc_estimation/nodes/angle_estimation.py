#!/usr/bin/env python3
"""detections, or land_rois where only these come -> angles. Wiring only; see risc_estimation.bearings."""

import sys
import threading
import time

import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from risc_estimation.bearings import ImageSource, bearings_of_regions
from risc_estimation.ros.bearing_conversions import observed_angles, regions_from_msg
from risc_estimation.ros.cameras import VehicleCameras
from risc_estimation.ros.conversions import header_for
from risc_estimation.ros.params import AngleParams
from risc_lab.ros.diagnostics import Growth, age_text, make_updater
from risc_lab.ros.params import fleet_vehicles, load_params
from risc_lab.ros.ticker import Ticker
from risc_maap_msgs.msg import Detections
from risc_msgs.msg import Observed_angles, Observed_rois

_SILENCE_S = 3.0


class AngleEstimationNode:
    """Answers every image with one message of the same stamp; names pass through."""

    def __init__(self):
        params = load_params(AngleParams)[0]
        self._cameras = VehicleCameras(fleet_vehicles(), params.rectified, params.camera, params.default_calibration)
        self._lock = threading.Lock()  # both topics and the diagnostics have a thread each
        self._pictures, self._exact, self._found, self._refused = 0, 0, 0, 0
        self._last_s = None  # monotonic clock
        self._growth = Growth()
        self._pub = rospy.Publisher("angles", Observed_angles, queue_size=10, tcp_nodelay=True)
        self._diagnostics = make_updater("none")
        self._diagnostics.add("angle estimation", self._diagnose)
        Ticker(1.0, self._diagnostics.force_update, "the diagnostics")
        self._source = ImageSource()
        rospy.Subscriber("detections", Detections, self._on_detections, queue_size=10, tcp_nodelay=True)
        rospy.Subscriber("land_rois", Observed_rois, self._on_rois, queue_size=10, tcp_nodelay=True)

    def _on_detections(self, msg):
        self._answer(msg.header, [msg], True)

    def _on_rois(self, msg):
        self._answer(msg.header, msg.Obj, False)

    def _answer(self, header, entries, exact):
        """entries: of Detections or Risc_rois, one a vehicle."""
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
            self._pictures += 1
            self._exact += exact
            self._found += found
            self._refused += wanted - found
            self._last_s = time.monotonic()

    def _diagnose(self, status):
        now_s = time.monotonic()
        with self._lock:
            pictures, refused, last_s = self._pictures, self._refused, self._last_s
            found, exact = self._found, self._exact
        new, rates_hz = self._growth({"pictures": pictures, "refused": refused})
        problems = self._cameras.problems()
        if last_s is None or now_s - last_s > _SILENCE_S:
            status.summary(DiagnosticStatus.WARN, "nothing on " + rospy.resolve_name("detections") + " or land_rois")
        elif problems:
            status.summary(DiagnosticStatus.WARN, "no camera of " + ", ".join(sorted(problems)))
        elif new["refused"]:
            status.summary(DiagnosticStatus.WARN, "%d regions have no direction" % new["refused"])
        else:
            status.summary(DiagnosticStatus.OK, "angles are published")
        status.add("rate [Hz]", "%.1f" % rates_hz["pictures"])
        status.add("age of last regions [s]", age_text(last_s))
        status.add("images", str(pictures))
        status.add("images with exact detections", str(exact))
        status.add("angles", str(found))
        status.add("regions without a direction", str(refused))
        for namespace, source in sorted(self._cameras.sources().items()):
            status.add("camera of " + namespace, source)
        for namespace, text in sorted(problems.items()):
            status.add("camera of " + namespace, text)
        return status


def main():
    rospy.init_node("angle_estimation")
    try:
        AngleEstimationNode()
    except ValueError as error:
        rospy.logfatal("angle_estimation.py: %s", error)
        sys.exit(1)
    rospy.spin()


if __name__ == "__main__":
    main()
