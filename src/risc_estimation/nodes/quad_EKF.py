#!/usr/bin/env python3
"""mocap_poses (BodyPoses) -> cortex_ekf (Cortex), cortex_ekf_status (BodyStatuses): the extended Kalman filter as a
node of its own, for the whole fleet, beside the states of cortex_raw.

Also subscribes to on-board measurements and commands that were sent. With subscribers it also publishes ekf_acc
(PointStamped, the acceleration by the model, cortex axes) and position_cov (TwistStamped, position and its variances)
of the first vehicle, and the same for each vehicle in its namespace.
"""

import math

import rospy
from geometry_msgs.msg import PointStamped, TwistStamped

from risc_estimation.filters import REGISTRY
from risc_estimation.ros.conversions import BodyPosesArrays, acceleration_to_msg, poses_from_msg, position_cov_to_msg
from risc_estimation.ros.estimator_node import EstimatorNode, filter_kind
from risc_estimation.ros.params import EkfNodeParams, NodeParams
from risc_estimation.state_estimator import PosesEstimator
from risc_lab.lab.templates import load_templates
from risc_lab.lab.vehicle_types import LEGACY_PARAMETERS
from risc_lab.ros import low_latency
from risc_lab.ros.node import run
from risc_lab.ros.params import known_fleet, load_params, told_vehicle_type

_FILTER = "ekf"
# Parameters of the original: inertia and gains of its only airframe.
_LOOPS = ("Ixx", "Iyy", "Izz", "roll_kp", "roll_ki", "roll_kd", "pitch_kp", "pitch_ki", "pitch_kd", "yaw_kp", "yaw_kg")
_SOONER = 0.999  # of a period: stamps have jitter


class EkfNode(EstimatorNode):
    """Raw poses to states."""

    INPUT = "raw poses (mocap_poses)"

    def __init__(self):
        (name, kind), fleet, private = filter_kind(_FILTER), known_fleet(), rospy.get_param("~", {})
        params, own, settings = load_params(
            NodeParams(filter=name),
            EkfNodeParams,
            REGISTRY.settings(name, kind.PARAMS),
            known=(*LEGACY_PARAMETERS, *_LOOPS),
        )
        unread = [key for key in _LOOPS if key in private]
        if unread:
            rospy.logwarn(
                "%s: not read. Inertia and gains are the loops roll, pitch and yaw_rate_time_constant_s of each "
                "vehicle's type (risc_lab/config/vehicle_types): set them there",
                ", ".join(map(rospy.resolve_name, ("~" + key for key in unread))),
            )
        vehicles = fleet.vehicles if fleet else ()
        types = {vehicle.template: told_vehicle_type(vehicle, private) for vehicle in vehicles}
        templates = load_templates(params.templates_file or None, fleet)
        estimator = PosesEstimator(templates, params.vehicles or list(types), kind(settings), types)
        super().__init__(estimator, kind, params, fleet, "cortex_ekf")
        self._least_s = _SOONER / own.publish_hz if own.publish_hz > 0.0 else 0.0
        self._told_s = -math.inf  # stamp of the newest accelerations and covariances
        namespaces = {vehicle.template: "/%s/" % vehicle.namespace for vehicle in vehicles}
        self._accelerations, self._covariances = (
            [
                (name, rospy.Publisher(prefix + topic, message, queue_size=10, tcp_nodelay=True))
                for name, prefix in (("", ""), *namespaces.items())  # "": the first vehicle
            ]
            for topic, message in (("ekf_acc", PointStamped), ("position_cov", TwistStamped))
        )
        self._frame = BodyPosesArrays()
        self.listen("mocap_poses", BodyPosesArrays.Raw)

    def _on_frame(self, message):
        with self.lock:
            header = self._frame.deserialize(message.buff).header
            self.count(header)
            estimate = self.estimator.update(header.stamp.to_sec(), poses_from_msg(self._frame))
            if self.estimated(header, estimate) and not 0.0 <= estimate.stamp_s - self._told_s < self._least_s:
                self._told_s = estimate.stamp_s
                self._tell_more(header, estimate)

    def _tell_more(self, header, estimate):
        """Publish accelerations and covariances of the visible vehicles, where there are subscribers."""
        for publishers, known, to_msg in (
            (self._accelerations, self.estimator.accelerations, acceleration_to_msg),
            (self._covariances, self.estimator.covariances, position_cov_to_msg),
        ):
            heard = [(name, publisher) for name, publisher in publishers if publisher.get_num_connections()]
            values = known() if heard else None
            if values is None or not estimate.names:
                continue  # no subscribers, no values from the filter, or no bodies
            rows = {name: row for row, name in enumerate(estimate.names) if estimate.visible[row]}
            for name, publisher in heard:
                row = rows.get(name or estimate.names[0])
                message = None if row is None else to_msg(header, estimate.states[row], values[row])
                if message is not None:
                    publisher.publish(message)


if __name__ == "__main__":
    run("EKF", EkfNode, low_latency.start, low_latency.spin)
