"""What ROS sees of the virtual lab: its parameters, /ground_truth, crashes, diagnostics and faults."""

import itertools
import math
import queue

import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float64, Header

from risc_lab.frames import wrap_angle
from risc_lab.lab import load_fleet
from risc_lab.ros.diagnostics import Growth, make_updater
from risc_lab.ros.fleet_messages import CortexArrays
from risc_lab.ros.params import known_fleet, load_params
from risc_lab.ros.ticker import Ticker
from risc_lab.ros.until_shutdown import is_closing
from risc_maap_msgs.msg import BoardMotion, Crash, FaultKind, FaultKinds, FaultRecord, Faults, Told
from risc_maap_msgs.srv import InjectFault, InjectFaultResponse, PutBack, PutBackResponse
from risc_simulator.faults import REGISTRY, FaultEvent, fault_settings
from risc_simulator.virtual_lab import LabOptions

_ANSWER_S = 2.0  # within this time the lab, which may be busy with a frame, carries out an order
_DEG_PER_RAD = math.degrees(1.0)


def load_options():
    """LabOptions of the private parameters. Raises ValueError that names the key."""
    subnet = rospy.get_param("~subnet", "")
    if not isinstance(subnet, str):  # a command line turns 127.80 into the number 127.8: the original text is lost
        raise ValueError(
            "parameter ~subnet must be a text, found %r: quote it twice on a command line (_subnet:=\"'...'\"), and "
            'give it type="str" in a launch file' % (subnet,)
        )
    (options,) = load_params(LabOptions)
    return options


def make_lab(options):
    """VirtualLab of LabOptions. Raises ValueError or OSError."""
    fleet = load_fleet(options.fleet) if options.fleet else known_fleet()
    if fleet is None:
        raise ValueError("no fleet: set ~fleet to the path of a fleet file, or load one as the parameter /fleet")
    return options.make_lab(fleet)


def fault_kinds():
    """FaultKinds of all faults that can happen here."""
    kinds = []
    for name in REGISTRY.names():
        settings = fault_settings(name)
        if settings.on_programs:
            continue
        defaults = {"severity": settings.default_severity, "duration_s": settings.default.duration_s}
        kinds.append(
            FaultKind(
                name,
                settings.summary,
                settings.argument_field,
                settings.argument_unit,
                *settings.argument_range,
                defaults[settings.argument_field],
                list(settings.grades),
                list(settings.grades.values()),
                settings.per_vehicle,
            )
        )
    return FaultKinds(_header(), kinds)


def _header():
    return Header(stamp=rospy.Time.now())


def _event_of(request):
    """FaultEvent of an InjectFault. Raises ValueError."""
    for name in ("severity", "duration_s"):
        if len(getattr(request, name)) > 1:
            raise ValueError("%s: '%s' is one value, or none for the default" % (request.fault, name))
    if request.start_s < 0.0:
        raise ValueError("%s: a fault cannot begin in the past: %g s" % (request.fault, request.start_s))
    if fault_settings(request.fault).on_programs:
        raise ValueError("%s acts on a program of a flight: give it to ./maap fly --fault" % request.fault)
    (severity,), (duration_s,) = (request.severity or [None], request.duration_s or [None])
    return FaultEvent(request.fault, request.vehicle, severity, duration_s, request.start_s, request.channel)


def _answer(order, argument):
    """Carry out an order: (True, its text), or (False, text of its ValueError)."""
    try:
        text = order(argument)
    except ValueError as error:
        return False, str(error)
    rospy.loginfo("%s", text)
    return True, text


class VirtualLabNode:
    """Runs the lab in the main thread; callbacks only queue orders for it."""

    def __init__(self, lab):
        self._lab = lab
        self._orders = queue.SimpleQueue()
        self._last_crash = None
        self._fault_changes = -1  # of the injector
        self._open_faults, self._newest_fault = set(), 0  # ids at the last publication: of open faults; the greatest
        self._growth = Growth()

        self._vehicles = list(lab.world.vehicles.values())
        self._message = CortexArrays([vehicle.name for vehicle in self._vehicles])
        self._message.header.frame_id = "cortex"
        self._message.visible[:] = True
        # sent without waiting (risc_lab.ros.direct_connection): the lab never waits for a subscriber
        self._publisher = rospy.Publisher("/ground_truth", CortexArrays, queue_size=50, tcp_nodelay=True)

        self._crashes = rospy.Publisher("/virtual_lab/crash", Crash, queue_size=50)
        self._told = rospy.Publisher("/virtual_lab/told", Told, queue_size=100)
        self._told_last = {}  # namespace -> socket_host.Told
        self._inputs = rospy.Publisher("/virtual_lab/inputs", Told, queue_size=100)
        self._inputs_last_s = {}  # namespace -> VehicleHost.inputs_s
        self._faults = rospy.Publisher("/virtual_lab/faults", Faults, queue_size=50, latch=True)
        kinds = rospy.Publisher("/virtual_lab/fault_kinds", FaultKinds, queue_size=1, latch=True)
        kinds.publish(fault_kinds())
        rospy.Service("/virtual_lab/inject", InjectFault, self._on_inject)
        rospy.Service("/virtual_lab/put_back", PutBack, self._on_put_back)

        self._updater = make_updater("virtual lab %s" % lab.fleet.name)
        self._updater.add("virtual lab", self._diagnose)
        Ticker(1.0, self._updater.force_update, "the diagnostics")

        rospy.Subscriber("~light", Float64, self._on_light, queue_size=10, tcp_nodelay=True)
        rospy.Subscriber("~board", BoardMotion, self._on_board, queue_size=10, tcp_nodelay=True)

    def after_frame(self):
        """Carry out orders, then publish the events and the ground truth of the frame that was just sent."""
        while not self._orders.empty():
            order, arguments = self._orders.get_nowait()
            try:
                order(*arguments)
            except ValueError as error:
                rospy.logerr("refused: %s", error)
        crashes = self._lab.world.crashes
        if crashes and crashes[-1] is not self._last_crash:
            new = list(itertools.takewhile(lambda crash: crash is not self._last_crash, reversed(crashes)))
            self._last_crash = crashes[-1]
            for crash in reversed(new):  # a collision makes two at once
                rospy.logwarn("%s %s at (%.2f, %.2f, %.2f) m", crash.namespace, crash.reason, *crash.position_m)
                told = Crash(_header(), crash.namespace, crash.other, crash.reason, *crash.position_m)
                self._send(self._crashes, told)
        for namespace, host in self._lab.vehicle_hosts.items():
            if host.told is not self._told_last.get(namespace):
                self._told_last[namespace] = host.told
                self._tell(self._told, namespace, host.told, host.told_s)
            if host.inputs_s != self._inputs_last_s.get(namespace, -math.inf):
                self._inputs_last_s[namespace] = host.inputs_s
                self._tell(self._inputs, namespace, host.told, host.inputs_s)
        if self._lab.injector.changes != self._fault_changes:
            self._fault_changes = self._lab.injector.changes
            self._publish_faults()
        if self._publisher.get_num_connections():
            self._publish()

    def _tell(self, publisher, namespace, order, lab_s):
        message = Told(vehicle=namespace, order=order)
        message.header.stamp = rospy.Time.from_sec(max(0.0, rospy.get_time() - self._lab.now_s() + lab_s))
        self._send(publisher, message)

    def _publish(self):
        age_s = self._lab.now_s() - self._lab.exposure_s
        self._message.header.stamp = rospy.Time.from_sec(rospy.get_time() - age_s)
        rows = self._lab.world.truth()
        rows[:, 8] = wrap_angle(rows[:, 8])
        rows[:, 6:] *= _DEG_PER_RAD
        self._message.states[:] = rows
        self._send(self._publisher, self._message)

    @staticmethod
    def _send(publisher, message):
        try:
            publisher.publish(message)
        except rospy.ROSException:
            if not is_closing():
                raise

    def _publish_faults(self):
        """Publish the faults that wait or act, and those that have ended since the last time."""
        injector, before = self._lab.injector, self._open_faults
        active, self._open_faults = ({record.id for record in records} for records in (injector.active, injector.open))
        new = range(self._newest_fault + 1, len(injector.history) + 1)  # not all: the history of a weekend is long
        numbers = sorted({*before, *self._open_faults, *new})
        told = [self._fault_record(injector.history[number - 1], number in active) for number in numbers]
        self._newest_fault = len(injector.history)
        self._send(self._faults, Faults(_header(), told))

    def _fault_record(self, record, is_active):
        ahead_s, event = rospy.get_time() - self._lab.now_s(), record.event
        begins, ends = (
            rospy.Time.from_sec(ahead_s + time_s) if time_s < math.inf else rospy.Time()
            for time_s in (record.begins_s, record.ends_s)
        )
        safe = list(event.settings.safe)
        return FaultRecord(record.id, event.fault, event.args, event.vehicle, begins, ends, is_active, safe)

    def _on_inject(self, request):
        """Do what takes time here, in the service's own thread: read files, import modules."""
        try:
            event = _event_of(request) if request.fault else None
        except ValueError as error:
            return InjectFaultResponse(False, str(error))
        done, text = self._carry_out(self._inject, event)
        return InjectFaultResponse(done, text)

    def _on_put_back(self, request):
        done, text = self._carry_out(self._put_back, request.vehicle)
        return PutBackResponse(done, text)

    def _carry_out(self, order, argument):
        """Let the lab's thread call order(argument). Returns (whether it was done, what was done or why not)."""
        answer = queue.SimpleQueue()
        self._orders.put((lambda: answer.put(_answer(order, argument)), ()))
        try:
            return answer.get(timeout=_ANSWER_S)
        except queue.Empty:
            return False, "the virtual lab is too busy to answer within %g s" % _ANSWER_S

    def _inject(self, event):
        if event is None:
            self._lab.end_faults()
            return "all faults have ended"
        record = self._lab.inject(event)
        return "fault %d: %s" % (record.id, record.event)

    def _put_back(self, namespace):
        self._lab.put_back(namespace)
        return "%s: put back" % (namespace or "all vehicles")

    def _on_light(self, msg):
        self._orders.put((self._lab.set_light, (msg.data,)))

    def _on_board(self, msg):
        self._orders.put((self._lab.move_board, (msg.vehicle, msg.duration_s)))

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
