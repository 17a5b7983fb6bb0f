"""A driver node in its own process, for the rostests."""

import rospy

from risc_lab.ros.testing import NodeProcess

PARAMS = {
    "settle_time": 0.1,
    "cmd_timeout": 0,  # these tests send single commands
    "euler_angle_max": 0.349066,
    "outdoor": 0,
    "detections": 3,
    "enemy_colors": 3,
    "enable_navdata_demo": True,
    "enable_navdata_magneto": True,
    "tf_prefix": "lab",
    "cov": {"imu_la": [1, 0, 0, 0, 2, 0, 0, 0, 3]},
}


class Driver(NodeProcess):
    """drone: a ScriptedDrone, or {name: ScriptedDrone} for one driver of several, with the names as topic prefixes.
    params: private parameters besides PARAMS.  environment: variables besides those of this process.
    group: parameters of the namespace `ardrone` next to the driver.
    """

    def __init__(self, drone, params=None, arguments=(), environment=None, group=None):
        super().__init__()
        params = dict(PARAMS, **(params or {}))
        if isinstance(drone, dict):
            own = {self.namespace + "/" + name: {"drone_ip": one.address} for name, one in drone.items()}
            params.update(vehicles={name.strip("/"): value for name, value in own.items()})
        else:
            arguments = ("-ip", drone.address, *arguments)
        rospy.set_param(self.namespace + "/ardrone_driver", params)
        if group:
            rospy.set_param(self.namespace + "/ardrone", group)
        self.start("ardrone_autonomy", "ardrone_driver", *arguments, environment=environment)

    @property
    def pid(self):
        """Process id."""
        return self.process.pid

    def call(self, service, service_type, *arguments):
        return super().call("ardrone/" + service, service_type, *arguments)

    def newest(self, topic):
        return self.received[topic][-1] if self.received[topic] else None
