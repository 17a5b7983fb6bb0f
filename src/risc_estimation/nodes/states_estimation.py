#!/usr/bin/env python3
"""mocap_data (Mocap_data), mocap_unidentified (UnidentifiedMarkers) -> cortex_raw (Cortex), states3 (Landmarks),
cortex_raw_status (BodyStatuses).

With subscribers also mocap_poses (BodyPoses) and state_covariances (StateCovariances, if the filter has them). If the
filter wants them, subscribes to on-board measurements and commands that were sent. See risc_estimation.state_estimator.
"""

import rospy
from rospy.numpy_msg import numpy_msg

from risc_estimation.filters import DEFAULT, REGISTRY
from risc_estimation.pose_fit import NOTHING, PoseFitParams
from risc_estimation.ros.conversions import BodyPosesArrays, covariances_to_msg, poses_to_msg
from risc_estimation.ros.estimator_node import EstimatorNode, filter_kind, refusals
from risc_estimation.ros.params import NodeParams
from risc_estimation.state_estimator import StatesEstimator
from risc_lab.lab.templates import load_templates
from risc_lab.ros import low_latency
from risc_lab.ros.fleet_messages import LandmarksArrays, MocapArrays
from risc_lab.ros.guard import subscribe
from risc_lab.ros.node import run
from risc_lab.ros.params import known_arena, known_fleet, load_params
from risc_maap_msgs.msg import Counter, EstimatorStatus, MarkerCount, StateCovariances, UnidentifiedMarkers

_LOOSE_MOST = 128  # frames whose unlabelled markers are kept: more than can wait
_MATE_S = 0.001  # how long a frame waits for its unlabelled markers, which come on another connection


class StatesEstimationNode(EstimatorNode):
    """Markers to states."""

    INPUT = "mocap frames"

    def __init__(self):
        (name, kind), fleet = filter_kind(DEFAULT), known_fleet()
        params, fit_params, settings = load_params(
            NodeParams, PoseFitParams().within(known_arena()), REGISTRY.settings(name, kind.PARAMS)
        )
        types = {vehicle.template: vehicle.vehicle_type for vehicle in (fleet.vehicles if fleet else ())}
        templates = load_templates(params.templates_file or None, fleet)
        estimator = StatesEstimator(templates, fit_params, params.vehicles or list(types), kind(settings), types)
        super().__init__(estimator, kind, params, fleet, "cortex_raw")
        self._landmarks_pub = rospy.Publisher("states3", LandmarksArrays, queue_size=100, tcp_nodelay=True)
        self._poses_pub = rospy.Publisher("mocap_poses", BodyPosesArrays, queue_size=100, tcp_nodelay=True)
        self._covariances_pub = rospy.Publisher("state_covariances", StateCovariances, queue_size=100, tcp_nodelay=True)
        self._report_pub = rospy.Publisher("estimator_status", EstimatorStatus, queue_size=10, tcp_nodelay=True)
        self._frame = MocapArrays()
        self._loose = {}  # {stamp [ns]: (u, 3) [m]} of the newest frames: markers without a label
        self._told_exchanged = set()
        kind = numpy_msg(UnidentifiedMarkers)
        subscribe("mocap_unidentified", kind, self._on_unidentified, queue_size=100)
        self.listen("mocap_data", MocapArrays.Raw)

    def _on_unidentified(self, message):
        with self.lock:
            stamp_ns = message.header.stamp.to_nsec()
            self._loose.pop(stamp_ns, None)  # so that the newest come last
            self._loose[stamp_ns] = message.positions.reshape(-1, 3)
            while len(self._loose) > _LOOSE_MOST:
                del self._loose[next(iter(self._loose))]
            self.lock.notify_all()

    def _loose_of(self, stamp):
        """(u, 3) unlabelled markers of the frame with this stamp [m], as far as they have come."""
        stamp_ns, newest_ns = stamp.to_nsec(), next(reversed(self._loose), -1)
        lately = 0 < stamp_ns - newest_ns < 2e9 * self.period_s  # the frame before had some
        if lately and self.estimator.misses_a_body:
            self.lock.wait_for(lambda: next(reversed(self._loose)) >= stamp_ns, _MATE_S)
        return self._loose.get(stamp_ns, NOTHING)

    def _on_frame(self, message):
        with self.lock:
            frame = self._frame.deserialize(message.buff)
            header = frame.header
            self.count(header)
            loose_m = self._loose_of(header.stamp)
            estimate = self.estimator.update(header.stamp.to_sec(), frame.layout.entries, frame.markers_m, loose_m)
            if not self.estimated(header, estimate):
                return
            self._landmarks_pub.publish(self._messages.landmarks(header, estimate))
            if self._poses_pub.get_num_connections():
                self._poses_pub.publish(poses_to_msg(header, self.estimator.poses))
            if self._covariances_pub.get_num_connections():
                covariances = self.estimator.covariances()
                if covariances is not None:
                    self._covariances_pub.publish(covariances_to_msg(header, estimate.names, covariances))

    def tell(self, report):
        with self.lock:
            poses = self.estimator.poses
            seen = zip(poses.names, poses.marker_counts, poses.present.tolist())
            markers = [MarkerCount(name, *counts) for name, counts, is_present in seen if is_present]
        told = EstimatorStatus(
            rate_hz=report.rate_hz,
            age_s=report.age_s,
            vehicles=len(report.names),
            visible=report.visible,
            frames=report.counts.frames,
            passed_over=report.passed_over,
            counters=[Counter(*item) for item in refusals(report.counts).items()],
            markers=markers,
            unknown_bodies=sorted(report.counts.unknown),
        )
        told.header.stamp = rospy.Time.now()
        self._report_pub.publish(told)
        for pair in set(report.counts.exchanged) - self._told_exchanged:
            self._told_exchanged.add(pair)
            rospy.logwarn("motion capture labels '%s' as '%s': both are told apart. Correct the names there", *pair)


if __name__ == "__main__":
    run("Mocap_State_Estimator", StatesEstimationNode, low_latency.start, low_latency.spin)
