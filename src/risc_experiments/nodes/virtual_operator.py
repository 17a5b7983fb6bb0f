#!/usr/bin/env python3
"""The virtual operator: flies an experiment by pressing buttons of virtual joysticks; see risc_experiments.operator."""

import contextlib
import threading
import time
import xmlrpc.client
from functools import partial

import rospy
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger, TriggerResponse

from risc_control.vehicles import adapter_class
from risc_experiments.operator import JOY_RATE_HZ, Operator, OperatorParams
from risc_lab.phases import OperatorPhase, OperatorResult, TrajectoryPhase
from risc_lab.ros.diagnostics import make_updater
from risc_lab.ros.direct_connection import send_directly
from risc_lab.ros.fleet_messages import CortexArrays
from risc_lab.ros.guard import subscribe
from risc_lab.ros.paced_subscriber import PacedSubscriber
from risc_lab.ros.params import fleet_vehicles, params_from_dict, vehicles
from risc_lab.ros.publisher_updates import init_node
from risc_lab.ros.ticker import Ticker
from risc_maap_msgs.msg import OperatorState, Safety, TakeoffRefusals, TrajectoryPhases, VehicleOut

BUTTONS, AXES = 12, 8  # enough for every button map here: 11 of the game pad of Appendix C, 12 of 2014
LOOK_RATE_HZ = 5.0  # at which messages of vehicles, their nodes and motion capture are read
SERVICE_TIMEOUT_S = 5.0
_FLIES = "~flies"  # parameter that tells a restarted operator that the one before died in flight


class VirtualOperator:
    """ROS wiring only; risc_experiments.operator makes all decisions."""

    def __init__(self):
        # the node's other parameters may be the vehicle node's, which has the same buttons
        (params,), _ = params_from_dict([OperatorParams], rospy.get_param("~", {}))
        if not fleet_vehicles():
            raise ValueError("there is no parameter /fleet: load a fleet file with <rosparam ns='fleet' file=.../>")
        flown = vehicles()
        wanted = [vehicle.namespace for vehicle in flown]
        self._go_home = rospy.get_param("~trajectory_node", "/trajectory_node") + "/go_home"
        self._home = rospy.ServiceProxy(self._go_home, Trigger, persistent=True)
        self._lock = threading.Lock()
        go_home = partial(start, self._call_home)
        again = rospy.get_param(_FLIES, False)
        self._flies = False  # as stored on the parameter server
        self._operator = Operator(wanted, params, time.monotonic(), go_home, self._start_landing, again)
        self._watched = {vehicle.template: self._operator.vehicles[vehicle.namespace] for vehicle in flown}
        self._landing = set()  # vehicles whose service is being called
        self._said = None  # the last published state, as `_state` returns it
        self._phase = rospy.Publisher("/operator/phase", OperatorState, queue_size=10, latch=True)
        self._result = rospy.Publisher("/operator/result", OperatorState, queue_size=1, latch=True)
        self._joys = {name: rospy.Publisher("/%s/joy" % name, Joy, queue_size=10, tcp_nodelay=True) for name in wanted}
        self._diagnostics = make_updater("none")
        self._diagnostics.add("virtual operator", self._diagnose)
        rospy.Service("~land", Trigger, self._on_land)
        rospy.Service("~fly_again", Trigger, self._on_fly_again)
        paced = partial(PacedSubscriber, rate_hz=LOOK_RATE_HZ)
        for vehicle in flown:
            name, watched = vehicle.namespace, self._operator.vehicles[vehicle.namespace]
            on_report = partial(self._locked(self._on_report), watched)
            adapter_class(vehicle.vehicle_type).watch("/%s/" % name, on_report, paced)
            paced("/%s/controller_status" % name, Bool, self._locked(self._on_status), args=(watched,))
            on_safety = self._locked(self._on_safety)
            subscribe("/%s/safety" % name, Safety, on_safety, watched, queue_size=10)
            topic, on_refusals = "/%s/takeoff_refusals" % name, self._locked(self._on_refusals)
            subscribe(topic, TakeoffRefusals, on_refusals, watched, queue_size=10)
        subscribe("/trajectory_phase", TrajectoryPhases, self._locked(self._on_phases), queue_size=10)
        paced("/cortex_raw", CortexArrays, self._locked(self._on_states))
        rospy.on_shutdown(partial(self._remember, False))
        start(self._connect_home)
        Ticker(1.0 / JOY_RATE_HZ, self._on_tick, "the operator's clock")
        Ticker(1.0, self._diagnostics.force_update, "the diagnostics")

    def _locked(self, note):
        """Wrap a callback so that it runs with the lock held."""

        def callback(message, *args):
            with self._lock:
                note(message, *args)

        return callback

    def _on_states(self, message):
        for name, visible in zip(message.names, message.visible.tolist()):
            if visible and name in self._watched:
                self._watched[name].seen_s = time.monotonic()

    def _on_report(self, watched, status, _driver):
        watched.note_report(status.state, time.monotonic())

    def _on_status(self, message, watched):
        watched.autonomous, watched.status_s = message.data, time.monotonic()

    def _on_safety(self, message, watched):
        watched.safety, watched.safety_reason = message.level, message.reason

    def _on_refusals(self, message, watched):
        watched.refusals = message.reasons

    def _on_phases(self, message):
        for vehicle in message.vehicles:
            if vehicle.name in self._watched:
                self._watched[vehicle.name].trajectory_phase = TrajectoryPhase(vehicle.phase)

    def _on_land(self, _request):
        with self._lock:
            self._operator.request_landing("landing was requested", time.monotonic())
        return TriggerResponse(True, "landing all vehicles")

    def _on_fly_again(self, _request):
        with self._lock:
            problem = self._operator.fly_again(time.monotonic())
            self._say(self._state())
        return TriggerResponse(not problem, problem or "flying again")

    def _on_tick(self):
        with self._lock:
            self._operator.step(time.monotonic())
            pressed = {name: watched.pad.next_buttons(BUTTONS) for name, watched in self._operator.vehicles.items()}
            self._say(self._state())
        stamp = rospy.Time.now()
        for name, buttons in pressed.items():
            joy = Joy(axes=[0.0] * AXES, buttons=buttons)
            joy.header.stamp = stamp
            self._joys[name].publish(joy)

    def _state(self):
        """The current fields of OperatorState, `out` as tuples; the caller holds the lock."""
        told = self._operator
        return told.phase, told.text, told.result, told.reason, told.on_course, told.flight_failed, tuple(told.out)

    def _say(self, state):
        """Publish a state that has changed; the caller holds the lock, so that no older state follows."""
        if state == self._said:
            return
        flies = state[0] != OperatorPhase.WAITING and state[2] == OperatorResult.RUNNING
        if flies != self._flies:
            self._flies = flies
            start(self._remember, flies)
        self._said, before = state, self._said
        self._phase.publish(state_message(state))
        rospy.loginfo("operator: phase %s", self._operator.phase_text)
        _, _, result, reason, *_ = state
        if result != OperatorResult.RUNNING and (before is None or result != before[2]):
            self._result.publish(state_message(state))
            rospy.loginfo("operator: result %s", ": ".join(filter(None, (result.name.lower(), reason))))

    @staticmethod
    def _remember(flies):
        with contextlib.suppress(OSError, rospy.ROSException, xmlrpc.client.Error):  # there is no master
            rospy.set_param(_FLIES, flies)

    @staticmethod
    def _call(service):
        """Call a Trigger service. Returns (success, message). Raises ROSException or ServiceException."""
        rospy.wait_for_service(service, SERVICE_TIMEOUT_S)
        answer = rospy.ServiceProxy(service, Trigger)()
        return answer.success, answer.message

    def _connect_home(self):
        """Call go_home once while all stand, when it has no effect: the connection then works without the master."""
        with contextlib.suppress(rospy.ROSException, rospy.ServiceException):
            rospy.wait_for_service(self._go_home, SERVICE_TIMEOUT_S)
            with self._lock:
                waits = self._operator.phase == OperatorPhase.WAITING
            if waits:
                self._home()

    def _call_home(self):
        try:
            try:
                answer = self._home()
                done, said = answer.success, answer.message
            except rospy.ServiceException:  # the trajectory node was restarted
                done, said = self._call(self._go_home)
            problem = "" if done else said or "refused"
        except (rospy.ROSException, rospy.ServiceException) as error:
            problem = "%s (%s)" % (self._go_home, error)
        with self._lock:
            self._operator.home_called(problem, time.monotonic())

    def _start_landing(self, name):
        """Ask a silent vehicle's node to land it, unless it is being asked; the caller holds the lock."""
        if name not in self._landing:
            self._landing.add(name)
            start(self._call_land, name)

    def _call_land(self, name):
        """Call a vehicle's landing service; the answer may take as long as its network is down."""
        service = "/%s/land" % name
        try:
            rospy.loginfo("operator: %s: %s", service, self._call(service)[1])
        except (rospy.ROSException, rospy.ServiceException) as error:
            rospy.logwarn("operator: cannot ask %s to land: %s (%s)", name, service, error)
        with self._lock:
            self._landing.discard(name)

    def _diagnose(self, status):
        with self._lock:
            self._phase.publish(state_message(self._state()))  # heartbeat
            status.summary(2 if self._operator.result == OperatorResult.FAILED else 0, self._operator.phase_text)
            for name, watched in self._operator.vehicles.items():
                status.add("%s flight state" % name, watched.flight_state)
                status.add("%s mode" % name, "autonomous" if watched.autonomous else "manual")
                phase = watched.trajectory_phase
                status.add("%s trajectory phase" % name, "none yet" if phase is None else phase.name.lower())
        return status


def start(work, *arguments):
    """Run work in a thread of its own."""
    threading.Thread(target=work, args=arguments, daemon=True).start()


def state_message(state):
    """OperatorState message of a state that `VirtualOperator._state` returned."""
    *fields, out = state
    message = OperatorState(None, *fields, [VehicleOut(*vehicle) for vehicle in out])
    message.header.stamp = rospy.Time.now()
    return message


def main():
    send_directly()
    init_node("operator")
    try:
        VirtualOperator()
    except ValueError as error:
        rospy.logfatal("operator: %s", error)
        return 1
    rospy.spin()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
