"""Topics of a recording: their vehicles, and the types that their messages must have; a name does not guarantee one."""

import functools

from risc_control.vehicles import event_topics

# End of a topic's name -> name of its type without the package, which differs between the lab's releases.
TYPES = {
    "/trajectory": "Trajectories",
    "/trajectory_phase": "TrajectoryPhases",
    "/operator/phase": "OperatorState",
    "/operator/result": "OperatorState",
    "/cortex_raw": "Cortex",
    "/ground_truth": "Cortex",
    "/controls": "Controls",
    "/mocap_data": "Mocap_data",
    "/mocap_time": "MocapTime",
    "/mocap_status": "MocapStatus",
    "/estimator_status": "EstimatorStatus",
    "/node_status": "VehicleNodeStatus",
    "/states3": "Landmarks",
    "/angles": "Observed_angles",
    "/land_rois": "Observed_rois",
    "/detections": "Detections",
    "/camera_info": "CameraInfo",
    "/commands_sent": "CommandsSent",
    "/cmd_vel_stamped": "TwistStamped",
    "/safety": "Safety",
    "/virtual_lab/faults": "Faults",
    "/program_faults": "Faults",
    "/virtual_lab/told": "Told",
    "/virtual_lab/inputs": "Told",
    "/virtual_lab/crash": "Crash",
    "/vehicle_status": "VehicleStatus",
    "/joy": "Joy",
    "/controller_status": "Bool",
    "/rosout": "Log",
}


class Collector:
    """Takes the messages of the wanted topics of a bag one by one, as (topic, time of receipt [s], message).

    Afterwards `result(end_s)` returns what was found; end_s: time of receipt [s] at which the bag ends.
    """

    topics = ()  # names of wanted topics
    ends = ()  # ends of the names of further wanted topics

    def wants(self, topic):
        """Whether messages of this topic are used."""
        return topic in self.topics or ("/" + topic).endswith(self.ends)


class PerName(Collector):
    """Keeps one record per name, of a vehicle or of something else; these records are the result."""

    def __init__(self):
        self.found = {}

    def result(self, _end_s):
        """{name: what was found}."""
        return dict(sorted(self.found.items()))


def expected(topic):
    """Name of the type that a topic must have, without its package; None when any will do."""
    return next((name for end, name in _types().items() if ("/" + topic).endswith(end)), None)


@functools.cache
def _types():
    return TYPES | {"/" + name: topic.message for name, topic in event_topics().items()}


def fits(topic, kind):
    """Whether a topic's messages are what its name says. kind: as std_msgs/msg/Bool; None = of several types."""
    name = expected(topic)
    return name is None or (kind is not None and kind.rpartition("/")[2] == name)


def vehicle_of(topic, levels=1, alone="vehicle"):
    """Vehicle's namespace of a topic: /risc1/safety -> risc1; `alone` when the topic has none.

    levels: parts of the topic's name below the namespace, e.g. 2 for ardrone/navdata.
    """
    parts = topic.strip("/").split("/")
    return parts[0] if len(parts) > levels else alone
