"""What the nodes of a flight say, heard by the program that started them."""

import collections
import math
import re
import threading
import time
import xmlrpc.client

import rospy
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import String
from std_srvs.srv import Trigger

CALL_PATIENCE_S = 3.0  # for the operator to take the order


class Watch:
    """What the flight's nodes say, as a ROS node of our own: phase and result of the operator, diagnostics."""

    def __init__(self):
        self.phase = "starting"
        self.result = ""
        self.errors_mm = {}
        self.rate_hz = None
        self.oldest_ms = collections.deque(maxlen=100)  # of the controller's reports
        self.passed_over = collections.deque(maxlen=100)  # of the estimator's reports: frames
        self._operator_s = None  # when the operator's diagnostics last came
        rospy.init_node("maap_fly", disable_signals=True, disable_rostime=True)
        rospy.Subscriber(
            "/operator/phase", String, lambda message: setattr(self, "phase", message.data), tcp_nodelay=True
        )
        rospy.Subscriber(
            "/operator/result", String, lambda message: setattr(self, "result", message.data), tcp_nodelay=True
        )
        rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics, tcp_nodelay=True)

    def _on_diagnostics(self, message):
        for status in message.status:
            if status.name.endswith("virtual operator"):
                self._operator_s = time.monotonic()
            for pair in status.values:
                error_of = re.fullmatch(r"position error of (\S+) \(mm\)", pair.key)
                if error_of:
                    # a new dict: whoever goes through the last one is in another thread
                    self.errors_mm = dict(self.errors_mm, **{error_of.group(1): _number(pair.value)})
                elif pair.key == "oldest state answered (ms)":
                    self._keep(self.oldest_ms, pair.value)
                elif pair.key == "frames passed over":
                    self._keep(self.passed_over, pair.value)
                elif pair.key == "rate [Hz]" and status.name.endswith("mocap stream"):
                    self.rate_hz = _number(pair.value)

    @staticmethod
    def _keep(reports, text):
        value = _number(text)
        if value is not None:
            reports.append(value)

    @property
    def operator_heard(self):
        """Whether the operator has said anything yet."""
        return self._operator_s is not None

    def operator_silent(self, limit_s=5.0):
        """Whether the operator was heard of, and then no more; he reports every second."""
        return self._operator_s is not None and time.monotonic() - self._operator_s > limit_s

    def parameters(self):
        """Content of the parameter server, nested dicts. Raises OSError when the master does not give it."""
        try:
            return rospy.get_param("/")
        except (KeyError, rospy.ROSException, xmlrpc.client.Error) as error:
            raise OSError("the master does not give its parameters: %s" % error) from error

    def land(self):
        """Ask the operator to land everything now. Returns whether he took the order; never blocks for long."""
        taken = threading.Event()

        def call():
            try:
                rospy.ServiceProxy("/operator/land", Trigger)()
            except rospy.ServiceException as error:
                rospy.logwarn("the operator's land service failed: %s", error)
                return
            taken.set()

        threading.Thread(target=call, daemon=True).start()  # a hanging operator must not make Ctrl-C hang
        return taken.wait(CALL_PATIENCE_S)


def _number(text):
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
