#!/usr/bin/env python3
"""mocap_data (Mocap_data), mocap_unidentified (UnidentifiedMarkers) -> cortex_raw (Cortex), states3 (Landmarks).

While somebody listens: mocap_poses (BodyPoses), state_covariances (StateCovariances, of a filter that has them). If the
filter wants it: what vehicles measure on board and what they were sent. See risc_estimation.state_estimator.
"""

import math
import threading
import time

import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from roslib.message import get_message_class
from rospy.numpy_msg import numpy_msg
from std_msgs.msg import Header

from risc_estimation import sensors
from risc_estimation.filters import COMMAND, DEFAULT, REGISTRY
from risc_estimation.pose_fit import NOTHING, PoseFitParams
from risc_estimation.ros.conversions import EstimateMessages, covariances_to_msg, poses_to_msg
from risc_estimation.ros.params import NodeParams
from risc_estimation.state_estimator import StatesEstimator
from risc_lab.command_history import command_of
from risc_lab.lab.fleet import MocapEndpoint
from risc_lab.lab.templates import load_templates
from risc_lab.ros import low_latency
from risc_lab.ros.diagnostics import Growth, add_all, summarise, ticking_updater
from risc_lab.ros.fleet_messages import CortexArrays, LandmarksArrays, MocapArrays
from risc_lab.ros.node import run
from risc_lab.ros.paced_subscriber import BUFFER_BYTES
from risc_lab.ros.params import known_arena, known_fleet, load_params
from risc_lab.ros.ticker import Ticker
from risc_lab.ros.until_shutdown import until_shutdown
from risc_maap_msgs.msg import (
    BodyPoses,
    CommandsSent,
    Counter,
    EstimatorStatus,
    MarkerCount,
    StateCovariances,
    UnidentifiedMarkers,
)

_GAP_PERIODS = 1.5  # of frames; after so long without one it is missing
_MATE_S = 0.001  # a frame waits so long for its markers without a label, which come on a connection of their own

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class StatesEstimationNode:
    """Estimates the frames in order; none is passed over unless the node was held up for longer than queue_s."""

    def __init__(self):
        name, fleet = rospy.get_param("~filter", DEFAULT), known_fleet()
        kind = REGISTRY.module(name).Filter
        params, fit_params, settings = load_params(
            NodeParams, PoseFitParams().within(known_arena()), REGISTRY.settings(name, kind.PARAMS)
        )
        vehicles = fleet.vehicles if fleet else ()
        rate_hz = fleet.mocap.rate_hz if fleet else MocapEndpoint.rate_hz
        self._estimator = StatesEstimator(
            load_templates(params.templates_file or None, fleet),
            fit_params,
            params.vehicles or [vehicle.template for vehicle in vehicles],
            kind(settings),
            {vehicle.template: vehicle.vehicle_type for vehicle in vehicles},
        )
        self._period_s = 1.0 / rate_hz
        self._silence_s = params.silence_s
        self._lock = threading.Condition()  # frames, the silence timer and diagnostics have a thread each
        self._loose_ns, self._loose_m = -1, NOTHING  # the newest markers without a label: stamp, (u, 3) [m]
        self._told_exchanged = set()
        self._last_receipt_s = None  # of the newest frame that was estimated; monotonic clock
        self._last_said_s = -math.inf  # when states were published that somebody is visible in; the same
        self._delay_s = 0.0  # from exposure to estimate, of the newest frame
        self._last_estimate = None
        self._last_seq = None  # of the newest frame; publishers count them
        self._passed_over = 0  # frames
        self._silent = True
        self._told_unknown = set()
        self._growth = Growth()
        # Queues that hold more than a hiccup: a late subscriber gets every frame, and judges its age by the stamp.
        self._states_pub = rospy.Publisher("cortex_raw", CortexArrays, queue_size=100, tcp_nodelay=True)
        self._landmarks_pub = rospy.Publisher("states3", LandmarksArrays, queue_size=100, tcp_nodelay=True)
        self._poses_pub = rospy.Publisher("mocap_poses", BodyPoses, queue_size=100, tcp_nodelay=True)
        self._covariances_pub = rospy.Publisher("state_covariances", StateCovariances, queue_size=100, tcp_nodelay=True)
        self._frame, self._messages = MocapArrays(), EstimateMessages()
        self._status_pub = rospy.Publisher("estimator_status", EstimatorStatus, queue_size=10, tcp_nodelay=True)
        ticking_updater("mocap").add("states estimation", self._diagnose)
        if self._silence_s > 0.0:
            Ticker(0.25 * self._silence_s, self._on_check, "the watch for silence")
        if kind.COASTS:
            Ticker(self._period_s, self._on_gap, "states between frames")
        self._listen_on_board(self._estimator.on_board_wanted, vehicles)
        kind = numpy_msg(UnidentifiedMarkers)
        rospy.Subscriber("mocap_unidentified", kind, self._on_unidentified, queue_size=100, tcp_nodelay=True)
        rospy.Subscriber(
            "mocap_data",
            MocapArrays.Raw,
            self._on_frame,
            queue_size=params.queue_frames(rate_hz),
            buff_size=BUFFER_BYTES,
            tcp_nodelay=True,
        )

    def _listen_on_board(self, wanted, vehicles):
        """Subscribe to what the filter wants, and to nothing else."""
        if COMMAND in wanted:
            rospy.Subscriber("/commands_sent", CommandsSent, self._on_commands, queue_size=100, tcp_nodelay=True)
        if wanted <= {COMMAND}:
            return
        for vehicle in vehicles:
            kind = sensors.of_type(vehicle.type)
            if kind is not None:
                topic, its_class = "/%s/%s" % (vehicle.namespace, kind.TOPIC), get_message_class(kind.TYPE)
                arguments = vehicle.template, kind
                rospy.Subscriber(topic, its_class, self._on_readings, arguments, queue_size=10, tcp_nodelay=True)

    @until_shutdown
    def _on_commands(self, message):
        with self._lock:
            for sent in message.commands:
                self._estimator.on_board(sent.name, sent.sent.to_sec(), COMMAND, command_of(sent))

    @until_shutdown
    def _on_readings(self, message, arguments):
        with self._lock:
            sensors.give(self._estimator, *arguments, message)

    @until_shutdown
    def _on_unidentified(self, message):
        with self._lock:
            self._loose_ns, self._loose_m = message.header.stamp.to_nsec(), message.positions.reshape(-1, 3)
            self._lock.notify_all()

    def _loose_of(self, stamp):
        """(u, 3) markers without a label of the frame with this stamp [m], as far as they have come."""
        stamp_ns = stamp.to_nsec()
        newest = stamp_ns - self._loose_ns < 2e9 * self._period_s  # the frame before had some
        if newest and self._estimator.misses_a_body:
            self._lock.wait_for(lambda: self._loose_ns >= stamp_ns, _MATE_S)
        return self._loose_m if self._loose_ns == stamp_ns else NOTHING

    @until_shutdown
    def _on_frame(self, message):
        with self._lock:
            frame = self._frame.deserialize(message.buff)
            header = frame.header
            if self._last_seq is not None:
                self._passed_over += max(header.seq - self._last_seq - 1, 0)
            self._last_seq = header.seq
            taken = self._estimator.frames
            loose_m = self._loose_of(header.stamp)
            estimate = self._estimator.update(header.stamp.to_sec(), frame.layout.entries, frame.markers_m, loose_m)
            if self._estimator.frames == taken:
                return  # frames that are refused are silence, too
            self._last_receipt_s = time.monotonic()
            if estimate is None:
                return  # states of later were given already
            self._last_estimate, self._silent, self._last_said_s = estimate, False, self._last_receipt_s
            self._delay_s = max(0.0, rospy.get_time() - estimate.stamp_s)
            self._states_pub.publish(self._messages.states(header, estimate))
            self._landmarks_pub.publish(self._messages.landmarks(header, estimate))
            if self._poses_pub.get_num_connections():
                self._poses_pub.publish(poses_to_msg(header, self._estimator.poses))
            if self._covariances_pub.get_num_connections():
                covariances = self._estimator.covariances()
                if covariances is not None:
                    self._covariances_pub.publish(covariances_to_msg(header, estimate.names, covariances))

    @until_shutdown
    def _on_gap(self):
        """A frame is missing: states that the filter predicts, as old as those of the frames before it were."""
        with self._lock:
            stamp_s, last = rospy.get_time() - self._delay_s, self._last_estimate
            if last is None or stamp_s - last.stamp_s < _GAP_PERIODS * self._period_s:
                return
            estimate = self._estimator.coast(stamp_s)
            if estimate is not None:
                self._last_estimate, self._silent, self._last_said_s = estimate, False, time.monotonic()
                header = Header(stamp=rospy.Time.from_sec(estimate.stamp_s), frame_id=self._frame.header.frame_id)
                self._states_pub.publish(self._messages.states(header, estimate))

    @until_shutdown
    def _on_check(self):
        """Once per silence: tell everybody that the last numbers are just that. The stamp stays what it was."""
        with self._lock:
            if self._silent or time.monotonic() - self._last_said_s < self._silence_s:
                return
            self._silent = True
            self._last_estimate = lost = self._estimator.lost()
            self._states_pub.publish(self._messages.states(None, lost))
        rospy.logwarn("no mocap frame for %.0f ms: every vehicle is invisible", 1e3 * self._silence_s)

    def _diagnose(self, status):
        """Diagnostics for people; what other programs use of it goes out as an EstimatorStatus."""
        now_s = time.monotonic()
        with self._lock:
            counts, names = self._estimator.counts, self._estimator.names
            last_s, silent = self._last_receipt_s, self._silent
            visible = 0 if self._last_estimate is None else int(self._last_estimate.visible.sum())
            bodies, passed_over = zip(names, self._estimator.status()), self._passed_over
            poses = self._estimator.poses
            seen = zip(names, poses.marker_counts, poses.present.tolist())
            markers = [MarkerCount(name, *counts) for name, counts, is_present in seen if is_present]
        numbers = {
            key: value for key, value in sorted(vars(counts).items()) if key not in ("unknown", "exchanged", "frames")
        }
        known, unknown = len(names), sorted(counts.unknown)
        refused = counts.duplicate_stamps + counts.backward_stamps
        new, rates_hz = self._growth({"frames": counts.frames, "refused": refused, "passed over": passed_over})
        told = EstimatorStatus(
            rate_hz=rates_hz["frames"],
            age_s=math.nan if last_s is None else now_s - last_s,
            vehicles=known,
            visible=visible,
            frames=counts.frames,
            passed_over=passed_over,
            counters=[Counter(*item) for item in numbers.items()],
            markers=markers,
            unknown_bodies=unknown,
        )
        told.header.stamp = rospy.Time.now()
        self._status_pub.publish(told)
        for name in unknown:
            if name not in self._told_unknown:
                self._told_unknown.add(name)
                rospy.logwarn("no template for body '%s': it is not estimated. Add it to the templates file", name)
        for pair in set(counts.exchanged) - self._told_exchanged:
            self._told_exchanged.add(pair)
            rospy.logwarn(
                "motion capture says '%s' to what is '%s': both are told apart. Correct the names there", *pair[::-1]
            )
        silence = not told.age_s <= 1.0
        summarise(
            status,
            (silence and new["refused"], ERROR, "all mocap frames are refused: their stamps do not advance"),
            (silence, ERROR, "no mocap frames"),
            (new["refused"], WARN, "%d frames refused: stamp does not advance" % new["refused"]),
            (visible < known, WARN, "%d of %d vehicles visible" % (visible, known)),
            (new["passed over"], WARN, "%d frames passed over: no time for them" % new["passed over"]),
            (unknown, WARN, "bodies without a template: " + ", ".join(unknown)),
            (True, OK, "%d vehicles visible" % visible),
        )
        add_all(
            status,
            {
                "rate [Hz]": "%.1f" % told.rate_hz,
                "age of last frame [s]": "none yet" if last_s is None else "%.3f" % told.age_s,
                "vehicles visible": "%d of %d" % (visible, known),
                "frames passed over": passed_over,
                "unknown bodies": ", ".join(unknown) or "none",
                **{name: "no frames" if silent else state.name.lower() for name, state in bodies},
                "frames": counts.frames,
                **numbers,
            },
        )
        return status


if __name__ == "__main__":
    run("Mocap_State_Estimator", StatesEstimationNode, low_latency.start, low_latency.spin)
