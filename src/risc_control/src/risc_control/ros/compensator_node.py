"""Wiring of the delay compensation: /cortex_raw and /commands_sent -> /cortex_estimate. See `lag_compensator`.

The node of the original is `rosrun risc_estimation Lag_compensator.py`. Its states are predicted to the time when a
command that is sent now takes effect; the stamp is that of the input states, by which their age is judged. It is for
controllers that do not predict themselves; those of `controllers` do.
"""

import threading
from dataclasses import dataclass

import numpy as np
import rospy

from risc_control.lag_compensator import LagCompensator
from risc_control.ros.conversions import StatesMessage, StatesReader, note_commands
from risc_lab.clock_guard import ClockGuard, Step
from risc_lab.lab.vehicle_types import LEGACY_PARAMETERS
from risc_lab.ros import low_latency
from risc_lab.ros.clock import ros_time_s
from risc_lab.ros.diagnostics import Growth, add_all, summarise, ticking_updater
from risc_lab.ros.fleet_messages import CortexArrays
from risc_lab.ros.guard import subscribe
from risc_lab.ros.node import run
from risc_lab.ros.paced_subscriber import BUFFER_BYTES
from risc_lab.ros.params import VEHICLE_KEYS, load_params, told_vehicle_type, vehicles
from risc_lab.settings import Name, Settings, between
from risc_maap_msgs.msg import CommandsSent


@dataclass(frozen=True)
class CompensatorParams(Settings):
    """Parameters of the node; vehicles and types are set as for the controllers."""

    states_topic: Name = "/cortex_raw"  # or /cortex_ekf
    state_timeout: between(0.0, 0.2) = 0.2  # [s] older states are not predicted: no vehicle is visible


class CompensatorNode:
    """Answers every message of states with one of predicted states."""

    def __init__(self):
        (params,) = load_params(CompensatorParams, known=(*VEHICLE_KEYS, *LEGACY_PARAMETERS), lenient=True)
        fleet_vehicles, private = vehicles(), rospy.get_param("~", {})
        names = [vehicle.template for vehicle in fleet_vehicles]
        self._compensator = LagCompensator([told_vehicle_type(vehicle, private) for vehicle in fleet_vehicles])
        self._timeout_s, self._topic = params.state_timeout, rospy.resolve_name(params.states_topic)
        self._index = {name: i for i, name in enumerate(names)}
        self._reader, self._message = StatesReader(names), StatesMessage(names)
        self._stamps, self._nobody = ClockGuard(), np.zeros(len(names), dtype=bool)
        self._lock = threading.Lock()  # states and commands have a thread each
        self._counts, self._growth = dict.fromkeys(("states", "late", "commands"), 0), Growth()
        self._publisher = rospy.Publisher("/cortex_estimate", CortexArrays, queue_size=1, tcp_nodelay=True)
        ticking_updater(", ".join(names)).add("delay compensation", self._diagnose)
        subscribe("/commands_sent", CommandsSent, self._on_commands, queue_size=None)
        subscribe(self._topic, CortexArrays.Raw, self._on_states, queue_size=1, buff_size=BUFFER_BYTES)
        delays = ["%s %.0f ms" % item for item in zip(names, 1e3 * self._compensator.delay_s)]
        rospy.loginfo("%s looks ahead: %s", rospy.get_name(), ", ".join(delays))

    def _on_commands(self, message):
        with self._lock:
            noted = note_commands(message, self._index, self._compensator.sent, self._timeout_s)
            self._counts["commands"] += noted

    def _on_states(self, message):
        with self._lock:
            header, states = self._reader.read(message.buff)
            stamp_s, now_s = header.stamp.to_sec(), ros_time_s()
            if self._stamps.look(stamp_s) is Step.NEW_CLOCK:
                self._compensator.sent.clear()
            self._counts["states"] += 1
            if abs(now_s - stamp_s) > self._timeout_s:
                self._counts["late"] += 1
                states = states._replace(visible=self._nobody)
            else:
                states = self._compensator.ahead(stamp_s, now_s, states)
            self._publisher.publish(self._message.fill(header, states))

    def _diagnose(self, status):
        with self._lock:
            _, rates = self._growth(self._counts)
        summarise(
            status,
            (rates["states"] == 0.0, 1, "no states on " + self._topic),
            (rates["late"] > 0.0, 1, "states are too old to be predicted"),
            (rates["commands"] == 0.0, 1, "no /commands_sent: states are passed on as they came"),
            (True, 0, "looking ahead"),
        )
        add_all(status, {"%s (Hz)" % what: "%.1f" % rate for what, rate in rates.items()})
        return status


if __name__ == "__main__":
    run("Compensator", CompensatorNode, low_latency.start, low_latency.spin)
