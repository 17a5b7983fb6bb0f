"""Base class of all picture nodes: newest picture in, `process`, results out.

A node is a class with `process`; see nodes/edge_drone for the shortest one.
"""

import abc
import threading
from dataclasses import replace

import cv2
import rospy
from cv_bridge import CvBridge
from dynamic_reconfigure.server import Server
from sensor_msgs.msg import Image

from risc_lab.ros.diagnostics import ticking_updater
from risc_lab.ros.node import run as run_node
from risc_lab.ros.params import load_params
from risc_lab.ros.ticker import Ticker
from risc_msgs.msg import Observed_rois, Risc_roi, Risc_rois
from risc_visual.vision.ros.picture_reader import PictureReader

_BRIDGE = CvBridge()
_LOOK_S = 0.25  # between two checks for subscribers


class PictureNode(abc.ABC):
    """Subscribes to pictures while a result has a subscriber, and calls `process` with the newest one."""

    def __init__(self, topic, outputs, settings_class, config_type=None, rate_hz=0.0):
        """topic: of the pictures.  outputs: dict topic -> encoding of a picture, or a message class.

        settings_class: Settings of private parameters.  config_type: of dynamic_reconfigure, with fields of the same
        names; None: fixed settings.  rate_hz: of pictures, at most; 0: all.  Raises ValueError that names a wrong
        parameter.
        """
        self.lock = threading.Lock()  # held while `process` runs: for what other callbacks share with it
        self._encodings = {name: kind for name, kind in outputs.items() if isinstance(kind, str)}
        self.settings = load_params(settings_class)[0]
        self.use(self.settings)
        if config_type is not None:
            # The server takes existing parameters unchecked: a number of the wrong type would end it.
            for key, value in vars(self.settings).items():
                rospy.set_param("~" + key, value)
            self._server = Server(config_type, self._on_reconfigure)
        name = rospy.get_name().rsplit("/", 1)[-1]
        self._reader = PictureReader(topic, self._work, ticking_updater(), name, rate_hz)
        self._publishers = {
            name: rospy.Publisher(name, Image if isinstance(kind, str) else kind, queue_size=1)
            for name, kind in outputs.items()
        }
        Ticker(_LOOK_S, self._follow_demand, "the demand for results")

    # -------- to be implemented by a node

    def use(self, settings):  # noqa: B027 - not every node has settings
        """Take new settings; called at the start and by dynamic_reconfigure. Raises ValueError to refuse them."""

    @abc.abstractmethod
    def process(self, picture, header):
        """Work on one picture (h, w, 3), blue green red, and `publish`; it may be drawn on."""

    # -------- to be used by a node

    def wanted(self, name):
        """Whether this output has a subscriber."""
        return self._publishers[name].get_num_connections() > 0

    def publish(self, name, value, header):
        """Send a picture (array) or a message, when it has a subscriber."""
        if not self.wanted(name):
            return
        if name in self._encodings:
            value = _BRIDGE.cv2_to_imgmsg(value, self._encodings[name])
            value.header = header
        self._publishers[name].publish(value)

    # -------- internal

    def _follow_demand(self):
        demanded = any(map(self.wanted, self._publishers))
        if demanded != self._reader.is_open:
            (self._reader.open if demanded else self._reader.close)()

    def _work(self, picture, header):
        with self.lock:
            self.process(picture, header)

    def _on_reconfigure(self, config, _level):
        """New settings while running; impossible ones change nothing."""
        names = set(vars(self.settings)) & set(config)
        try:
            wanted = replace(self.settings, **{name: config[name] for name in names})
            with self.lock:
                self.use(wanted)
                self.settings = wanted
        except ValueError as error:
            rospy.logerr("%s: settings rejected: %s", rospy.get_name(), error)
            config.update({name: getattr(self.settings, name) for name in names})
        return config


def rois_msg(header, regions):
    """risc_msgs/Observed_rois of `drawing.Region`s; the observer is the node's namespace, or "camera"."""
    observer = rospy.get_namespace().strip("/") or "camera"
    found = [Risc_roi(r.name, True, round(r.x), round(r.y), r.width, r.height, r.angle_deg) for r in regions]
    return Observed_rois(header, [Risc_rois(observer, found, [])])


def run(name, node_class):
    """Run a node until shutdown; wrong parameters end it with one line."""
    cv2.setNumThreads(1)  # the flight needs the other cores
    run_node(name, node_class)
