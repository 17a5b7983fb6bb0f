"""What a soak hears of its graph beside `watch.Watch`, and what it asks for: the hands of the person in the lab."""

import collections
import threading

import rospy
from rosgraph_msgs.msg import Log
from std_srvs.srv import Trigger

from data_extraction.report.faults import FAULT_TOPICS
from risc_control.vehicles import NO_EVIDENCE, ON_GROUND
from risc_experiments.ros.watch import Watch
from risc_maap_msgs.msg import Crash, Faults, VehicleStatus
from risc_maap_msgs.srv import InjectFault, PutBack

CALL_PATIENCE_S = 5.0


class SoakWatch(Watch):
    """Notes what happens; the main thread looks at it.

    out: {namespace: why} of vehicles that take no part in the flight any more.  batteries_pct: {namespace: charge}.
    safe: outcomes that faults of this flight allow that have begun; None: none has begun.
    crashes, errors: of what was not looked at yet: Crash; (node, text).
    """

    def __init__(self, namespaces):
        self.out, self.batteries_pct, self.safe, self._states = {}, {}, None, {}
        self.crashes, self.errors = collections.deque(), collections.deque(maxlen=1000)
        self._over, self._newest = {}, {}  # by topic: id of the newest fault of flights before, of all
        super().__init__()
        rospy.Subscriber("/virtual_lab/crash", Crash, self.crashes.append, queue_size=100, tcp_nodelay=True)
        for topic in FAULT_TOPICS:
            rospy.Subscriber(topic, Faults, self._on_faults, topic, queue_size=100, tcp_nodelay=True)
        rospy.Subscriber("/rosout_agg", Log, self._on_log, queue_size=1000, tcp_nodelay=True)
        for name in namespaces:
            rospy.Subscriber("/%s/vehicle_status" % name, VehicleStatus, self._on_status, name, tcp_nodelay=True)

    def _on_operator(self, message):
        super()._on_operator(message)
        self.out = {vehicle.name: vehicle.reason for vehicle in message.out}

    def _on_faults(self, message, topic):
        for record in message.faults:
            self._newest[topic] = max(self._newest.get(topic, 0), record.id)
            if record.active and record.id > self._over.get(topic, 0):
                self.safe = (self.safe or frozenset()) | frozenset(record.safe)

    def _on_log(self, message):
        if message.level >= Log.ERROR:
            self.errors.append((message.name, message.msg))

    def _on_status(self, message, name):
        self.batteries_pct[name], self._states[name] = message.battery_pct, message.state

    @property
    def in_flight(self):
        """Namespaces of vehicles that said last that they are in the air."""
        return [name for name, state in self._states.items() if state not in ON_GROUND and state not in NO_EVIDENCE]

    def begin_flight(self):
        """Faults that began up to now are of the flights before."""
        self._over, self.safe = dict(self._newest), None

    def fly_again(self):
        """Ask the operator for another flight. Returns why not; ""."""
        return _ask("/operator/fly_again", Trigger)

    def end_faults(self):
        """End all faults. Returns why not; ""."""
        return _ask("/virtual_lab/inject", InjectFault)

    def put_back(self, namespace):
        """Pick a vehicle up and stand it at its start. Returns why not; ""."""
        return _ask("/virtual_lab/put_back", PutBack, namespace)


def _ask(service, kind, *arguments):
    """Call a service that says success and message. Returns why it is not done; "". Never blocks for long."""
    answers = []

    def call():
        try:
            answer = rospy.ServiceProxy(service, kind)(*arguments)
            answers.append("" if answer.success else answer.message or "refused")
        except (rospy.ROSException, rospy.ServiceException) as error:
            answers.append("%s: %s" % (service, error))

    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    thread.join(CALL_PATIENCE_S)
    return answers[0] if answers else "%s does not answer within %g s" % (service, CALL_PATIENCE_S)
