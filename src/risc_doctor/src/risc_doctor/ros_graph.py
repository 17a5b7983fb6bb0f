"""A graph that runs, listened to for a moment: what it publishes, how often, how old, and what nodes complain of."""

import struct
import threading
import time
from dataclasses import dataclass, field

import numpy as np

from ardrone_autonomy.protocol.navdata import ControlState
from risc_doctor.findings import green, red, yellow
from risc_lab.lab import fleet_from_dict

LISTEN_S = 2.5  # diagnostics come once a second
_PATIENCE_S = 6.0  # for connecting and listening
_SLOW, _MUCH_TOO_SLOW = 0.9, 0.5  # of the expected rate
_SHOWN = 8  # complaints; more say the same
_HEADER = struct.Struct("<III")  # of std_msgs/Header: seq, stamp [s], stamp [ns]
OK, WARN = 0, 1  # diagnostic_msgs/DiagnosticStatus
_ON_THE_GROUND = {ControlState.DEFAULT, ControlState.INIT, ControlState.LANDED, ControlState.TEST}
TOPICS = {  # topic -> who publishes it
    "/mocap_data": "stream_markers",
    "/cortex_raw": "states_estimation",
    "/controls": "the controller",
}


@dataclass
class Topic:
    """Messages of one topic as they came."""

    publishers: tuple[str, ...] = ()
    rate_hz: float = 0.0
    age_s: float | None = None  # median of arrival less stamp; None without messages


@dataclass
class HeardVehicle:
    """What a vehicle's driver said last."""

    battery_pct: float | None = None  # None: nothing
    flies: bool = False


@dataclass
class GraphReport:
    """What was heard."""

    error: str = ""  # why it could not be listened to
    topics: dict[str, Topic] = field(default_factory=dict)  # those of TOPICS that are published
    vehicles: dict[str, HeardVehicle] = field(default_factory=dict)  # namespace -> of those with a driver
    complaints: list[tuple[int, str, str]] = field(default_factory=list)  # (level, name, message) of /diagnostics
    statuses: int = 0  # names on /diagnostics


class _Meter:
    """Counts messages that begin with a header, and their ages; without unpacking the rest, to be in time."""

    def __init__(self):
        self.arrivals_s, self.ages_s = [], []

    def __call__(self, message):
        self.arrivals_s.append(time.monotonic())
        _, seconds, nanoseconds = _HEADER.unpack_from(message._buff)
        self.ages_s.append(time.time() - seconds - 1e-9 * nanoseconds)

    def fill(self, topic):
        if len(self.arrivals_s) > 1:
            span_s = self.arrivals_s[-1] - self.arrivals_s[0]
            topic.rate_hz = (len(self.arrivals_s) - 1) / max(span_s, 1e-6)
        if self.ages_s:
            topic.age_s = float(np.median(self.ages_s))


def listen(master, fleet, environment, listen_s=LISTEN_S):
    """GraphReport of the graph of a ros_master.Master (None: an empty one). Never hangs."""
    report = GraphReport()
    if master is None:
        return report
    publishers = master.publishers()
    for name in TOPICS:
        if name in publishers:
            report.topics[name] = Topic(tuple(publishers[name]))
    for vehicle in fleet.vehicles:
        if "/%s/ardrone/navdata" % vehicle.namespace in publishers:
            report.vehicles[vehicle.namespace] = HeardVehicle()
    errors = []

    def work():
        try:
            _listen(report, listen_s)
        except Exception as error:  # rospy raises many kinds when a master goes away
            errors.append("%s: %s" % (type(error).__name__, error))

    thread = threading.Thread(target=work, daemon=True)  # rospy waits for ever for a master that has gone
    thread.start()
    thread.join(listen_s + _PATIENCE_S)
    if thread.is_alive():
        errors.append("the graph did not answer within %g s" % (listen_s + _PATIENCE_S))
    report.error = "; ".join(errors)
    return report


def _listen(report, listen_s):
    import rospy  # only a graph needs it
    from diagnostic_msgs.msg import DiagnosticArray

    from ardrone_autonomy.msg import Navdata

    rospy.init_node("maap_doctor", anonymous=True, disable_signals=True, disable_rostime=True)
    meters = {name: _Meter() for name in report.topics}
    worst = {}

    def on_diagnostics(message):
        for status in message.status:
            worst[status.name] = (status.level, status.name, status.message)

    subscribers = [rospy.Subscriber(name, rospy.AnyMsg, meter, tcp_nodelay=True) for name, meter in meters.items()]
    subscribers.append(rospy.Subscriber("/diagnostics", DiagnosticArray, on_diagnostics, tcp_nodelay=True))
    for namespace, heard in report.vehicles.items():

        def on_navdata(message, heard=heard):
            heard.battery_pct, heard.flies = float(message.batteryPercent), message.state not in _ON_THE_GROUND

        subscribers.append(
            rospy.Subscriber("/%s/ardrone/navdata" % namespace, Navdata, on_navdata, queue_size=1, tcp_nodelay=True)
        )
    time.sleep(listen_s)
    for subscriber in subscribers:
        subscriber.unregister()
    for name, meter in meters.items():
        meter.fill(report.topics[name])
    rospy.signal_shutdown("done")
    report.statuses = len(worst)
    report.complaints = sorted((s for s in list(worst.values()) if s[0] != OK), key=lambda s: (-s[0], s[1]))


def check(situation):
    """Rates and complaints of a graph that runs."""
    if situation.master is None and situation.nobody_there:
        return [green("graph", "none runs (%s)" % situation.master_error)]
    if situation.master is None:
        return [yellow("graph", "nobody knows whether one runs: %s" % situation.master_error, "see `ros`")]
    report = situation.graph()
    if report.error:
        cure = "see `ros`: the master or the network to it is in trouble"
        return [red("graph", "cannot be listened to: %s" % report.error, cure)]
    return _other_fleet(situation) + judge(report, situation.fleet.mocap.rate_hz)


def _other_fleet(situation):
    """A finding when the graph was started with another fleet than the one that is looked at."""
    content = situation.master.parameter("/fleet")
    if content is None or fleet_from_dict(content, "the parameter /fleet") == situation.fleet:
        return []
    text = "the graph that runs has another fleet ('%s') than %s" % (content.get("name"), situation.fleet_source)
    return [yellow("graph", text, "leave the file out to look at the fleet of the graph, or start it with this file")]


def judge(report, rate_hz):
    """Findings. rate_hz: of motion capture; every node of the chain keeps it."""
    say = "graph"
    if not report.topics:
        return [green(say, "a master runs, but no flight: nobody publishes %s" % " or ".join(TOPICS))]
    findings = []
    for name, node in TOPICS.items():
        topic = report.topics.get(name)
        if topic is None:
            text = "nobody publishes %s" % name
            findings.append(yellow(say, text, "does %s run? rosnode list; its output says why it ended" % node))
            continue
        text = "%s comes at %.0f Hz" % (name, topic.rate_hz)
        data = {"rate_hz": topic.rate_hz}
        if topic.rate_hz >= _SLOW * rate_hz:
            findings.append(green(say, text, **data))
            continue
        if not topic.rate_hz:
            text = "nothing comes on %s, although %s publishes it" % (name, " and ".join(topic.publishers))
            cure = "what does it wait for? see the complaints below and `cortex`; is its computer reachable (`ros`)?"
        else:
            text += ", expected are %g" % rate_hz
            cure = "what is the first in the chain that is slow? See `cortex`, `load`, and the network"
        findings.append((red if topic.rate_hz < _MUCH_TOO_SLOW * rate_hz else yellow)(say, text, cure, **data))
    for level, name, message in report.complaints[:_SHOWN]:
        cure = "what it says; rostopic echo /diagnostics tells its numbers"
        findings.append((yellow if level == WARN else red)(say, "%s: %s" % (name, message), cure))
    if len(report.complaints) > _SHOWN:
        text = "%d more complaints on /diagnostics" % (len(report.complaints) - _SHOWN)
        findings.append(yellow(say, text, "rostopic echo /diagnostics"))
    if report.statuses and not report.complaints:
        findings.append(green(say, "%d parts report on /diagnostics, all well" % report.statuses))
    return findings
