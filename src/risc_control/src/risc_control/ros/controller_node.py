"""Wiring of the controller nodes: states and /trajectory -> /controls. The work is in `controllers`."""

import threading
import time
from dataclasses import dataclass, fields, replace
from types import SimpleNamespace

import numpy as np
import rospy
from dynamic_reconfigure.server import Server
from rospy.numpy_msg import numpy_msg
from std_msgs.msg import Bool, UInt8

from risc_control.controllers import ControlLoop, default_params, descriptions, own_params
from risc_control.reference_buffer import Axis, Order, ReferenceBuffer
from risc_control.ros.conversions import ControlsMessage, StatesReader, covariances_of, note_commands
from risc_control.vehicles import adapter_class
from risc_lab.clock_guard import ClockGuard, Step
from risc_lab.lab.templates import attached_bodies, load_templates
from risc_lab.lab.vehicle_types import FULL_SCALES, LEGACY_PARAMETERS
from risc_lab.ros import low_latency
from risc_lab.ros.clock import ros_time_s
from risc_lab.ros.diagnostics import Growth, add_all, summarise, ticking_updater
from risc_lab.ros.fleet_messages import ControlsArrays, CortexArrays, TrajectoriesArrays
from risc_lab.ros.guard import subscribe
from risc_lab.ros.node import run
from risc_lab.ros.paced_subscriber import BUFFER_BYTES, PacedSubscriber
from risc_lab.ros.params import VEHICLE_KEYS, known_fleet, load_params, told_vehicle_type, vehicles
from risc_lab.settings import Name, Positive, Settings, limits_of, settings_from
from risc_maap_msgs.msg import (
    CommandsSent,
    ControllerReport,
    StateCovariances,
    TrackingError,
    TrajectoryDerivatives,
    VehicleStatus,
)

_REFERENCES_HZ = 50.0  # read of 200: the polynomial through them is good far beyond the command delay
_RAW = "/cortex_raw"
_AGAIN_S = 10.0  # between two warnings of the same kind


@dataclass(frozen=True)
class ControllerParams(Settings):
    """Parameters of the node; those of its controller are private parameters, too, named as in its YAML file."""

    controller: str  # name of a controller, see `controllers`
    vehicle_type: str = ""  # of all vehicles; "": that of the fleet file
    # topic of the states; /cortex_ekf: those of quad_EKF.py. Vehicle nodes always judge safety by /cortex_raw
    states_topic: Name = _RAW
    state_timeout: Positive = 0.2  # [s] no command for an older state
    reference_timeout: Positive = 0.2  # [s] no command for a vehicle whose newest reference is older


class ControllerNode:
    """Runs a controller on every state. Subclasses may bring their own references (`_references`)."""

    def __init__(self, controller, fleet_vehicles=None, known=()):
        """controller: name, unless ~controller is set.  known: private parameters that are read elsewhere."""
        defaults = default_params(rospy.get_param("~controller", controller))
        known = (*known, *VEHICLE_KEYS, *LEGACY_PARAMETERS)
        node, params = load_params(ControllerParams(controller), defaults, known=known, lenient=True)
        others = other_numbers(params, defaults)
        if others:
            rospy.logwarn(others, rospy.get_name())
        fleet_vehicles = vehicles() if fleet_vehicles is None else fleet_vehicles
        fleet_vehicles = [replace(vehicle, type=node.vehicle_type or vehicle.type) for vehicle in fleet_vehicles]
        self.names = [vehicle.template for vehicle in fleet_vehicles]
        self._index, self._kind = {name: i for i, name in enumerate(self.names)}, node.controller
        private = rospy.get_param("~", {})
        types = [told_vehicle_type(vehicle, private) for vehicle in fleet_vehicles]
        self._states_topic = rospy.resolve_name(node.states_topic)
        self._state_timeout_s, self._reference_timeout_s = node.state_timeout, node.reference_timeout
        own = own_params(node.controller, fleet_vehicles, "parameter /fleet")
        self._loop = ControlLoop(node.controller, types, params, own)
        # for the vehicle nodes, which compare them with their own
        of_types = [{field: getattr(vehicle_type, field) for field in FULL_SCALES} for vehicle_type in types]
        rospy.set_param("~full_scales", dict(zip(self.names, of_types)))
        # A vehicle whose status was not heard may be one without vehicle node: its commands count as sent.
        self._autonomous = np.ones(len(self.names), dtype=bool)
        self._buffers = {}  # names of a message -> (ReferenceBuffer, rows, columns of the message)
        self._lock = threading.Lock()
        self._stamps = ClockGuard()  # of the states
        counted = "states", "saturated", "without command", "not finite", "late", "refused references"
        self._counts = dict.fromkeys(counted, 0)
        self._growth = Growth()
        self._cycle_max_s = self._age_max_s = 0.0
        self._answered = None  # (reference, States, (n,) bool: has both) of the newest states
        self._covariances, self._covariances_s = None, -np.inf  # `Bundle.covariances`, and the stamp of their frame
        self._attached = attached_bodies(load_templates(fleet=known_fleet()))
        self._everyone = list(range(len(self.names)))
        self._reader = StatesReader(self.names, [vehicle.carries for vehicle in fleet_vehicles])
        self._message = ControlsMessage(self.names)
        self._trajectories = TrajectoriesArrays()
        self._publisher = rospy.Publisher("/controls", ControlsArrays, queue_size=1, tcp_nodelay=True)
        self._report = rospy.Publisher("/controller_report", ControllerReport, queue_size=10, tcp_nodelay=True)
        ticking_updater(", ".join(self.names)).add("controller", self._diagnose)
        config = reconfigurable(params, descriptions(node.controller))
        for name, value in config.defaults.items():
            rospy.set_param("~" + name, value)  # where the server reads it; a text there would end the server
        self._server = Server(config, self._on_reconfigure)
        for i, (vehicle, vehicle_type) in enumerate(zip(fleet_vehicles, types)):
            topic = "/%s/controller_status" % vehicle.namespace
            subscribe(topic, Bool, self._on_status, i, queue_size=1)
            if adapter_class(vehicle_type).NEEDS_BATTERY:
                topic = "/%s/vehicle_status" % vehicle.namespace
                subscribe(topic, VehicleStatus, self._on_vehicle_status, i, queue_size=1)
        subscribe("/commands_sent", CommandsSent, self._on_commands_sent, queue_size=None)
        self._subscribe()
        rospy.loginfo(
            "%s controls %s by %s and %s, acting %.0f ms ahead",
            rospy.get_name(),
            ", ".join(self.names),
            node.controller,
            self._states_topic,
            1e3 * self._loop.controller.delay_s.max(),
        )

    def _subscribe(self):
        order = self._loop.controller.ORDER
        if order > Order.SNAP:
            self._ask = rospy.Publisher("/reference_order", UInt8, queue_size=1, latch=True)
            self._ask.publish(order)
            topic, kind, callback = "/trajectory_derivatives", numpy_msg(TrajectoryDerivatives), self._on_derivatives
        else:
            topic, kind, callback = "/trajectory", TrajectoriesArrays.Raw, self._on_trajectory
        self._references_in = PacedSubscriber(topic, kind, callback, _REFERENCES_HZ)
        if self._loop.controller.COVARIANCES and self._states_topic == _RAW:  # those of /cortex_ekf are not published
            _hear_newest("/state_covariances", StateCovariances, self._on_covariances)
        self._subscribe_to_states()

    def _subscribe_to_states(self):
        _hear_newest(self._states_topic, CortexArrays.Raw, self._on_states)

    def _on_reconfigure(self, config, _level):
        """New parameters in flight; impossible ones are rejected, and the old ones stay."""
        params = self._loop.params
        numbers = {item.name: config[item.name] for item in fields(params) if item.name in config}
        try:
            self._loop.set_params(settings_from(type(params), {**vars(params), **numbers}))  # these must be finite
        except ValueError as error:
            rospy.logerr("controller parameters rejected: %s", error)
            config.update({name: getattr(params, name) for name in numbers})
        return config

    def _on_commands_sent(self, message):
        with self._lock:
            note_commands(message, self._index, self._loop.sent, self._state_timeout_s)

    def _on_covariances(self, message):
        found, stamp_s = covariances_of(message, self._index), message.header.stamp.to_sec()
        with self._lock:
            self._covariances, self._covariances_s = found, stamp_s

    def _on_status(self, message, i):
        self._autonomous[i] = message.data

    def _on_vehicle_status(self, message, i):
        self._loop.tell_battery(i, message.battery_pct, time.monotonic())

    def _on_trajectory(self, message):
        with self._lock:
            trajectories = self._trajectories.deserialize(message.buff)
            stamp_s = trajectories.header.stamp.to_sec()
            if stamp_s:
                self._take(trajectories.names, stamp_s, trajectories.derivatives.swapaxes(0, 1))
        if not stamp_s:
            rospy.logwarn_throttle(
                10.0, "/trajectory has no stamp and is not flown: set header.stamp to the time that it is meant for"
            )

    def _on_derivatives(self, message):
        names = tuple(message.names)
        with self._lock:
            self._take(names, message.header.stamp.to_sec(), message.derivatives.reshape(-1, len(names), len(Axis)))

    def _take(self, names, stamp_s, sample):
        entry = self._buffers.get(names)
        if entry is None:
            entry = self._buffers[names] = self._new_buffer(names)
        buffer, _, columns = entry
        taken = buffer.push(stamp_s, sample)
        without = [names[k] for k in columns if not buffer.known[k]]
        if not taken or without:
            self._counts["refused references"] += 1
        if without:
            text = "the reference is not finite, no command is sent: %s"
            rospy.logwarn_throttle(_AGAIN_S, text, ", ".join(without))

    def _new_buffer(self, names):
        columns = [k for k, name in enumerate(names) if name in self._index]
        unknown = sorted(set(names) - set(self._index))
        if unknown:
            rospy.logwarn(
                "/trajectory names %s, which this controller does not fly (it flies %s): a trajectory's name must be "
                "its vehicle's",
                ", ".join(unknown),
                ", ".join(self.names),
            )
        return ReferenceBuffer(self._loop.controller.ORDER), [self._index[names[k]] for k in columns], columns

    def _on_states(self, message):
        started_s = time.perf_counter()
        with self._lock:
            header, states = self._reader.read(message.buff)
            bodies = self._reader.bodies
            stamp_s, now_s = header.stamp.to_sec(), ros_time_s()
            step = self._stamps.look(stamp_s)
            if step is Step.REFUSED:
                return
            if step is Step.NEW_CLOCK:
                self._loop.forget_times()
            age_s = now_s - stamp_s
            if abs(age_s) > self._state_timeout_s:
                # a state this old does not tell what to do now
                self._counts["late"] += 1
                states, bodies = states._replace(visible=np.zeros(len(self.names), dtype=bool)), None
            sent_s = min(now_s, stamp_s + self._state_timeout_s)
            values, usable = self._references(self._loop.times_s(stamp_s, sent_s), now_s)
            present, ahead = self._loop.pick(values)
            fresh = abs(stamp_s - self._covariances_s) <= self._state_timeout_s
            told = states, present, ahead, usable, self._autonomous, bodies, self._covariances if fresh else None
            output = self._loop.update(stamp_s, sent_s, *told)
            # Without commands for a vehicle the safety ladder of its node acts: hold, then land. A command that is
            # based on no state or no reference would look like a sign of life.
            asked = usable & states.visible
            known = asked & output.finite
            self._publisher.publish(self._message.fill(header.stamp, output.controls, known))
            self._updated()
            self._answered = present, states, known
            counts = self._counts
            counts["states"] += 1
            counts["saturated"] += np.count_nonzero(output.saturated) > 0
            counts["without command"] += np.count_nonzero(known) < len(known)
            broken = np.count_nonzero(known) < np.count_nonzero(asked)
            counts["not finite"] += broken
            self._age_max_s = max(self._age_max_s, age_s)
            self._cycle_max_s = max(self._cycle_max_s, time.perf_counter() - started_s)
            unknown = self._reader.unknown
        if broken:
            names = ", ".join(name for name, is_broken in zip(self.names, asked & ~known) if is_broken)
            text = "the controller '%s' computes a command that is not finite: none is sent for %s"
            rospy.logerr_throttle(_AGAIN_S, text, self._kind, names)
        if unknown and not self._attached.issuperset(unknown):
            text = "%s shows %s, which this controller does not fly"
            rospy.logwarn_throttle(60.0, text, self._states_topic, ", ".join(unknown))

    def _updated(self):
        """For subclasses: called after every update of the controller, with the lock held."""

    def _references(self, times_s, now_s):
        """(references (k, orders, n, 4) at times (k,), (n,) bool: the vehicle has a fresh one)."""
        fresh = [e for e in self._buffers.values() if abs(now_s - e[0].newest_s) <= self._reference_timeout_s and e[1]]
        if len(fresh) == 1 and fresh[0][1] == self._everyone == fresh[0][2]:
            return fresh[0][0].at(times_s), fresh[0][0].known
        n = len(self.names)
        values, usable = np.zeros((len(times_s), self._loop.controller.ORDER + 1, n, 4)), np.zeros(n, dtype=bool)
        for buffer, rows, columns in sorted(fresh, key=lambda entry: entry[0].newest_s):
            values[:, :, rows] = buffer.at(times_s)[:, :, columns]
            usable[rows] = buffer.known[columns]
        return values, usable

    def _diagnose(self, status):
        """Diagnostics for people; values that other programs use are published as a ControllerReport."""
        with self._lock:
            _, rates = self._growth(self._counts)
            cycle_s, age_s, answered = self._cycle_max_s, self._age_max_s, self._answered
            self._cycle_max_s = self._age_max_s = 0.0
        summarise(
            status,
            (rates["states"] == 0.0, 1, "no states on " + self._states_topic),
            (rates["not finite"] > 0.0, 2, "the controller computes commands that are not finite: they are not sent"),
            (rates["without command"] > 0.0, 1, "a vehicle is not seen or has no fresh reference: no command for it"),
            (True, 0, "controlling"),
        )
        errors_m = _errors_m(*answered) if answered else [np.nan] * len(self.names)
        report = ControllerReport(oldest_state_s=age_s)
        report.header.stamp = rospy.Time.now()
        report.vehicles = [TrackingError(*item) for item in zip(self.names, errors_m)]
        self._report.publish(report)
        values = {"%s (Hz)" % what: "%.1f" % rate for what, rate in rates.items()}
        values["oldest state answered (ms)"] = "%.1f" % (1e3 * age_s)
        values["longest cycle (ms)"] = "%.2f" % (1e3 * cycle_s)
        values |= {"position error of %s (mm)" % name: "%.1f" % (1e3 * m) for name, m in zip(self.names, errors_m)}
        values["autonomous"] = ", ".join(np.array(self.names)[self._autonomous].tolist()) or "none"
        add_all(status, values)
        return status


def other_numbers(params, defaults):
    """Text that lists the parameters not as in a controller's YAML file, with a %s for the node's name; "" if none."""
    values = zip(vars(params).items(), vars(defaults).values())
    others = ["%s %s (%s)" % (name, value, of_file) for (name, value), of_file in values if value != of_file]
    text = (
        "not as in the YAML file (whose value): %s. The launch file says so, or dynamic_reconfigure has left it here "
        "in a run before: 'rosparam delete %%s/NAME' and another start bring the file's back"
    )
    return text % ", ".join(others) if others else ""


def reconfigurable(params, texts):
    """Description of a controller's numbers for dynamic_reconfigure: what a .cfg file would generate.

    texts: {name: description}.

    Ranges are the limits of the class. A limit that is itself excluded, as the 0 of `Positive`, the class refuses.
    """
    limits = limits_of(type(params))
    numbers = {name: value for name, value in vars(params).items() if isinstance(value, float)}
    parameter = {"type": "double", "level": 0, "edit_method": ""}
    parameters = [{"name": name, "description": texts.get(name, ""), **parameter} for name in numbers]
    group = {"name": "Default", "type": "", "state": True, "id": 0, "parent": 0, "groups": []}
    return SimpleNamespace(
        config_description={**group, "parameters": parameters},
        defaults=numbers,
        min={name: limits[name][0] for name in numbers},
        max={name: limits[name][1] for name in numbers},
    )


def _hear_newest(topic, kind, callback):
    """Subscribe to a topic; of the messages that are waiting only the newest is handled."""
    subscribe(topic, kind, callback, queue_size=1, buff_size=BUFFER_BYTES)


def _errors_m(reference, states, known):
    """(n,) distances between references and positions; NaN: not seen, or no reference."""
    off_m = np.sqrt(((reference[0, :, :3] - states.position_m) ** 2).sum(axis=1))
    return np.where(known, off_m, np.nan)


def main(name, make_node):
    """Run a node with low latency until shutdown; wrong parameters end it with one line."""
    run(name, make_node, low_latency.start, low_latency.spin)
