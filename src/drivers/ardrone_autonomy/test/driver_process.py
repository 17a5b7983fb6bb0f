"""A driver node in its own process, for the rostests."""

import itertools
import os
import signal
import subprocess
import time

import roslib.packages
import rospy

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
LIMIT_S = 30.0
_namespaces = ("/fleet%d" % number for number in itertools.count(1))


def wait_for(condition, what):
    deadline_s = time.monotonic() + LIMIT_S
    while not condition():
        if time.monotonic() > deadline_s:
            raise AssertionError("waited %g s for %s" % (LIMIT_S, what))
        time.sleep(0.005)


class Driver:
    """A driver node in its own process and namespace, with publishers and subscribers on its topics.

    drone: a ScriptedDrone, or {name: ScriptedDrone} for one driver of several, whose topics begin with their names.
    params: private parameters besides PARAMS.  environment: variables besides our own.
    group: parameters of the namespace `ardrone` beside the driver.
    """

    def __init__(self, drone, params=None, arguments=(), environment=None, group=None):
        self.namespace = next(_namespaces)
        params = dict(PARAMS, **(params or {}))
        if isinstance(drone, dict):
            own = {self.namespace + "/" + name: {"drone_ip": one.address} for name, one in drone.items()}
            params.update(vehicles={name.strip("/"): value for name, value in own.items()})
        else:
            arguments = ("-ip", drone.address, *arguments)
        rospy.set_param(self.namespace + "/ardrone_driver", params)
        if group:
            rospy.set_param(self.namespace + "/ardrone", group)
        executable = roslib.packages.find_node("ardrone_autonomy", "ardrone_driver")[0]
        self._process = subprocess.Popen(
            [executable, *arguments],
            env=dict(os.environ, ROS_NAMESPACE=self.namespace, **(environment or {})),
        )
        self._publishers = {}
        self._subscribers = {}
        self.received = {}

    @property
    def pid(self):
        """Number of the process."""
        return self._process.pid

    def subscribe(self, topic, message_type):
        """All messages of the topic from now on go to the list received[topic]."""
        messages = self.received[topic] = []
        name = topic if topic.startswith("/") else self.namespace + "/" + topic
        self._subscribers[topic] = rospy.Subscriber(
            name, message_type, messages.append, queue_size=1000, buff_size=1 << 22
        )
        return messages

    def unsubscribe(self, topic):
        """The list of the topic grows no more."""
        self._subscribers.pop(topic).unregister()

    def publish(self, topic, message):
        publisher = self._publishers.get(topic)
        if publisher is None:
            publisher = self._publishers[topic] = rospy.Publisher(
                self.namespace + "/" + topic, type(message), queue_size=10
            )
            wait_for(publisher.get_num_connections, "the driver to subscribe to " + topic)
        publisher.publish(message)

    def call(self, service, service_type, *arguments):
        name = "%s/ardrone/%s" % (self.namespace, service)
        rospy.wait_for_service(name, LIMIT_S)
        return rospy.ServiceProxy(name, service_type)(*arguments)

    def newest(self, topic):
        return self.received[topic][-1] if self.received[topic] else None

    def alive(self):
        return self._process.poll() is None

    def end(self):
        """Ctrl-C; the exit code. Our subscriptions end as well."""
        for topic in list(self._subscribers):
            self.unsubscribe(topic)
        if self.alive():
            self._process.send_signal(signal.SIGINT)
        try:
            return self._process.wait(LIMIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            raise
