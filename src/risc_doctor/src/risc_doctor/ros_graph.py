"""Listens briefly to a running graph: its topics, their rates and ages, and what nodes complain of."""

import statistics
import struct
import threading
import time
from dataclasses import dataclass, field
from functools import partial

from risc_control.vehicles import Status, adapter_class
from risc_doctor.findings import RED, YELLOW, Findings
from risc_lab.lab import fleet_from_dict
from risc_lab.ros.publisher_updates import init_node
from risc_lab.ros.raw_messages import raw_class

LISTEN_S = 2.5  # diagnostics come once a second
_PATIENCE_S = 6.0  # for connecting and listening
_SLOW, _MUCH_TOO_SLOW = 0.9, 0.5  # of the expected rate
_SHOWN = 8  # complaints; more are only counted
_HEADER = struct.Struct("<III")  # of std_msgs/Header: seq, stamp [s], stamp [ns]
_LINK = "risc_maap_msgs/SerialLink"
OK, WARN = 0, 1  # diagnostic_msgs/DiagnosticStatus
TOPICS = {  # topic -> who publishes it
    "/mocap_data": "stream_markers",
    "/cortex_raw": "states_estimation",
    "/controls": "the controller",
}


@dataclass
class Topic:
    """Messages of one topic as they were received."""

    publishers: tuple[str, ...] = ()
    rate_hz: float = 0.0
    age_s: float | None = None  # median of arrival minus stamp; None without messages
    heard: list[tuple[float, float]] = field(default_factory=list)  # (monotonic time of arrival, age) of each [s]

    def note(self, message):
        """Record a raw message that begins with a header; the rest is not unpacked, to be fast enough."""
        _, seconds, nanoseconds = _HEADER.unpack_from(message.raw)
        self.heard.append((time.monotonic(), time.time() - seconds - 1e-9 * nanoseconds))

    def sum_up(self):
        """Compute rate and age from all messages that came."""
        arrivals_s, ages_s = zip(*self.heard) if self.heard else ((), ())
        if len(arrivals_s) > 1:
            self.rate_hz = (len(arrivals_s) - 1) / max(arrivals_s[-1] - arrivals_s[0], 1e-6)
        self.age_s = statistics.median(ages_s) if ages_s else None


@dataclass
class GraphReport:
    """What was received from a graph."""

    error: str = ""  # why it could not be listened to
    topics: dict[str, Topic] = field(default_factory=dict)  # those of TOPICS that are published
    vehicles: dict[str, Status | None] = field(default_factory=dict)  # {namespace: newest} of those with a driver
    lines: dict[str, object] = field(default_factory=dict)  # {node: newest SerialLink or None} of serial lines
    complaints: list[tuple[int, str, str]] = field(default_factory=list)  # (level, name, message) of /diagnostics
    statuses: int = 0  # names on /diagnostics


def listen(master, fleet, listen_s=LISTEN_S):
    """GraphReport of the graph of a ros_master.Master (None: an empty one). Never hangs."""
    report = GraphReport()
    if master is None:
        return report
    publishers = master.publishers()
    report.topics = {name: Topic(tuple(publishers[name])) for name in TOPICS if name in publishers}
    lines = [topic for topic in master.topics_of_type(_LINK) if topic in publishers]
    report.lines = {publishers[topic][0]: None for topic in lines}
    driven = [vehicle for vehicle in fleet.vehicles if _status_topics(vehicle) & publishers.keys()]
    report.vehicles = {vehicle.namespace: None for vehicle in driven}
    report.error = "the graph did not answer within %g s" % (listen_s + _PATIENCE_S)

    def work():
        try:
            _listen(report, driven, {topic: publishers[topic][0] for topic in lines}, listen_s)
            report.error = ""
        except Exception as error:  # rospy raises many kinds when a master goes away
            report.error = "%s: %s" % (type(error).__name__, error)

    thread = threading.Thread(target=work, daemon=True)  # rospy waits forever for a master that has gone
    thread.start()
    thread.join(listen_s + _PATIENCE_S)
    return report


def _hear(vehicle, on_status, subscribe):
    """Subscribe to the status that the driver of a FleetVehicle publishes, through the adapter of its type."""
    adapter_class(vehicle.vehicle_type).listen("/%s/" % vehicle.namespace, on_status, subscribe)


def _status_topics(vehicle):
    topics = set()
    _hear(vehicle, None, lambda topic, *_: topics.add(topic))
    return topics


def _listen(report, driven, lines, listen_s):
    import rospy  # only a graph needs it
    from diagnostic_msgs.msg import DiagnosticArray

    from risc_maap_msgs.msg import SerialLink

    init_node("maap_doctor", anonymous=True, disable_signals=True, disable_rostime=True)
    statuses, subscribe = {}, partial(rospy.Subscriber, tcp_nodelay=True)

    def on_diagnostics(message):
        for status in message.status:
            statuses[status.name] = (status.level, status.name, status.message)

    def on_status(namespace, status, _driver):
        before = report.vehicles[namespace]
        if status.battery_pct is None and before is not None:
            status = status._replace(battery_pct=before.battery_pct)
        report.vehicles[namespace] = status

    for name, topic in report.topics.items():
        subscribe(name, raw_class(rospy.AnyMsg), topic.note)
    subscribe("/diagnostics", DiagnosticArray, on_diagnostics)
    for topic, node in lines.items():
        subscribe(topic, SerialLink, partial(report.lines.__setitem__, node))
    for vehicle in driven:
        _hear(vehicle, partial(on_status, vehicle.namespace), partial(subscribe, queue_size=1))
    time.sleep(listen_s)
    rospy.signal_shutdown("done")
    for topic in report.topics.values():
        topic.sum_up()
    report.statuses = len(statuses)
    report.complaints = sorted((s for s in list(statuses.values()) if s[0] != OK), key=lambda s: (-s[0], s[1]))


def check(situation):
    """Rates and complaints of a graph that runs."""
    found, master = Findings("graph"), situation.master
    if master is None:
        return found.say("none" if situation.nobody_there else "unknown", error=situation.master_error)
    report = situation.graph()
    if report.error:
        return found.say("unheard", error=report.error)
    content = master.parameter("/fleet")
    if content is not None and fleet_from_dict(content, "the parameter /fleet") != situation.fleet:
        found.say("other_fleet", name=content.get("name"), source=situation.fleet_source)
    return found + judge(report, situation.fleet.mocap.rate_hz)


def judge(report, rate_hz):
    """Findings. rate_hz: of motion capture; every node of the chain should keep it."""
    found = Findings("graph")
    if not report.topics:
        return found.say("no_flight", topics=" or ".join(TOPICS))
    for name, node in TOPICS.items():
        topic = report.topics.get(name)
        if topic is None:
            found.say("unpublished", topic=name, node=node)
            continue
        values = {"topic": name, "rate_hz": topic.rate_hz, "wanted_hz": rate_hz}
        if topic.rate_hz >= _SLOW * rate_hz:
            found.say("rate", **values)
        elif topic.rate_hz:
            found.say("slow", RED if topic.rate_hz < _MUCH_TOO_SLOW * rate_hz else YELLOW, **values)
        else:
            found.say("silent", publishers=" and ".join(topic.publishers), **values)
    for level, name, message in report.complaints[:_SHOWN]:
        found.say("complaint", YELLOW if level == WARN else RED, name=name, message=message)
    if len(report.complaints) > _SHOWN:
        found.say("more", count=len(report.complaints) - _SHOWN)
    if report.statuses and not report.complaints:
        found.say("well", count=report.statuses)
    return found
