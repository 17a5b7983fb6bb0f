"""The frame that all picture nodes share: newest picture in, `process`, results out, health on /diagnostics.

A node is a class with `process`; see nodes/edge_drone for the shortest one.
"""

import abc
import sys
import threading
import time

import cv2
import rospy
from cv_bridge import CvBridge
from diagnostic_msgs.msg import DiagnosticStatus
from dynamic_reconfigure.server import Server
from sensor_msgs.msg import Image

from risc_lab.images import picture_from_msg
from risc_lab.ros.diagnostics import Growth, age_text, make_updater
from risc_lab.ros.paced_subscriber import PICTURES_BYTES
from risc_lab.ros.params import load_params
from risc_lab.ros.ticker import Ticker
from risc_msgs.msg import Observed_rois, Risc_roi, Risc_rois

_SILENCE_S = 3.0
_BRIDGE = CvBridge()


class Demand(rospy.SubscribeListener):
    """Calls back, in a thread of its own, after somebody has begun or ceased to listen to a publisher.

    rospy tells while it holds locks of the publisher, which whoever then counts listeners needs: to do that in rospy's
    thread stops both for ever.
    """

    def __init__(self, on_change):
        self._on_change = on_change
        self._changed = threading.Event()
        threading.Thread(target=self._work, name="demand", daemon=True).start()

    def peer_subscribe(self, _name, _publish, _peer_publish):
        self._changed.set()

    def peer_unsubscribe(self, _name, _number):
        self._changed.set()

    def _work(self):
        while True:
            self._changed.wait()
            self._changed.clear()
            self._on_change()


class PictureNode(abc.ABC):
    """Subscribes to pictures while somebody listens to a result, and calls `process` with the newest one."""

    def __init__(self, topic, outputs, settings_class, config_type=None):
        """topic: of the pictures.  outputs: dict topic -> encoding of a picture, or a message class.

        settings_class: dataclass of private parameters.  config_type: of dynamic_reconfigure, with fields of the same
        names; None: the settings stand.  Raises ValueError that names a wrong parameter.
        """
        self.lock = threading.Lock()  # held while `process` runs: for what other callbacks share with it
        self._demand_lock = threading.Lock()  # another one: listeners may come before the node is ready
        self._counts = {"processed": 0, "refused": 0}
        self._growth = Growth()
        self._last_s, self._longest_s = None, 0.0
        self._subscriber, self._publishers = None, {}
        self._encodings = {name: kind for name, kind in outputs.items() if isinstance(kind, str)}
        self.settings = load_params(settings_class)[0]
        self.use(self.settings)
        if config_type is not None:
            # The server takes what is there as it is: a number of the wrong type would end it.
            for key, value in vars(self.settings).items():
                rospy.set_param("~" + key, value)
            self._server = Server(config_type, self._on_reconfigure)
        self._topic = rospy.resolve_name(topic)
        self._updater = make_updater("none")
        self._updater.add(rospy.get_name().rsplit("/", 1)[-1], self._diagnose)
        Ticker(1.0, self._updater.update, "the diagnostics")
        demand = Demand(self._follow_demand)
        publishers = {}
        for name, kind in outputs.items():
            kind = Image if isinstance(kind, str) else kind
            publishers[name] = rospy.Publisher(name, kind, queue_size=1, subscriber_listener=demand)
        self._publishers = publishers
        self._follow_demand()  # listeners may be there already

    # -------- what a node brings

    def use(self, settings):  # noqa: B027 - not every node has settings
        """Take new settings; called at the start and by dynamic_reconfigure. Raises ValueError to refuse them."""

    @abc.abstractmethod
    def process(self, picture, header):
        """Work on one picture (h, w, 3), blue green red, and `publish`; it may be drawn on."""

    # -------- what a node needs

    def wanted(self, name):
        """Whether somebody listens to this output."""
        return self._publishers[name].get_num_connections() > 0

    def publish(self, name, value, header):
        """Send a picture (array) or a message, when somebody listens."""
        if not self.wanted(name):
            return
        if name in self._encodings:
            value = _BRIDGE.cv2_to_imgmsg(value, self._encodings[name])
            value.header = header
        self._publishers[name].publish(value)

    # -------- the frame

    def _follow_demand(self):
        with self._demand_lock:
            demanded = any(publisher.get_num_connections() for publisher in self._publishers.values())
            if demanded and self._subscriber is None:
                self._last_s = None
                self._subscriber = rospy.Subscriber(
                    self._topic, Image, self._on_image, queue_size=1, buff_size=PICTURES_BYTES, tcp_nodelay=True
                )
            elif not demanded and self._subscriber is not None:
                self._subscriber.unregister()
                self._subscriber = None

    def _on_image(self, message):
        started_s = time.monotonic()
        try:
            picture = picture_from_msg(message)
            with self.lock:
                self.process(picture, message.header)
        except (ValueError, cv2.error) as error:
            self._counts["refused"] += 1
            rospy.logerr_throttle(10.0, "%s: a picture on %s is refused: %s" % (rospy.get_name(), self._topic, error))
            return
        except rospy.ROSException:
            if not rospy.core.is_shutdown_requested():  # else: its topics were closed while it worked
                raise
            return
        self._counts["processed"] += 1
        self._last_s = time.monotonic()
        self._longest_s = max(self._longest_s, self._last_s - started_s)

    def _on_reconfigure(self, config, _level):
        """New settings while running; impossible ones change nothing."""
        names = set(vars(self.settings)) & set(config)
        try:
            wanted = type(self.settings)(**dict(vars(self.settings), **{name: config[name] for name in names}))
            with self.lock:
                self.use(wanted)
                self.settings = wanted
        except ValueError as error:
            rospy.logerr("%s: settings not taken: %s", rospy.get_name(), error)
            config.update({name: getattr(self.settings, name) for name in names})
        return config

    def _diagnose(self, status):
        _, rates_hz = self._growth(self._counts)
        if self._subscriber is None:
            status.summary(DiagnosticStatus.OK, "waiting: nobody listens to a result")
        elif rates_hz["refused"] > 0.0:
            status.summary(DiagnosticStatus.ERROR, "pictures are refused: the log says why")
        elif self._last_s is None or time.monotonic() - self._last_s > _SILENCE_S:
            status.summary(DiagnosticStatus.WARN, "no pictures on %s" % self._topic)
        else:
            status.summary(DiagnosticStatus.OK, "working")
        for what, rate_hz in rates_hz.items():
            status.add("%s (Hz)" % what, "%.1f" % rate_hz)
        status.add("age of the last (s)", age_text(self._last_s))
        status.add("longest work on one (ms)", "%.1f" % (1e3 * self._longest_s))
        self._longest_s = 0.0
        return status


def rois_msg(header, regions):
    """risc_msgs/Observed_rois of `drawing.Region`s; the observer is the node's namespace, or "camera"."""
    observer = rospy.get_namespace().strip("/") or "camera"
    found = [Risc_roi(r.name, True, round(r.x), round(r.y), r.width, r.height, r.angle_deg) for r in regions]
    return Observed_rois(header, [Risc_rois(observer, found, [])])


def run(name, node_class):
    """Run a node until shutdown; wrong parameters end it with one line."""
    rospy.init_node(name)
    cv2.setNumThreads(1)  # the flight needs the other cores
    try:
        node = node_class()
    except ValueError as error:
        rospy.logfatal("%s: %s", rospy.get_name(), error)
        sys.exit(1)
    rospy.spin()
    del node
