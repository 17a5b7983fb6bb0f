"""Reports of a flight's nodes, received by the program that started them."""

import collections
import contextlib
import math
import threading
import time
import xmlrpc.client

import rospy
from std_srvs.srv import Trigger

from risc_lab.phases import OperatorPhase, OperatorResult
from risc_lab.ros.publisher_updates import init_node
from risc_maap_msgs.msg import ControllerReport, EstimatorStatus, MocapStatus, OperatorState
from risc_maap_msgs.srv import InjectFault

CALL_PATIENCE_S = 5.0  # for the operator to take the order, and for the virtual lab to take a fault
CALL_AGAIN_S = 0.2
HEARD_S = 1.0


class Watch:
    """Receives the reports of the flight's nodes, as a ROS node of our own."""

    def __init__(self):
        self.phase = None  # OperatorPhase; None before the operator has said anything
        self.text = ""  # details of the phase
        self.failure = None  # why the flight failed, "" when it did not; None while it goes on
        self.flight_failed = False  # as a whole, not only vehicles that are out
        self.on_course = False  # whether all have reached it
        self.errors_mm = {}
        self.rate_hz = None
        self.oldest_ms = collections.deque(maxlen=100)  # of the controller's reports
        self.passed_over = collections.deque(maxlen=100)  # of the estimator's reports: frames
        self._refusal, self._answer_due_s = "", math.inf  # of the virtual lab, which is asked for faults
        self._operator_s = self._operator_first_s = None  # when the operator's state came: the last, the first
        init_node("maap_fly", disable_signals=True, disable_rostime=True)
        for topic, kind, callback in (
            ("/operator/phase", OperatorState, self._on_operator),
            ("/controller_report", ControllerReport, self._on_controller),
            ("/estimator_status", EstimatorStatus, self._on_estimator),
            ("/mocap_status", MocapStatus, self._on_mocap),
        ):
            rospy.Subscriber(topic, kind, callback, tcp_nodelay=True)

    def _on_operator(self, message):
        self._operator_s = time.monotonic()
        self._operator_first_s = self._operator_first_s or self._operator_s
        self.phase, self.text, self.on_course = OperatorPhase(message.phase), message.text, message.on_course
        self.flight_failed = message.flight_failed
        self.failure = None if message.result == OperatorResult.RUNNING else message.reason

    def _on_controller(self, message):
        self.oldest_ms.append(1e3 * message.oldest_state_s)
        errors_m = {vehicle.name: vehicle.position_error_m for vehicle in message.vehicles}
        errors_mm = {name: 1e3 * error_m if math.isfinite(error_m) else None for name, error_m in errors_m.items()}
        # a new dict: another thread may be reading the last one
        self.errors_mm = {**self.errors_mm, **errors_mm}

    def _on_estimator(self, message):
        self.passed_over.append(message.passed_over)

    def _on_mocap(self, message):
        self.rate_hz = message.rate_hz

    @property
    def operator_heard(self):
        """Whether the operator has been reporting for a while: by then the other nodes have started, too."""
        return self._operator_first_s is not None and time.monotonic() - self._operator_first_s > HEARD_S

    def operator_silent(self, limit_s):
        """Whether the operator, which reports every second, has reported before but not within limit_s."""
        return self._operator_s is not None and time.monotonic() - self._operator_s > limit_s

    def parameters(self):
        """Content of the parameter server, nested dicts. Raises OSError when the master does not give it."""
        try:
            return rospy.get_param("/")
        except (KeyError, rospy.ROSException, xmlrpc.client.Error) as error:
            raise OSError("the master does not give its parameters: %s" % error) from error

    def inject(self, events):
        """Ask the virtual lab for faults.FaultEvents, counted from now; `fault_problem` tells the result."""
        self._answer_due_s = time.monotonic() + CALL_PATIENCE_S
        threading.Thread(target=self._inject, args=(events,), daemon=True).start()  # the lab may hang

    def _inject(self, events):
        try:
            with contextlib.closing(rospy.ServiceProxy("/virtual_lab/inject", InjectFault, persistent=True)) as ask:
                for event in events:
                    answer = ask(
                        event.fault, event.vehicle, [event.severity], [event.duration_s], event.start_s, event.channel
                    )
                    if not answer.success:
                        self._refusal = answer.message
                        return
        except rospy.ServiceException as error:
            self._refusal = "the virtual lab cannot be asked for faults: %s" % error
            return
        self._answer_due_s = math.inf

    @property
    def fault_problem(self):
        """Why the faults that were asked for do not happen; "" while they still may."""
        late = time.monotonic() > self._answer_due_s
        return self._refusal or ("the virtual lab was asked for faults and does not answer" if late else "")

    def land(self):
        """Ask the operator to land everything now. Returns whether it took the order; never blocks for long."""
        taken, deadline = threading.Event(), time.monotonic() + CALL_PATIENCE_S

        def call():
            while not taken.is_set() and time.monotonic() < deadline:
                try:
                    rospy.ServiceProxy("/operator/land", Trigger)()
                    taken.set()
                except rospy.ServiceException as error:
                    rospy.logwarn("the operator's land service failed: %s", error)
                    time.sleep(CALL_AGAIN_S)

        threading.Thread(target=call, daemon=True).start()  # a hanging operator must not make Ctrl-C hang
        return taken.wait(CALL_PATIENCE_S)
