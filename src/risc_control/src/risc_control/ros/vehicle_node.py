"""The vehicle node: joystick, safety and input mapping of one vehicle, or of several (`risc_controller.py`, ...).

Wiring only: decisions are made in `vehicle_pilot`, `joystick` and `failsafe`.
"""

import ipaddress
import math
import queue
import socket
import threading
import time
from collections import defaultdict
from dataclasses import replace
from functools import partial, wraps

import numpy as np
import rospy
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger, TriggerResponse

from risc_control.controller_stream import ControllerStream
from risc_control.joystick import Button
from risc_control.plausibility import Plausibility
from risc_control.ros.conversions import command_sent
from risc_control.ros.joystick_buttons import claim_buttons, origin
from risc_control.safety import fence_of
from risc_control.separation import ALONE, Separation
from risc_control.vehicle_pilot import OwnState, VehicleNodeParams, VehiclePilot
from risc_control.vehicles import ON_GROUND, Controls, adapter_class
from risc_lab.lab.arena import Arena
from risc_lab.lab.fleet import laboratory_vehicles, unplaced_vehicle, wider_m
from risc_lab.lab.vehicle_types import LEGACY_PARAMETERS, disagreement
from risc_lab.ros import low_latency
from risc_lab.ros.clock import ros_time_s
from risc_lab.ros.diagnostics import Growth, make_updater
from risc_lab.ros.fleet_messages import ControlsArrays, CortexArrays, TrajectoriesArrays
from risc_lab.ros.guard import Failures, guarded, subscribe
from risc_lab.ros.node import run
from risc_lab.ros.paced_subscriber import PacedSubscriber
from risc_lab.ros.params import VEHICLE_KEYS, known_fleet, load_params, told_vehicle_type
from risc_lab.ros.sender import sender
from risc_lab.ros.ticker import Ticker
from risc_maap_msgs.msg import CommandsSent, EstimatorStatus, Safety, TakeoffRefusals, VehicleNodeStatus, VehicleStatus

_RAD_PER_DEG = math.radians(1.0)
_TO_RADIANS = np.array([1.0] * 6 + [_RAD_PER_DEG] * 6)  # converts rows of /cortex_raw to those of `risc_lab.states.S`
_TICKS_PER_COMMAND = 2  # the watchdog runs at this multiple of the command rate
_LAND_ROUNDS = 60  # at shutdown in flight: how often the last orders are repeated, at most
_LAND_ROUND_S = 0.05
_ERROR_LAND_S = 0.2  # how often a landing is ordered while callbacks fail
_ERROR_LOG_S = 2.0
_FLUSH_S = 0.1  # at shutdown: time for the last messages to leave
_VEHICLE_STATUS_S = 0.2  # least interval of vehicle_status while the state does not change
_REFERENCES_HZ = 20.0  # how often references are read
SILENCE_S = 0.5  # a controller or a driver that was silent for longer may be another one, with other full scales;
_GONE_S = 5.0  # after this silence its full scales are forgotten
_VEHICLES_A_TURN = 5  # vehicles that one message of the controller commands;
_MOST_GROUPS = 6  # more vehicles in a large fleet: a 200 Hz controller sends 6.8 messages in a command period
_NONE = rospy.Time()
_LOGS = {"info": rospy.loginfo, "warn": partial(rospy.logwarn_throttle_identical, 2.0), "error": rospy.logerr}


class VehicleNode:
    """joy, navdata, /cortex_raw, /controls, /trajectory, service land -> cmd_vel, take-off, land, reset of vehicles.

    namespace: "" = relative names, for a node started inside its vehicle's group; "risc1" = the absolute names
    /risc1/..., as the riscN_controller.py of the original release. With ~vehicles, a list of namespaces of /fleet, the
    node flies all of them, on the absolute names of each and with the same parameters.
    """

    def __init__(self, namespace=""):
        values, fleet = rospy.get_param("~", {}), known_fleet()
        defaults = VehicleNodeParams(**fence_of(fleet.arena if fleet else Arena()))
        (params,) = load_params(defaults, known=("type", *VEHICLE_KEYS, *LEGACY_PARAMETERS), lenient=True)
        self.params, self.errands = params, queue.Queue()  # functions that call the master: no callback may wait for it
        threading.Thread(target=self._run_errands, daemon=True).start()
        chosen = _chosen(values, namespace, fleet)
        if not params.ladder:
            _without_ladder(fleet, [vehicle for vehicle, _, _ in chosen])
        # before anything is published: a node that is refused must not land a vehicle that another one flies
        buttons = {button.value: getattr(params, button.value) for button in Button}
        claim_buttons(buttons, [prefix + "joy" for _, prefix, _ in chosen])
        types = [told_vehicle_type(vehicle, values) for vehicle, _, _ in chosen]
        everybody = fleet.vehicles if fleet is not None else ()
        wide_m = wider_m(everybody) | {who.template: kind.wider_m for (who, _, _), kind in zip(chosen, types)}
        rates_hz = [params.rate_hz(vehicle_type) for vehicle_type in types]
        turns_s = _turns_s([1.0 / rate_hz for rate_hz in rates_hz])
        self.sent = queue.SimpleQueue()  # of CommandSent: those sent in the same turn share a message
        self._sent_lock = threading.Lock()
        self._sent_publisher = rospy.Publisher("/commands_sent", CommandsSent, queue_size=100, tcp_nodelay=True)
        self.controllers_s = {}  # {node of a controller: when it was heard last}
        self._vehicles = [_Vehicle(self, *who, kind, turn_s) for who, kind, turn_s in zip(chosen, types, turns_s)]
        self._give_ups = [guarded(vehicle.give_up, "landing of %s" % vehicle.name) for vehicle in self._vehicles]
        self._by_name = {vehicle.name: vehicle for vehicle in self._vehicles}
        self._controls, self._states, self._references = ControlsArrays(), CortexArrays(), TrajectoriesArrays()
        order = [vehicle.template for vehicle in everybody]
        self._separation = Separation(self._by_name, params, order, wide_m)
        others = [vehicle for vehicle in everybody if vehicle.template not in self._by_name]
        # until when it counts that another node holds or lands its vehicle
        self._held_until_s = {vehicle.template: -math.inf for vehicle in others}
        self._stand_until_s = dict(self._held_until_s)  # and that its vehicle reports that it stands
        kinds = {vehicle.template: vehicle.vehicle_type for vehicle in everybody}
        self._plausibility = Plausibility(
            kinds | {who.template: kind for (who, *_), kind in zip(chosen, types)}, params
        )
        tick_hz = _TICKS_PER_COMMAND * max(rates_hz)
        self._tick_s = 1.0 / tick_hz
        self._streams = defaultdict(lambda: ControllerStream(self._tick_s))  # {sender of /controls: its stream}
        self._heard = {}  # {topic: {sender: names of its messages}}
        self._complete = set()  # topics on which all vehicles were found
        self._answering, self._looking = threading.Lock(), threading.Lock()  # senders have threads of their own
        self._diagnostics = make_updater(", ".join(self._by_name))
        for vehicle in self._vehicles:
            self._diagnostics.add("vehicle " + vehicle.name, vehicle.diagnose)
        self._tickers = ()
        rospy.on_shutdown(self._on_shutdown)
        for vehicle in self._vehicles:
            vehicle.listen()
        for other in others:
            heard = partial(self._on_safety_of, other.template)
            subscribe("/%s/safety" % other.namespace, Safety, heard, on_error=self._on_error, queue_size=1)
            heard = partial(self._on_status_of, other.template)
            topic = "/%s/vehicle_status" % other.namespace
            subscribe(topic, VehicleStatus, heard, on_error=self._on_error, queue_size=1)
        paced = partial(PacedSubscriber, on_error=self._on_error)
        paced("/controls", ControlsArrays.Raw, self._on_controls, tick_hz)
        # The states are here for the ladder and the climb rate, once a tick; the controller answers each of them.
        paced("/cortex_raw", CortexArrays.Raw, self._on_states, tick_hz)
        paced("/trajectory", TrajectoriesArrays.Raw, self._on_references, _REFERENCES_HZ)
        subscribe("/estimator_status", EstimatorStatus, self._on_estimator, on_error=self._on_error, queue_size=1)
        self._tickers = (
            Ticker(self._tick_s, self._on_tick, "the vehicles' clock"),
            Ticker(0.5, self._diagnostics.update, "the diagnostics"),
        )

    def _on_error(self, error):
        """A callback for all vehicles has failed."""
        for give_up in self._give_ups:
            give_up(error)

    def nearest(self, name):
        """`Separation.nearest` at the present time."""
        return self._separation.nearest(name, time.monotonic())

    def _on_controls(self, message):
        """Send commands: vehicles that are due get that of the next message; messages in between are not even read.

        Returns when to read the next message [s]. Every sender has its own thread, and its own vehicles.
        """
        with self._answering:
            controls = self._controls.deserialize(message.buff)
            stamp, who = controls.header.stamp, sender(message)
            stamp_s = stamp.to_sec()
            age_s = ros_time_s() - stamp_s
            self._tell_missing(
                "/controls", who, controls.names, "is it in the controller's and the trajectory's list of vehicles?"
            )
            rows = zip(map(self._by_name.get, controls.names), controls.controls.tolist())
            flown = [(vehicle, row) for vehicle, row in rows if vehicle is not None]
            if _begins(who, self.controllers_s):
                self.errands.put(lambda: self._compare(who))
            is_due = time.monotonic() >= _next_command_s(flown)
            stream = self._streams[who]
            answers = stream.answers(stamp_s, age_s, is_due)
            for vehicle, row in flown:
                vehicle.on_controls(Controls(*row), stamp if answers else None, age_s)
            self._tell_sent()
            return 0.0 if stream.reads_on else min(_next_command_s(flown), time.monotonic() + self._tick_s)

    def _on_safety_of(self, name, message):
        """Note whether another node holds or lands a vehicle. It counts for a time: that node may have died since."""
        alone = message.level > Safety.OK and message.rule != Safety.SEPARATION
        self._held_until_s[name] = time.monotonic() + self.params.separation_forget_s if alone else -math.inf

    def _on_status_of(self, name, message):
        """Note whether the vehicle of another node reports that it stands."""
        stands = message.state in ON_GROUND
        self._stand_until_s[name] = time.monotonic() + self.params.separation_forget_s if stands else -math.inf

    def _on_states(self, message):
        with self._looking:
            states = self._states.deserialize(message.buff)
            stamp_s = states.header.stamp.to_sec()
            age_s, now_s = ros_time_s() - stamp_s, time.monotonic()
            in_radians = states.states * _TO_RADIANS
            believed = self._plausibility.look(states.names, states.visible, in_radians, stamp_s)
            if believed is None:
                return
            self._separation.see(states.names, believed, states.states, now_s - max(age_s, 0.0))
            own = {name for name, vehicle in self._by_name.items() if vehicle.pilot.holds_alone}
            held = own | {name for name, s in self._held_until_s.items() if now_s < s}
            stand = {name for name, vehicle in self._by_name.items() if vehicle.pilot.stands}
            self._separation.tell(held, stand | {name for name, s in self._stand_until_s.items() if now_s < s})
            looks = self._separation.look(now_s)
            rows = zip(states.names, states.visible.tolist(), believed.tolist(), states.states.tolist())
            for name, visible, is_believed, row in rows:
                vehicle = self._by_name.get(name)
                if vehicle is None:
                    continue
                if visible and not is_believed:
                    vehicle.on_suspect(self._plausibility.reason(name))
                else:
                    vehicle.on_state(visible, row, age_s, looks.get(name, ALONE))
            self._tell_missing(
                "/cortex_raw",
                sender(message),
                states.names,
                "does the estimator know the template, and is the vehicle's name right?",
            )

    def _on_estimator(self, message):
        for counted in message.markers:
            if counted.name in self._by_name:
                self._by_name[counted.name].on_markers(counted.used, counted.known)

    def _on_references(self, message):
        with self._looking:
            references = self._references.deserialize(message.buff)
            age_s = ros_time_s() - references.header.stamp.to_sec()
            self._separation.refer(references.names, references.derivatives, time.monotonic() - age_s)

    def _tell_missing(self, topic, who, names, cure):
        """Warn if a vehicle is in no sender's messages; they are found by name (D-27). names: of this message."""
        heard = self._heard.setdefault(topic, {})
        if heard.get(who) is not names:
            heard[who] = names
            self._complete.discard(topic)
        if topic in self._complete:
            return
        found = set().union(*heard.values())
        missing = [name for name in self._by_name if name not in found]
        if missing:
            text = "%s has no '%s' (it has %s): %s"
            there = ", ".join(sorted(found)) or "no entry"
            rospy.logwarn_throttle_identical(5.0, text % (topic, "', '".join(missing), there, cure))
        else:
            self._complete.add(topic)

    def _on_tick(self):
        for vehicle in self._vehicles:
            vehicle.on_tick()
        self._tell_sent()

    def _tell_sent(self):
        """Publish what was sent since the last call, in the order of sending."""
        with self._sent_lock:
            commands = [self.sent.get() for _ in range(self.sent.qsize())]
            if commands:
                message = CommandsSent(commands=commands)
                message.header.stamp = commands[-1].sent
                self._sent_publisher.publish(message)

    def _compare(self, controller):
        """Compare the full scales that a controller states with ours; a controller that states none is accepted."""
        theirs = rospy.get_param(controller + "/full_scales", {})
        for vehicle in self._vehicles:
            vehicle.compare(theirs.get(vehicle.name, {}), controller)

    def _run_errands(self):
        while True:
            errand = self.errands.get()
            try:
                errand()
            except Exception as error:  # after any error the next errand must still run
                rospy.logwarn_throttle(10.0, "parameter server: %s: %s" % (type(error).__name__, error))

    def _on_shutdown(self):
        """Level, and land when in the air: the vehicles' last orders."""
        for ticker in self._tickers:
            ticker.stop()
        land(self._vehicles)
        self._tell_sent()
        time.sleep(_FLUSH_S)


def land(vehicles):
    """Give last orders until none of the vehicles may be in the air without reporting that it lands."""
    for _ in range(_LAND_ROUNDS):
        vehicles = [vehicle for vehicle in vehicles if not vehicle.last_orders()]
        if not vehicles:
            return
        time.sleep(_LAND_ROUND_S)


def _contained(method):
    """Decorator for methods of _Vehicle: an error affects no other vehicle and does not end the thread."""

    @wraps(method)
    def run(self, *arguments):
        try:
            method(self, *arguments)
        except Exception as error:  # after any error the next message must still be handled
            if self.failures.note(error):
                self.give_up(error)

    return run


class _Vehicle:
    """One vehicle of the node. What fails here, fails for no other vehicle."""

    def __init__(self, node, fleet_vehicle, prefix, is_alone, vehicle_type, turn_s):
        """prefix: of its topics.  is_alone: its shut-down button ends the node.  turn_s: start of one of its slots for
        commands.
        """
        self.name = fleet_vehicle.template
        self._node, self._type, self._prefix, self._is_alone = node, vehicle_type, prefix, is_alone
        self._turn_s = turn_s
        now_s = time.monotonic()
        self.pilot = VehiclePilot(node.params, vehicle_type, now_s, turn_s, None, self._nearest, listens_since_s=now_s)
        self._drivers_s = {}  # {node that sends the vehicle's status: when it was heard last}
        self._disagreements = {}  # {node of a controller or a driver with other full scales: what is wrong}
        self._lock = threading.Lock()
        self.failures = Failures("%s: the vehicle node" % self.name)
        counted = "states", "states while not visible", "suspect states", "controls", "commands", "errors"
        self._counts = dict.fromkeys(counted, 0)
        self._growth = Growth()
        self._error_land_s = 0.0  # when a landing was ordered because of an error
        self._answer_max_s = 0.0  # oldest state that a command answered, since the last report
        self._flies_itself = adapter_class(vehicle_type).FLIES_ITSELF
        self._link = adapter_class(vehicle_type).connect(prefix, self.name, self._on_refusal)
        self._status = self._publisher("controller_status", Bool)
        self._vehicle_status = self._publisher("vehicle_status", VehicleStatus)
        self._told_s, self._told = -math.inf, VehicleStatus(name=self.name, battery_pct=math.nan)  # when last
        self._safety = self._publisher("safety", Safety, latch=True)
        self._node_status = self._publisher("node_status", VehicleNodeStatus)
        self._refusals = self._publisher("takeoff_refusals", TakeoffRefusals, latch=True)

    def _publisher(self, topic, message, **options):
        return rospy.Publisher(self._prefix + topic, message, queue_size=10, tcp_nodelay=True, **options)

    def listen(self):
        """Subscribe to the vehicle's topics and offer its service."""
        # Queue every joystick message: in a burst that the network delayed, the first ones show that a press is old.
        subscribe(self._prefix + "joy", Joy, self._on_joy, on_error=self.give_up, queue_size=None)
        reports = partial(subscribe, on_error=self.give_up, queue_size=10)
        adapter = adapter_class(self._type)
        adapter.listen(self._prefix, self._on_status, reports)
        if not self._flies_itself:
            adapter.listen_to_wire(self._prefix, self._on_wire, reports)
        self._service = rospy.Service(self._prefix + "land", Trigger, self._on_land_request)
        where = rospy.get_name(), self.name, self._type.name, self._link.topic
        rospy.loginfo("%s flies %s (%s), commands on %s", *where)

    def give_up(self, error):
        """Something failed: land an autonomous vehicle; in manual mode its operator decides."""
        self._counts["errors"] += 1
        now_s = time.monotonic()
        if self.pilot.autonomous and now_s - self._error_land_s >= _ERROR_LAND_S:
            self._error_land_s = now_s
            self._link.land()
            rospy.logerr_throttle(_ERROR_LOG_S, "%s: landing: %s" % (self.name, error))

    def _on_joy(self, message):
        age_s, who = origin(message)
        self._act(lambda pilot, now_s: pilot.on_joy(message.buttons, message.axes, now_s, age_s, who))

    def _on_status(self, status, driver):
        if _begins(driver, self._drivers_s):
            self._node.errands.put(lambda: self.compare(self._link.driver_overrides(driver), driver))
        self._act(lambda pilot, now_s: pilot.on_status(status, now_s))
        if status.battery_pct is not None:
            self._told.battery_pct = status.battery_pct
        self._tell()

    def _on_wire(self):
        with self._lock:
            self.pilot.on_wire(time.monotonic())

    @_contained
    def _on_refusal(self, why):
        self._act(lambda pilot, now_s: pilot.on_refusal(why, now_s))

    def _nearest(self):
        return self._node.nearest(self.name)

    def _tell(self):
        """Publish its flight state and charge, when that is due."""
        told, now_s, state = self._told, time.monotonic(), self.pilot.flight_state
        if state is None or not 0 <= state < 256:  # out of range it would raise, and land the vehicle
            state = VehicleStatus.UNKNOWN
        if state != told.state or now_s - self._told_s >= _VEHICLE_STATUS_S:
            self._told_s, told.state, told.header.stamp = now_s, state, rospy.Time.now()
            self._vehicle_status.publish(told)

    def compare(self, full_scales, node):
        """Compare full scales of a controller or the driver with ours; while they differ no controller is obeyed."""
        text = disagreement(self.name, vars(self._type), full_scales, node)
        if text:
            rospy.logerr("%s. No autonomous flight until both agree", text)
        with self._lock:
            self._disagreements[node] = text
            self._agree()

    def _agree(self):
        """Drop the disagreements of nodes that are gone, and tell the pilot the rest. With the lock held."""
        since_s, heard_s = time.monotonic() - _GONE_S, {**self._node.controllers_s, **self._drivers_s}
        self._disagreements = {n: text for n, text in self._disagreements.items() if text and heard_s[n] > since_s}
        self.pilot.disagreement = next(iter(self._disagreements.values()), "")

    @_contained
    def on_state(self, visible, row, age_s, look):
        """Its entry of /cortex_raw. row: the twelve numbers in the message's units; age_s: of the message [s]; look:
        `separation.Look` at the other vehicles.
        """
        if not visible:
            self._counts["states while not visible"] += 1
            with self._lock:
                self.pilot.on_unseen()
            return
        own = OwnState(row[:3], row[3:6], *(_RAD_PER_DEG * angle for angle in row[6:9]))
        with self._lock:
            self._counts["states"] += 1
            self.pilot.on_state(own, age_s, time.monotonic(), look)

    @_contained
    def on_markers(self, used, known):
        """Take the number of markers that the estimator's pose of it is from, and the number in its template."""
        with self._lock:
            self.pilot.on_markers(used, known)

    @_contained
    def on_suspect(self, reason):
        """Its entry of /cortex_raw cannot be true."""
        with self._lock:
            self._counts["suspect states"] += 1
            self.pilot.on_suspect(reason, time.monotonic())

    @_contained
    def on_controls(self, own, stamp, age_s):
        """Its entry of /controls, with the stamp of the message; stamp None: no command may be sent for it."""
        self._counts["controls"] += 1
        if stamp is None:
            with self._lock:
                self.pilot.hear_controls(own, age_s, time.monotonic())
        else:
            self._act(lambda pilot, now_s: pilot.on_controls(own, stamp, age_s, now_s))

    def _on_land_request(self, _request):
        return TriggerResponse(*self._act(lambda pilot, now_s: pilot.on_land_request(now_s)).answer)

    @_contained
    def on_tick(self):
        """Called twice per command period of the vehicle, or more often."""
        if self._disagreements:
            with self._lock:
                self._agree()
        self._act(lambda pilot, now_s: pilot.tick(now_s))
        if not self._flies_itself and self.pilot.flight_state != self._told.state:  # this node knows it first
            if self.pilot.ladder.navdata_is_fresh(time.monotonic()):
                self._tell()

    def last_orders(self):
        """Order level and land, once. Returns whether no further landing order is needed."""
        with self._lock:
            self._carry_out(self.pilot.on_shutdown(time.monotonic()))
            return not self.pilot.needs_landing(time.monotonic())

    def _act(self, decide):
        """Let the pilot decide, and carry out its orders. decide: function of pilot and time. Returns its Orders."""
        with self._lock:  # also while it is published, so that an older command never overtakes a newer one
            orders = decide(self.pilot, time.monotonic())
            self._carry_out(orders)
        self._report(orders)
        return orders

    def _carry_out(self, orders):
        if orders.reset:
            self._link.reset()
        if orders.takeoff:
            self._link.take_off()
        if orders.land:
            self._link.land()
        elif orders.disarm:  # a landing includes it
            self._link.disarm()
        if orders.command is not None:
            command = orders.command
            self._link.send(command.sticks, orders.level_only)
            sent = rospy.Time.from_sec(ros_time_s())
            answers = command.answers or _NONE
            if answers:
                self._answer_max_s = max(self._answer_max_s, (sent - answers).to_sec())
            level = self.pilot.ladder.verdict.level
            self._node.sent.put(command_sent(self.name, sent, answers, command.settles_at, level))
            self._counts["commands"] += 1
        if orders.status is not None:
            self._status.publish(orders.status)
        if orders.safety is not None:
            self._safety.publish(safety_message(orders.safety))

    def _report(self, orders):
        """Carry out orders that may be slow, outside the lock."""
        if orders.mode is not None:
            self._node.errands.put(partial(rospy.set_param, "/controller_status", orders.mode))
        if orders.simulator_reset is not None:
            self._node.errands.put(partial(rospy.set_param, "/RESET", orders.simulator_reset))
        if orders.refusals is not None:
            message = TakeoffRefusals(reasons=orders.refusals)
            message.header.stamp = rospy.Time.now()
            self._refusals.publish(message)
        for level, text in orders.log:
            _LOGS[level]("%s: %s" % (self.name, text))
        if orders.shut_down:
            end = (lambda: rospy.signal_shutdown("shut-down button")) if self._is_alone else self._begin_again
            threading.Thread(target=end, daemon=True).start()

    def _begin_again(self):
        """Shut-down button of one of several vehicles: land, then continue like a node that has just started."""
        land([self])
        with self._lock:
            before, now_s = self.pilot, time.monotonic()
            self.pilot = VehiclePilot(self._node.params, self._type, now_s, self._turn_s, before, self._nearest)
        rospy.loginfo("%s: started again, in manual mode", self.name)

    def diagnose(self, status):
        """A task of diagnostic_updater; values that other programs use are published as a VehicleNodeStatus."""
        with self._lock:
            now_s, (_, rates) = time.monotonic(), self._growth(self._counts)
            answer_max_s, self._answer_max_s = self._answer_max_s, 0.0
            autonomous, flight_state, ladder = self.pilot.autonomous, self.pilot.flight_state, self.pilot.ladder
            verdict, reactions, behind_s = ladder.verdict, list(ladder.reactions), ladder.state.ages.behind_s
            ages_s = ladder.state.age_s(now_s), ladder.controls.age_s(now_s)
        told = VehicleNodeStatus(name=self.name, computer=socket.gethostname())
        told.header.stamp = rospy.Time.now()
        told.oldest_state_s, told.clock_behind_s = answer_max_s, behind_s
        self._node_status.publish(told)
        status.summary(verdict.level.value, verdict.text)  # 0 is OK, 1 a warning, 2 an error
        for key, value in (
            ("vehicle", self.name),
            ("computer", told.computer),
            ("mode", "autonomous" if autonomous else "manual"),
            ("flight state", "none yet" if flight_state is None else flight_state),
            *((what + " (Hz)", "%.1f" % rate_hz) for what, rate_hz in rates.items()),
            ("age of the state (ms)", "%.0f" % (1e3 * ages_s[0])),
            ("age of the controls (ms)", "%.0f" % (1e3 * ages_s[1])),
            ("clock behind that of the states, at least (ms)", "%.1f" % (1e3 * behind_s)),
            ("oldest state answered by a command (ms)", "%.1f" % (1e3 * answer_max_s)),
        ):
            status.add(key, value)
        for reaction in reactions:
            label = "last %s: " % reaction.level.name.lower()
            status.add(label + "age when it was ordered (ms)", "%.0f" % (1e3 * reaction.age_s))
            status.add(label + "reaction after the limit (ms)", "%.1f" % (1e3 * reaction.beyond_s))
        return status


def safety_message(verdict):
    """Verdict -> Safety."""
    message = Safety(level=verdict.level, rule=verdict.rule, operator=verdict.operator, reason=verdict.reason)
    message.header.stamp = rospy.Time.now()
    message.age_s = math.nan if verdict.age_s is None else verdict.age_s
    message.limit_s = math.nan if verdict.limit_s is None else verdict.limit_s
    return message


def _without_ladder(fleet, chosen):
    """Log that nothing protects the vehicles. Raises ValueError unless all of the fleet is a virtual laboratory's.

    chosen: FleetVehicles that are flown.
    """
    vehicles = {vehicle.namespace: vehicle for vehicle in (*(fleet.vehicles if fleet else ()), *chosen)}.values()
    reached = [fleet.mocap.host if fleet else None, *(vehicle.address for vehicle in vehicles)]
    devices = [device for vehicle in vehicles for device in vehicle.devices.values()]
    if devices or not all(address and ipaddress.ip_address(address).is_loopback for address in reached):
        raise ValueError(
            "parameter ~ladder may be false in the virtual lab only, where motion capture and all vehicles of /fleet "
            "have loopback addresses (127...) and no devices; here they have %s: leave it out"
            % ", ".join(str(at or "none") for at in (*reached, *devices))
        )
    rospy.logerr("~ladder is false: NOTHING holds or lands the vehicles when something fails. For studies only")


def _begins(who, heard_s):
    """Whether a sender that is heard now is new, or was silent before. heard_s: {name: when it was heard}, updated."""
    now_s = time.monotonic()
    before_s, heard_s[who] = heard_s.get(who, -math.inf), now_s
    return now_s - before_s > SILENCE_S


def _next_command_s(flown):
    """When the first of [(_Vehicle, its control)] is due for a command [s]; infinite when none is."""
    return min((vehicle.pilot.next_command_s for vehicle, _ in flown), default=math.inf)


def _turns_s(periods_s):
    """Start of a turn of each vehicle [s]: a few vehicles share one, which costs less than a turn each."""
    begin_s, count = time.monotonic(), len(periods_s)
    groups = min(_MOST_GROUPS, math.ceil(count / _VEHICLES_A_TURN))
    return [begin_s + period_s * (k * groups // count) / groups for k, period_s in enumerate(periods_s)]


def _chosen(values, namespace, fleet):
    """[(FleetVehicle, prefix of the topics, whether it is the only one)] of the vehicles to fly.

    values: private parameters.  fleet: Fleet or None.  Raises ValueError when it cannot be known.
    """
    known = laboratory_vehicles() if fleet is None else fleet.vehicles
    names = values.get("vehicles", "")
    names = names.split() if isinstance(names, str) else names
    if names:
        found = [vehicle for name in names for vehicle in known if fleet is not None and vehicle.namespace == name]
        if len(found) < len(names) or len(set(names)) < len(names):
            raise ValueError(
                "parameter ~vehicles must be namespaces of /fleet (%s), each once; found %s"
                % (
                    ", ".join(vehicle.namespace for vehicle in known) if fleet else "there is none: load a fleet file",
                    ", ".join(map(str, names)),
                )
            )
        prefixes = ["/%s/" % name for name in names]
    else:
        wanted, group = values.get("vehicle", ""), namespace or rospy.get_namespace().strip("/").split("/")[-1]
        found = [v for v in known if wanted == v.template or (not wanted and group == v.namespace)]
        if not found and wanted:
            found = [unplaced_vehicle(group, wanted)]
        if not found and fleet is not None and not group and len(known) == 1:
            found = known
        if not found:
            raise ValueError(
                "cannot tell which vehicle '%s' is: start the node inside the vehicle's group (%s), or set ~vehicle to "
                "its mocap template" % (group or "/", ", ".join(vehicle.namespace for vehicle in known))
            )
        prefixes = ["/%s/" % namespace if namespace else ""]
    found = [replace(vehicle, type=values.get("type", vehicle.type)) for vehicle in found]
    return [(vehicle, prefix, len(found) == 1) for vehicle, prefix in zip(found, prefixes)]


def main(namespace=""):
    """Run the node until shutdown; wrong parameters end it with one line."""
    run("risc_hand_controller", lambda: VehicleNode(namespace), low_latency.start, low_latency.spin)
