#!/usr/bin/env python3
"""mocap_data (Mocap_data) -> cortex_raw (Cortex), states3 (Landmarks). Wiring only; see risc_estimation.states."""

import sys
import threading
import time

import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from risc_control.lab.templates import load_templates
from risc_control.ros import low_latency
from risc_control.ros.diagnostics import make_updater
from risc_control.ros.params import fleet_vehicles, load_params
from risc_control.ros.until_shutdown import until_shutdown
from risc_estimation.ros.conversions import (
    cortex_from_estimate,
    header_for,
    landmarks_from_estimate,
    markers_from_msg,
)
from risc_estimation.ros.params import NodeParams
from risc_estimation.states import EstimatorParams, StatesEstimator
from risc_msgs.msg import Cortex, Landmarks, Mocap_data


class StatesEstimationNode(object):
    """Estimates the frames in order; none is passed over unless the node was held up for longer than queue_frames."""

    def __init__(self):
        params, estimator_params = load_params(NodeParams, EstimatorParams)
        self._estimator = StatesEstimator(
            load_templates(params.templates_file or None),
            estimator_params,
            params.vehicles or [v.template for v in fleet_vehicles()],
        )
        self._silence_s = params.silence_s
        self._lock = threading.Lock()  # frames, the silence timer and diagnostics have a thread each
        self._last_receipt_s = None  # monotonic clock
        self._last_header = None
        self._last_seq = None  # of the newest frame; publishers count them
        self._passed_over = self._reported_passed_over = 0  # frames
        self._last_visible = 0
        self._silent = True
        self._told_unknown = set()
        self._reported_frames, self._reported_refused, self._reported_s = 0, 0, time.monotonic()
        # Queues that hold more than a hiccup: a late subscriber gets every frame, and judges its age by the stamp.
        self._states_pub = rospy.Publisher("cortex_raw", Cortex, queue_size=100, tcp_nodelay=True)
        self._landmarks_pub = rospy.Publisher("states3", Landmarks, queue_size=100, tcp_nodelay=True)
        self._diagnostics = make_updater("mocap")
        self._diagnostics.add("states estimation", self._diagnose)
        self._timers = [rospy.Timer(rospy.Duration(1.0), lambda _event: self._diagnostics.update(), reset=True)]
        if self._silence_s > 0.0:
            self._timers.append(rospy.Timer(rospy.Duration(0.25 * self._silence_s), self._on_check, reset=True))
        for timer in self._timers:
            rospy.on_shutdown(timer.shutdown)
        rospy.Subscriber("mocap_data", Mocap_data, self._on_frame, queue_size=params.queue_frames, tcp_nodelay=True)

    @until_shutdown
    def _on_frame(self, msg):
        with self._lock:
            if self._last_seq is not None:
                self._passed_over += max(msg.header.seq - self._last_seq - 1, 0)
            self._last_seq = msg.header.seq
            estimate = self._estimator.update(msg.header.stamp.to_sec(), *markers_from_msg(msg))
            self._last_receipt_s = time.monotonic()
            if estimate is None:
                return
            self._silent = False
            self._last_header = header_for(msg.header)
            self._last_visible = int(estimate.visible.sum())
            self._states_pub.publish(cortex_from_estimate(self._last_header, estimate))
        self._landmarks_pub.publish(landmarks_from_estimate(self._last_header, estimate))

    @until_shutdown
    def _on_check(self, _event):
        """Once per silence: tell everybody that the last numbers are just that. The stamp stays what it was."""
        with self._lock:
            if self._silent or time.monotonic() - self._last_receipt_s < self._silence_s:
                return
            self._silent = True
            self._last_visible = 0
            self._states_pub.publish(cortex_from_estimate(self._last_header, self._estimator.lost()))
        rospy.logwarn("no mocap frame for %.0f ms: every vehicle is invisible", 1e3 * self._silence_s)

    def _diagnose(self, status):
        now_s = time.monotonic()
        with self._lock:
            counts = self._estimator.counts
            known, visible, last_s = len(self._estimator.names), self._last_visible, self._last_receipt_s
            numbers = [(key, value) for key, value in sorted(vars(counts).items()) if key != "unknown"]
            unknown = dict(counts.unknown)
            passed_over = self._passed_over
        refused = counts.duplicate_stamps + counts.backward_stamps
        rate_hz = (counts.frames - self._reported_frames) / max(now_s - self._reported_s, 1e-3)
        new_refused, new_passed_over = refused - self._reported_refused, passed_over - self._reported_passed_over
        self._reported_passed_over = passed_over
        self._reported_frames, self._reported_refused, self._reported_s = counts.frames, refused, now_s
        for name in sorted(set(unknown) - self._told_unknown):
            self._told_unknown.add(name)
            rospy.logwarn("no template for body '%s': it is not estimated. Add it to the templates file", name)
        if last_s is None or now_s - last_s > 1.0:
            status.summary(DiagnosticStatus.ERROR, "no mocap frames")
        elif new_refused:
            status.summary(DiagnosticStatus.WARN, "%d frames refused: stamp does not advance" % new_refused)
        elif visible < known:
            status.summary(DiagnosticStatus.WARN, "%d of %d vehicles visible" % (visible, known))
        elif new_passed_over:
            status.summary(DiagnosticStatus.WARN, "%d frames passed over: no time for them" % new_passed_over)
        elif unknown:
            status.summary(DiagnosticStatus.WARN, "bodies without a template: " + ", ".join(sorted(unknown)))
        else:
            status.summary(DiagnosticStatus.OK, "%d vehicles visible" % visible)
        status.add("rate [Hz]", "%.1f" % rate_hz)
        status.add("age of last frame [s]", "none yet" if last_s is None else "%.3f" % (now_s - last_s))
        status.add("vehicles visible", "%d of %d" % (visible, known))
        status.add("frames passed over", str(passed_over))
        status.add("unknown bodies", ", ".join(sorted(unknown)) or "none")
        for key, value in numbers:
            status.add(key, str(value))
        return status


def main():
    low_latency.start("Mocap_State_Estimator")
    try:
        StatesEstimationNode()
    except ValueError as error:
        rospy.logfatal("states_estimation.py: %s", error)
        sys.exit(1)
    low_latency.spin()


if __name__ == "__main__":
    main()
