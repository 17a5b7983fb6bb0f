"""What a soak receives from its graph beyond `watch.Watch`, and its requests in place of a person in the lab."""

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
    """Records what happens; the main thread reads it.

    out: {namespace: reason} of vehicles that are out of the flight.  batteries_pct: {namespace: charge}.
    safe: outcomes that are allowed by the faults of this flight that have begun; None: none has begun.
    crashes, errors: queues of what was not read yet: Crash; (node, text).
    """

    def __init__(self, namespaces):
        self.out, self.batteries_pct, self.safe, self._states = {}, {}, None, {}
        self.crashes, self.errors = collections.deque(), collections.deque(maxlen=1000)
        self._over, self._newest = {}, {}  # {topic: newest fault id}, of earlier flights and of all
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
        """Namespaces of vehicles whose last report says that they are in the air."""
        return [name for name, state in self._states.items() if state not in ON_GROUND and state not in NO_EVIDENCE]

    def begin_flight(self):
        """Begin a flight: faults that began up to now belong to earlier flights."""
        self._over, self.safe = dict(self._newest), None

    def fly_again(self):
        """Ask the operator for another flight. Returns "", or why that failed."""
        return _ask("/operator/fly_again", Trigger)

    def end_faults(self):
        """End all faults. Returns "", or why that failed."""
        return _ask("/virtual_lab/inject", InjectFault)

    def put_back(self, namespace):
        """Pick a vehicle up and stand it at its start. Returns "", or why that failed."""
        return _ask("/virtual_lab/put_back", PutBack, namespace)


def _ask(service, kind, *arguments):
    """Call a service that answers success and message. Returns "", or why it failed. Never blocks for long."""
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
