"""What ROS sees of the virtual lab: its parameters, /ground_truth, diagnostics and fault injection."""

import itertools
import math
import queue

import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float64

from risc_lab.frames import wrap_angle
from risc_lab.lab import load_fleet
from risc_lab.ros.diagnostics import Growth, make_updater
from risc_lab.ros.fleet_messages import CortexArrays
from risc_lab.ros.params import known_fleet, load_params
from risc_lab.ros.ticker import Ticker
from risc_maap_msgs.msg import Fault, WireFault
from risc_simulator.virtual_lab import LabOptions

_DEG_PER_RAD = math.degrees(1.0)


def load_options():
    """LabOptions of the private parameters. Raises ValueError that names the key."""
    subnet = rospy.get_param("~subnet", "")
    if not isinstance(subnet, str):  # a command line makes the number 127.8 of 127.80: what was meant is lost
        raise ValueError(
            "parameter ~subnet must be a text, found %r: quote it twice on a command line (_subnet:=\"'...'\"), and "
            'give it type="str" in a launch file' % (subnet,)
        )
    (options,) = load_params(LabOptions)
    return options


def make_lab(options):
    """The lab that they describe. Raises ValueError or OSError."""
    fleet = load_fleet(options.fleet) if options.fleet else known_fleet()
    if fleet is None:
        raise ValueError("no fleet: set ~fleet to the path of a fleet file, or load one as the parameter /fleet")
    return options.make_lab(fleet)


class VirtualLabNode:
    """Runs the lab in the main thread; callbacks only leave orders for it."""

    def __init__(self, lab):
        self._lab = lab
        self._orders = queue.SimpleQueue()
        self._last_crash = None
        self._growth = Growth()

        self._vehicles = list(lab.world.vehicles.values())
        self._message = CortexArrays([vehicle.name for vehicle in self._vehicles])
        self._message.header.frame_id = "cortex"
        self._message.visible[:] = True
        # sent without waiting (risc_lab.ros.direct_connection): the lab never waits for a subscriber
        self._publisher = rospy.Publisher("/ground_truth", CortexArrays, queue_size=50, tcp_nodelay=True)

        self._updater = make_updater("virtual lab %s" % lab.fleet.name)
        self._updater.add("virtual lab", self._diagnose)
        Ticker(1.0, self._updater.force_update, "the diagnostics")

        for topic, kind, take, order in (
            ("~mocap_silence", Float64, self._on_number, lab.silence_mocap),
            ("~light", Float64, self._on_number, lab.set_light),
            ("~hide", Fault, self._on_fault, lab.hide),
            ("~link_loss", Fault, self._on_fault, lab.lose_link),
            ("~battery", Fault, self._on_fault, lab.set_battery_pct),
            ("~board", Fault, self._on_fault, lab.wave_board),
            ("~wire_fault", WireFault, self._on_wire_fault, lab.wire_fault),
        ):
            rospy.Subscriber(topic, kind, take, order, queue_size=10, tcp_nodelay=True)

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
        self._message.states[:] = rows
        try:
            self._publisher.publish(self._message)
        except rospy.ROSException:
            if not rospy.core.is_shutdown_requested():
                raise

    def _on_number(self, msg, order):
        self._give(order, msg.data)

    def _on_fault(self, msg, order):
        self._give(order, msg.name, msg.value)

    def _give(self, order, *arguments):
        if not (math.isfinite(arguments[-1]) and arguments[-1] >= 0.0):
            rospy.logerr("fault injection: a number that is not negative is needed, got %r", arguments[-1])
        else:
            self._orders.put((order, arguments))

    def _on_wire_fault(self, msg, order):
        self._orders.put((order, (msg.fault, msg.channel, msg.severity, msg.duration_s or math.inf)))

    def _diagnose(self, status):
        lab = self._lab
        _, rates_hz = self._growth({"frames": lab.frame})
        rate_hz = rates_hz["frames"]
        on_time = rate_hz > 0.95 * lab.fleet.mocap.rate_hz
        status.summary(
            DiagnosticStatus.OK if on_time else DiagnosticStatus.WARN,
            "on schedule" if on_time else "behind its schedule: the computer is too busy",
        )
        status.add("frames", lab.frame)
        status.add("rate (Hz)", "%.1f" % rate_hz)
        status.add("late p99 (ms)", "%.2f" % (1e3 * lab.lateness.percentile_s(99.0)))
        status.add("late max (ms)", "%.2f" % (1e3 * lab.lateness.max_s))
        status.add("stalls", lab.stalls)
        status.add("frames left out", lab.frames_skipped)
        status.add("crashes", len(lab.world.crashes))
        for vehicle in self._vehicles:
            status.add(vehicle.namespace, vehicle.phase.value)
        return status
