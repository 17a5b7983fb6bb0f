"""Which type the messages of a topic must have for the report: a name alone does not say what is in them."""

# Names of the types without their package, which differs between the lab's releases. {topic: name}, {its end: name}
TOPICS = {
    "/trajectory": "Trajectories",
    "/operator/phase": "OperatorState",
    "/operator/result": "OperatorState",
    "/cortex_raw": "Cortex",
    "/ground_truth": "Cortex",
    "/controls": "Controls",
    "/mocap_data": "Mocap_data",
    "/mocap_time": "TimeReference",
    "/states3": "Landmarks",
    "/commands_sent": "CommandsSent",
    "/angles": "Observed_angles",
    "/land_rois": "Observed_rois",
    "/detections": "Detections",
    "/rosout": "Log",
}
ENDS = {
    "/trajectory_phase": "TrajectoryPhases",
    "/estimator_status": "EstimatorStatus",
    "/mocap_status": "MocapStatus",
    "/node_status": "VehicleNodeStatus",
    "/cmd_vel_stamped": "TwistStamped",
    "/camera_info": "CameraInfo",
    "/safety": "Safety",
    "/navdata": "Navdata",
    "/joy": "Joy",
    "/controller_status": "Bool",
    "/takeoff": "Empty",
    "/land": "Empty",
    "/reset": "Empty",
}


def expected(topic):
    """Name of the type that a topic must have, without its package; None when any will do."""
    ends = (name for end, name in ENDS.items() if ("/" + topic).endswith(end))
    return TOPICS.get(topic) or next(ends, None)


def fits(topic, kind):
    """Whether a topic's messages are what its name says. kind: as std_msgs/msg/Bool; None = of several types."""
    name = expected(topic)
    return name is None or (kind is not None and kind.rpartition("/")[2] == name)
