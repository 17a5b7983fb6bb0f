"""The vehicle node: joystick, safety and input mapping of one vehicle (`risc_controller.py`, `riscN_controller.py`).

Wiring only: what is decided is decided in `vehicle_pilot`, `joystick` and `safety`.
"""

import queue
import socket
import threading
import time
import traceback

import rospy
from geometry_msgs.msg import Twist, TwistStamped
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Empty, String
from std_srvs.srv import Trigger, TriggerResponse

from ardrone_autonomy.msg import Navdata
from risc_control.lab.fleet import fleet_from_dict
from risc_control.lab.vehicle_types import load_vehicle_type
from risc_control.ros import low_latency
from risc_control.ros.diagnostics import make_updater
from risc_control.ros.joystick_buttons import origin
from risc_control.ros.paced import PacedSubscriber
from risc_control.safety import Rung
from risc_control.vehicle_pilot import (
    OwnControl,
    OwnState,
    VehiclePilot,
    check_full_scale,
    choose_vehicle,
    params_from_dict,
)
from risc_msgs.msg import Controls, Cortex

_RAD_PER_DEG = 0.017453292519943295
_TICKS_PER_COMMAND = 2  # the watchdog runs at this multiple of the command rate
_LAND_ROUNDS = 60  # at shutdown in flight: how often the last orders are repeated, at most
_LAND_ROUND_S = 0.05
_ERROR_LAND_S = 0.2  # how often a landing is ordered while callbacks fail
_ERROR_LOG_S = 2.0
_FLUSH_S = 0.1  # at shutdown: time for the last messages to leave
_OWN_KEYS = ("vehicle", "type", "diagnostic_period")


class VehicleNode:
    """joy, navdata, /cortex_raw, /controls, service land -> cmd_vel, take-off, land, reset of one vehicle.

    namespace: "" = relative names, for a node started inside its vehicle's group; "risc1" = the absolute names
    /risc1/..., as the riscN_controller.py of the original release.
    """

    def __init__(self, namespace=""):
        group = namespace or rospy.get_namespace().strip("/").split("/")[-1]
        params, unknown = params_from_dict(
            {name: value for name, value in rospy.get_param("~", {}).items() if name not in _OWN_KEYS}
        )
        for name in unknown:
            rospy.logwarn("%s: parameter ~%s means nothing to this node: is it misspelt?", group, name)
        fleet = rospy.get_param("/fleet", None)
        self.vehicle, kind = choose_vehicle(
            rospy.get_param("~vehicle", ""), group, fleet and fleet_from_dict(fleet, "parameter /fleet")
        )
        kind = rospy.get_param("~type", kind)
        if kind == "iris":
            raise ValueError("%s is an IRIS+, which takes no cmd_vel: start its own node instead" % self.vehicle)
        vehicle_type = load_vehicle_type(kind)
        warning = check_full_scale(params, vehicle_type)
        if warning:
            rospy.logwarn("%s: %s", self.vehicle, warning)
        self._pilot = VehiclePilot(params, vehicle_type, time.monotonic())
        self._lock = threading.Lock()
        self._counts = dict.fromkeys(("states", "controls", "commands", "unseen", "errors"), 0)
        self._reported = dict(self._counts)
        self._reported_s = time.monotonic()
        self._error_land_s = 0.0  # when a landing was ordered because of an error
        self._answer_max_s = 0.0  # oldest state that a command answered, since the last report
        self._parameters = queue.Queue()  # (name, value): writing to the master must not hold up a callback
        threading.Thread(target=self._write_parameters, daemon=True).start()

        def name(topic):
            return "/%s/%s" % (namespace, topic) if namespace else topic

        def publisher(topic, message, **options):
            return rospy.Publisher(name(topic), message, tcp_nodelay=True, **dict({"queue_size": 10}, **options))

        self._cmd_vel = publisher("cmd_vel", Twist)
        self._cmd_vel_stamped = publisher("cmd_vel_stamped", TwistStamped)
        self._takeoff = publisher("ardrone/takeoff", Empty)
        self._land = publisher("ardrone/land", Empty)
        self._reset = publisher("ardrone/reset", Empty)
        self._status = publisher("controller_status", Bool)
        self._safety = publisher("safety", String, latch=True)
        self._diagnostics = make_updater(self.vehicle)
        self._diagnostics.add("vehicle " + self.vehicle, self._diagnose)
        self._timers = ()
        rospy.on_shutdown(self._on_shutdown)
        # Every joystick message: of a burst that a network held up, the first say that a press is old.
        for topic, message, callback, queue_size in (
            (name("joy"), Joy, self._on_joy, None),
            (name("ardrone/navdata"), Navdata, self._on_navdata, 10),
        ):
            rospy.Subscriber(topic, message, self._guarded(callback), queue_size=queue_size, tcp_nodelay=True)
        # Only the newest counts, and a backlog must not be worked off message by message.
        rospy.Subscriber("/controls", Controls, self._guarded(self._on_controls), queue_size=1, tcp_nodelay=True)
        # The states are here for the ladder and the climb rate, once a tick; the controller answers each of them.
        period_s = 1.0 / (_TICKS_PER_COMMAND * params.pilot.command_rate_hz)
        self._states = PacedSubscriber("/cortex_raw", Cortex, self._guarded(self._on_states), 1.0 / period_s)
        self._timers = (
            rospy.Timer(rospy.Duration(period_s), self._guarded(self._on_tick), reset=True),
            rospy.Timer(rospy.Duration(0.5), self._guarded(lambda _: self._diagnostics.update(), False), reset=True),
        )
        self._service = rospy.Service(name("land"), Trigger, self._on_land_request)
        topic = self._cmd_vel.resolved_name
        rospy.loginfo("%s flies %s (%s), commands on %s", rospy.get_name(), self.vehicle, kind, topic)

    def _guarded(self, work, flies=True):
        """`work` as a callback that outlives an exception, which would end a timer and with it the ladder's clock.

        flies: the vehicle depends on it, so an autonomous one lands when it fails.
        """

        def run(argument):
            try:
                work(argument)
            except Exception as error:  # whatever it is, the next tick must come
                if rospy.core.is_shutdown_requested():
                    return  # topics are closed already; the last orders are those of _on_shutdown
                self._counts["errors"] += 1
                rospy.logerr_throttle(
                    _ERROR_LOG_S,
                    "%s: error in the vehicle node, please report it (%s: %s)\n%s"
                    % (self.vehicle, type(error).__name__, error, traceback.format_exc()),
                )
                if flies:
                    self._land_after_error(error)

        return run

    def _land_after_error(self, error):
        """An autonomous vehicle must not fly on with a node that fails; in manual mode its operator decides."""
        now_s = time.monotonic()
        if self._pilot.autonomous and now_s - self._error_land_s >= _ERROR_LAND_S:
            self._error_land_s = now_s
            self._land.publish()
            rospy.logerr_throttle(_ERROR_LOG_S, "%s: landing: %s" % (self.vehicle, error))

    def _on_joy(self, message):
        age_s, sender = origin(message)
        with self._lock:
            orders = self._pilot.on_joy(message.buttons, message.axes, time.monotonic(), age_s, sender)
            self._carry_out(orders)
        self._report(orders)

    def _on_navdata(self, message):
        with self._lock:
            orders = self._pilot.on_navdata(message.state, message.batteryPercent, time.monotonic())
            self._carry_out(orders)
        self._report(orders)

    def _own(self, message, topic, cure):
        """Own entry of a message, by name (D-27); None and a warning when there is none."""
        for entry in message.Obj:
            if entry.name == self.vehicle:
                return entry
        names = ", ".join(entry.name for entry in message.Obj) or "nobody"
        rospy.logwarn_throttle_identical(5.0, "%s has no '%s' (it has %s): %s" % (topic, self.vehicle, names, cure))
        return None

    def _on_states(self, message):
        entry = self._own(message, "/cortex_raw", "does the estimator know the template, and is ~vehicle right?")
        if entry is None:
            return
        if not entry.visible:
            self._counts["unseen"] += 1
            return
        position_m, velocity_m_s = (entry.x, entry.y, entry.z), (entry.u, entry.v, entry.w)
        own = OwnState(position_m, velocity_m_s, entry.phi * _RAD_PER_DEG, entry.theta * _RAD_PER_DEG)
        age_s = rospy.get_time() - message.header.stamp.to_sec()
        with self._lock:
            self._counts["states"] += 1
            self._pilot.on_state(own, age_s, time.monotonic())

    def _on_controls(self, message):
        entry = self._own(message, "/controls", "is it in the controller's and the trajectory's list of vehicles?")
        if entry is None:
            return
        own = OwnControl(entry.phi, entry.theta, entry.psi, entry.T)
        stamp_s = message.header.stamp.to_sec()
        age_s = rospy.get_time() - stamp_s
        with self._lock:
            self._counts["controls"] += 1
            orders = self._pilot.on_controls(own, stamp_s, age_s, time.monotonic())
            self._carry_out(orders, message.header.stamp)
        self._report(orders)

    def _on_land_request(self, _request):
        with self._lock:
            orders, done, text = self._pilot.on_land_request(time.monotonic())
            self._carry_out(orders)
        self._report(orders)
        return TriggerResponse(done, text)

    def _on_tick(self, _event):
        with self._lock:
            orders = self._pilot.tick(time.monotonic())
            self._carry_out(orders)
        self._report(orders)

    def _carry_out(self, orders, stamp=None):
        """Publish what was ordered; inside the lock, so that an older command never overtakes a newer one."""
        if orders.reset:
            self._reset.publish()
        if orders.takeoff:
            self._takeoff.publish()
        if orders.land:
            self._land.publish()
        if orders.command is not None:
            sticks, stamp_s = orders.command
            twist = Twist()
            twist.linear.x, twist.linear.y, twist.linear.z, twist.angular.z = sticks
            twist.angular.x = 1.0 if orders.level_only else 0.0  # any value but 0 keeps the driver from auto-hovering
            self._cmd_vel.publish(twist)
            stamped = TwistStamped(twist=twist)
            if stamp_s and stamp is not None:
                stamped.header.stamp = stamp
                self._answer_max_s = max(self._answer_max_s, rospy.get_time() - stamp_s)
            self._cmd_vel_stamped.publish(stamped)
            self._counts["commands"] += 1
        if orders.status is not None:
            self._status.publish(orders.status)
        if orders.safety is not None:
            self._safety.publish(orders.safety)

    def _report(self, orders):
        """What may take its time: outside the lock."""
        if orders.mode is not None:
            self._parameters.put(("/controller_status", orders.mode))
        if orders.simulator_reset is not None:
            self._parameters.put(("/RESET", orders.simulator_reset))
        for level, text in orders.log:
            text = "%s: %s" % (self.vehicle, text)
            if level == "info":
                rospy.loginfo(text)
            elif level == "warn":
                rospy.logwarn_throttle_identical(2.0, text)
            else:
                rospy.logerr(text)
        if orders.shut_down:
            threading.Thread(target=rospy.signal_shutdown, args=("shut-down button",), daemon=True).start()

    def _write_parameters(self):
        while True:
            name, value = self._parameters.get()
            try:
                rospy.set_param(name, value)
            except (OSError, rospy.ROSException) as error:
                rospy.logwarn_throttle(10.0, "cannot set parameter %s: %s" % (name, error))

    def _on_shutdown(self):
        """Level, and land when in the air: the vehicle's last orders."""
        for timer in self._timers:
            timer.shutdown()
        for _ in range(_LAND_ROUNDS):
            with self._lock:
                self._carry_out(self._pilot.on_shutdown(time.monotonic()))
                landing = not self._pilot.needs_landing(time.monotonic())
            if landing:
                break
            time.sleep(_LAND_ROUND_S)
        time.sleep(_FLUSH_S)

    def _diagnose(self, status):
        with self._lock:
            now_s = time.monotonic()
            elapsed_s = max(now_s - self._reported_s, 1e-3)
            rates = {what: (self._counts[what] - self._reported[what]) / elapsed_s for what in self._counts}
            self._reported, self._reported_s = dict(self._counts), now_s
            answer_max_s, self._answer_max_s = self._answer_max_s, 0.0
            pilot = self._pilot
            verdict, reactions = pilot.ladder.verdict, list(pilot.ladder.reactions)
            ages_s = pilot.ladder.state.age_s(now_s), pilot.ladder.controls.age_s(now_s)
            behind_s = pilot.ladder.state.clock_behind_s
            autonomous, flight_state = pilot.autonomous, pilot.flight_state
        status.summary({Rung.OK: 0, Rung.HOLD: 1, Rung.LAND: 2}[verdict.rung], verdict.text)
        status.add("vehicle", self.vehicle)
        status.add("computer", socket.gethostname())
        status.add("mode", "autonomous" if autonomous else "manual")
        status.add("flight state (navdata)", "none yet" if flight_state is None else flight_state)
        for what, label in (
            ("states", "visible states looked at"),
            ("unseen", "states while not visible"),
            ("controls", "controls"),
            ("commands", "commands sent"),
            ("errors", "errors of the node"),
        ):
            status.add(label + " (Hz)", "%.1f" % rates[what])
        status.add("age of the state (ms)", "%.0f" % (1e3 * ages_s[0]))
        status.add("age of the controls (ms)", "%.0f" % (1e3 * ages_s[1]))
        status.add("clock behind that of the states, at least (ms)", "%.1f" % (1e3 * behind_s))
        status.add("oldest state answered by a command (ms)", "%.1f" % (1e3 * answer_max_s))
        for reaction in reactions:
            label = "last %s: " % reaction.rung.name.lower()
            status.add(label + "age when it was ordered (ms)", "%.0f" % (1e3 * reaction.age_s))
            status.add(label + "reaction after the limit (ms)", "%.1f" % (1e3 * reaction.beyond_s))
        return status


def main(namespace=""):
    """Run the node until shutdown; returns the exit code."""
    low_latency.start("risc_hand_controller")
    try:
        VehicleNode(namespace)
    except ValueError as error:
        rospy.logfatal("%s: %s", rospy.get_name(), error)
        return 1
    low_latency.spin()
    return 0
