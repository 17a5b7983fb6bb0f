#!/usr/bin/env python3
"""The virtual lab as a ROS node: adds /ground_truth, diagnostics and fault injection. Wiring only."""

import itertools
import math
import os
import queue
import signal
import sys
import threading

import diagnostic_updater
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float64, String

from risc_control.frames import wrap_angle
from risc_control.lab import fleet_from_dict, load_fleet
from risc_control.ros import low_latency
from risc_msgs.msg import Cortex, States
from risc_simulator.virtual_lab import VirtualLab, configure_fleet, raise_priority, summary, write_statistics

# Private parameters and their defaults; "" and negative numbers leave what the fleet file says.
_DEFAULTS = {
    "fleet": "",  # path of the fleet file; "": the parameter /fleet
    "seed": 0,
    "ideal": False,  # vehicles exactly as their types say
    "exact_markers": False,  # cameras without noise, loss and ghosts
    "gusts": False,
    "delay": -1.0,  # [s] nominal command delay of every vehicle
    "radio_loss": 0.0,  # fraction of the slots of every vehicle's command link that is lost
    "live": False,  # stream without waiting for a client
    "vehicles": -1,  # only the first so many
    "subnet": "",  # Cortex host at <subnet>.0.1, vehicle k at <subnet>.1.k
    "cortex_host": "",
    "cortex_port": -1,
    "stream_group": "",
    "stream_port": -1,
    "interface": "",  # address of this computer's card that the stream goes out by; "": that of the Cortex host
    "rate": -1.0,  # [Hz] of motion capture
    "stats": "",  # file for the statistics at the end
}
_DEG_PER_RAD = math.degrees(1.0)
_NODE_KEYS = {"diagnostic_period"}  # read by diagnostic_updater


def load_params():
    """Private parameters over the defaults. Raises ValueError that names the key."""
    given = rospy.get_param("~", {})
    unknown = sorted(set(given) - set(_DEFAULTS) - _NODE_KEYS)
    if unknown:
        rospy.logwarn("unknown parameters are ignored: %s; known are: %s", ", ".join(unknown), ", ".join(_DEFAULTS))
    params = dict(_DEFAULTS)
    for key, default in _DEFAULTS.items():
        value = given.get(key, default)
        if isinstance(default, str):
            if not isinstance(value, str):  # a command line makes the number 127.8 of 127.80: what was meant is lost
                raise ValueError(
                    "parameter ~%s must be a text, found %r: quote it twice on a command line (_%s:=\"'...'\"), "
                    'and give it type="str" in a launch file' % (key, value, key)
                )
        elif isinstance(value, bool) is not isinstance(default, bool) or not isinstance(value, (bool, int, float)):
            raise ValueError("parameter ~%s must be like %r, found %r" % (key, default, value))
        params[key] = type(default)(value)
    return params


def make_lab(params):
    """The lab that the parameters describe. Raises ValueError or OSError."""
    if params["fleet"]:
        fleet = load_fleet(params["fleet"])
    elif rospy.has_param("/fleet"):
        fleet = fleet_from_dict(rospy.get_param("/fleet"), "parameter /fleet")
    else:
        raise ValueError("no fleet: set ~fleet to the path of a fleet file, or load one as the parameter /fleet")

    def given(key):
        value = params[key]
        return None if value == "" or (not isinstance(value, str) and value < 0) else value

    fleet = configure_fleet(
        fleet,
        given("vehicles"),
        given("subnet"),
        given("cortex_host"),
        given("cortex_port"),
        given("stream_group"),
        given("stream_port"),
        given("rate"),
    )
    return VirtualLab(
        fleet,
        seed=params["seed"],
        honest=not params["ideal"],
        gusts=params["gusts"],
        command_delay_s=given("delay"),
        exact_markers=params["exact_markers"],
        live_on_start=params["live"],
        radio_loss=params["radio_loss"],
        interface=params["interface"],
    )


class VirtualLabNode(object):
    """Runs the lab in the main thread; callbacks only leave orders for it."""

    def __init__(self, lab):
        self._lab = lab
        self._orders = queue.SimpleQueue()
        self._last_crash = None
        self._diagnosed = (0, lab.now_s())  # frame, lab time of the last report

        self._message = Cortex()
        self._message.header.frame_id = "cortex"
        self._vehicles = list(lab.world.vehicles.values())
        self._message.Obj = [States(name=vehicle.name, visible=True) for vehicle in self._vehicles]
        # sent without waiting (risc_control.ros.direct_connection): the lab never waits for a subscriber
        self._publisher = rospy.Publisher("/ground_truth", Cortex, queue_size=50, tcp_nodelay=True)

        self._updater = diagnostic_updater.Updater()
        self._updater.setHardwareID("virtual lab %s" % lab.fleet.name)
        self._updater.add("virtual lab", self._diagnose)
        self._timer = rospy.Timer(rospy.Duration(1.0), lambda _: self._updater.force_update(), reset=True)
        rospy.on_shutdown(self._timer.shutdown)

        rospy.Subscriber("~mocap_silence", Float64, self._on_mocap_silence, queue_size=10)
        rospy.Subscriber("~hide", String, lambda msg: self._on_fault(msg, lab.hide), queue_size=10)
        rospy.Subscriber("~link_loss", String, lambda msg: self._on_fault(msg, lab.lose_link), queue_size=10)
        rospy.Subscriber("~battery", String, lambda msg: self._on_fault(msg, lab.set_battery_pct), queue_size=10)

    def after_frame(self):
        """Carry out orders, then tell the truth about the frame that has just gone out."""
        while not self._orders.empty():
            order, arguments = self._orders.get_nowait()
            try:
                order(*arguments)
            except ValueError as error:
                rospy.logerr("fault injection: %s", error)
        crashes = self._lab.world.crashes
        if crashes and crashes[-1] is not self._last_crash:
            new = list(itertools.takewhile(lambda crash: crash is not self._last_crash, reversed(crashes)))
            self._last_crash = crashes[-1]
            for crash in reversed(new):  # a collision makes two at once
                rospy.logwarn("%s %s at (%.2f, %.2f, %.2f) m", crash.namespace, crash.reason, *crash.position_m)
        if self._publisher.get_num_connections():
            self._publish()

    def _publish(self):
        age_s = self._lab.now_s() - self._lab.exposure_s
        self._message.header.stamp = rospy.Time.from_sec(rospy.get_time() - age_s)
        rows = self._lab.world.truth()
        rows[:, 8] = wrap_angle(rows[:, 8])
        rows[:, 6:] *= _DEG_PER_RAD
        for out, row in zip(self._message.Obj, rows.tolist()):
            out.x, out.y, out.z, out.u, out.v, out.w, out.phi, out.theta, out.psi, out.p, out.q, out.r = row
        try:
            self._publisher.publish(self._message)
        except rospy.ROSException:
            if not rospy.is_shutdown():
                raise

    def _on_mocap_silence(self, msg):
        if not (math.isfinite(msg.data) and msg.data >= 0.0):
            rospy.logerr("fault injection: a duration in seconds is needed, got %r", msg.data)
            return
        self._orders.put((self._lab.silence_mocap, (msg.data,)))

    def _on_fault(self, msg, order):
        name, _, number = msg.data.strip().rpartition(" ")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not name or not (math.isfinite(value) and value >= 0.0):
            rospy.logerr("fault injection: send 'NAME NUMBER' (e.g. 'risc1 1.5'), got %r", msg.data)
            return
        self._orders.put((order, (name.strip(), value)))

    def _diagnose(self, status):
        lab = self._lab
        frame, now_s = lab.frame, lab.now_s()
        rate_hz = (frame - self._diagnosed[0]) / max(now_s - self._diagnosed[1], 1e-3)
        self._diagnosed = frame, now_s
        on_time = rate_hz > 0.95 * lab.fleet.mocap.rate_hz
        status.summary(
            DiagnosticStatus.OK if on_time else DiagnosticStatus.WARN,
            "on schedule" if on_time else "behind its schedule: the computer is too busy",
        )
        status.add("frames", frame)
        status.add("rate (Hz)", "%.1f" % rate_hz)
        status.add("late p99 (ms)", "%.2f" % (1e3 * lab.lateness.percentile_s(99.0)))
        status.add("late max (ms)", "%.2f" % (1e3 * lab.lateness.max_s))
        status.add("stalls", lab.stalls)
        status.add("crashes", len(lab.world.crashes))
        for vehicle in self._vehicles:
            status.add(vehicle.namespace, vehicle.phase.value)
        return status


def handle_signals(handler):
    """Call handler when the process is asked to end."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def main():
    """Run until ROS shuts down. Returns the exit code."""
    handle_signals(lambda *_: rospy.signal_shutdown("signal"))  # while it waits for a master
    try:
        low_latency.start("virtual_lab", disable_signals=True)
    except rospy.ROSException:
        return 1
    # rospy's own handlers would spend half a second inside the schedule; these let the lab finish its frame
    stop_event = threading.Event()
    rospy.on_shutdown(stop_event.set)
    handle_signals(lambda *_: stop_event.set())
    try:
        params = load_params()
        lab = make_lab(params)
    except (ValueError, OSError) as error:
        rospy.logfatal("virtual lab: %s", error)
        rospy.signal_shutdown("the lab could not start")
        return 1
    try:
        node = VirtualLabNode(lab)
        rospy.loginfo("%s", lab.describe())
        raise_priority()
        lab.run(stop_event, on_frame=node.after_frame)
        statistics = lab.statistics()
    finally:
        lab.close()
        rospy.signal_shutdown("the lab has closed")
    print(summary(statistics), flush=True)
    if params["stats"]:
        try:
            write_statistics(statistics, os.path.expanduser(params["stats"]))
        except OSError as error:
            print("virtual lab: cannot write the statistics: %s" % error, file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
