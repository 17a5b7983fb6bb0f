"""The node: one device, or with ~fork_server all that connect; their status on ~link and /diagnostics."""

import contextlib
import functools
import math
import select
import sys
import threading
import time
from dataclasses import replace

import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from risc_lab.ros.diagnostics import add_all, age_text, summarise, ticking_updater
from risc_lab.ros.guard import guarded
from risc_lab.ros.params import load_params
from risc_lab.ros.ticker import Ticker
from risc_maap_msgs.msg import Counter, SerialLink
from rosserial_python.diagnosis import TEXTS, WARNINGS, Cause, cause_of
from rosserial_python.link import State
from rosserial_python.ports import AcceptedPort, ListeningPort, make_port
from rosserial_python.ros.device_topics import Topics
from rosserial_python.session import Session
from rosserial_python.settings import LISTEN, SerialParams

STATUS = "rosserial_python"  # name on /diagnostics, as in the original
_TCP_PORT, _FORK = "/rosserial_embeddedlinux/tcp_port", "/rosserial_embeddedlinux/fork_server"
_STATES = {State.CLOSED: "closed", State.WAITING: "open, asking for topics", State.UP: "the device answers"}
_REPORT_S = 1.0
_LOOK_S = 0.2
_START_S = 10.0  # the other end of a line may start after the node
_AGAIN_S = 5.0  # between two log lines about the same cause
_MOST_DEVICES = 16  # each has its own threads


def read_params(arguments):
    """Read SerialParams from the parameter server and the command line: [port [TCP port]]. Raises ValueError."""
    (params,) = load_params(SerialParams(), lenient=True)
    for key, name in ((_TCP_PORT, "tcp_port"), (_FORK, "fork_server")):
        if not rospy.has_param("~" + name) and rospy.has_param(key):
            params = replace(params, **{name: rospy.get_param(key)})
    if len(arguments) > 2:
        raise ValueError(
            "at most two arguments: PORT and, with the port %s, its number; found %r" % (LISTEN, arguments)
        )
    if arguments:
        params = replace(params, port=arguments[0])
    if len(arguments) > 1:
        if not arguments[1].isdecimal():
            raise ValueError("the second argument must be the number of a TCP port, not %r" % arguments[1])
        params = replace(params, tcp_port=int(arguments[1]))
    return params


class Device:
    """A device, its topics, and its status."""

    def __init__(self, port, params, publish, once=False):
        """publish: function that takes a SerialLink.  once: do not reopen the line when it ends."""
        self._publish = publish
        self._told = (None, None)  # last reported state and cause
        self._logged_s = {}  # {cause: when}
        self._began_s = time.monotonic()
        self._excused = False  # the current fault was logged as info, not yet as error
        self._telling = threading.Lock()
        self._is_alone = not once
        self.session = Session(port, params.silence, self._on_packet, self._on_failure, self.tell, once=once)
        self.topics = Topics(self.session, params.max_age)
        self.session.start()

    def _on_packet(self, packet):
        guarded(functools.partial(self.topics.on_packet, packet), "a packet of the device")()

    def _on_failure(self, error):
        """Report a failure. With a single device the node ends, and is started again; else only this line ends."""
        what = "the node" if self._is_alone else "it"
        rospy.logfatal("%s: the line failed, %s ends: %r", self.session.port.name, what, error)
        if self._is_alone:
            rospy.signal_shutdown("the line failed: %r" % error)

    def _seen(self):
        """Return the current (Facts, limit [s], Cause)."""
        facts, limit_s = self.session.link.snapshot()
        oversized_s = max(self.topics.oversized.values(), default=-math.inf)
        return facts, limit_s, cause_of(facts, time.monotonic(), self.session.error, self.topics.refused, oversized_s)

    def tell(self, again=False):
        """Log and publish the state when it has changed; again=True: publish it in any case."""
        with self._telling:
            facts, limit_s, cause = self._seen()
            state, before = facts.state, self._told
            self._told = (state, cause)
            if before != self._told or (self._excused and not self._is_young()):
                self._log(state, cause, before)
            if again or before != self._told:
                self._publish(self._message(facts, limit_s, cause))

    def _log(self, state, cause, before):
        name = self.session.port.name
        if cause is Cause.NONE:
            self._excused = False
        if cause in (Cause.NONE, Cause.TYPES, Cause.SIZE):  # for the latter two each topic has its own log line
            if state != before[0] and (state is State.UP or before[0] in (None, State.UP)):  # not each attempt to open
                rospy.loginfo("%s: %s", name, _STATES[state])
        elif time.monotonic() - self._logged_s.get(cause, -math.inf) > _AGAIN_S:
            self._logged_s[cause] = time.monotonic()
            error = self.session.error
            log = rospy.logwarn if cause in WARNINGS else rospy.logerr
            self._excused = cause is Cause.UNREACHABLE and self._is_young()
            if self._excused:
                log = rospy.loginfo  # the other end may still be starting
            log("%s: %s%s", name, TEXTS[cause], " (%s)" % error if error is not None else "")

    def _is_young(self):
        """Whether it has started recently and was never connected."""
        heard = math.isfinite(self.session.link.facts.heard_s)
        return not heard and time.monotonic() - self._began_s < _START_S

    def _message(self, facts, limit_s, cause):
        heard_s = facts.heard_s
        return SerialLink(
            port=self.session.port.name,
            baud=self.session.port.baud or 0,
            state=facts.state,
            cause=cause,
            reason=TEXTS[cause],
            age_s=time.monotonic() - heard_s if math.isfinite(heard_s) else math.nan,
            limit_s=limit_s,
            counters=[Counter(name, count) for name, count in self._counts(facts).items()],
            refused_topics=sorted(self.topics.refused),
            oversized_topics=sorted(self.topics.oversized),
        )

    def _counts(self, facts):
        return {**facts.counts, **self.topics.counts}

    def fill(self, status):
        """Fill the device's status on /diagnostics."""
        facts, limit_s, cause = self._seen()
        level = DiagnosticStatus.WARN if cause in WARNINGS else DiagnosticStatus.ERROR
        summarise(
            status,
            (cause is not Cause.NONE, level, TEXTS[cause]),
            (facts.state is not State.UP, DiagnosticStatus.WARN, "no answer yet"),
            (True, DiagnosticStatus.OK, "the device answers"),
        )
        heard_s = facts.heard_s if math.isfinite(facts.heard_s) else None
        port = self.session.port
        add_all(status, {"port": port.name, "baud": port.baud or "no limit", "state": facts.state.name.lower()})
        add_all(status, {"age [s]": age_text(heard_s), "lost after [s]": "%.2f" % limit_s})
        add_all(status, self._counts(facts))
        add_all(status, {"refused " + name: why for name, why in self.topics.refused.items()})
        return status

    def close(self):
        """Tell the device to stop sending, and unregister its topics and services."""
        self.session.stop()
        self.topics.close()


def _fill_port(port, status):
    """Fill the status of a ListeningPort on /diagnostics."""
    status.summary(DiagnosticStatus.OK, "listens")
    add_all(status, {"strangers refused": port.strangers})
    return status


class SerialNode:
    """The node; make it after rospy.init_node. Raises ValueError."""

    def __init__(self, arguments=None):
        self._params = params = read_params(rospy.myargv(sys.argv)[1:] if arguments is None else arguments)
        try:
            port = make_port(params, lambda _level, text: rospy.logwarn("%s", text))
        except OSError as error:
            raise ValueError(
                "cannot listen on TCP port %d: %s; stop the program that uses it" % (params.tcp_port, error)
            ) from None
        self._link = rospy.Publisher("~link", SerialLink, queue_size=10, latch=True)
        self._devices, self._over = {}, threading.Event()  # {name of its status: Device}
        self._updater = ticking_updater(port.name)
        rospy.on_shutdown(self.close)
        if isinstance(port, ListeningPort):
            self._updater.add(STATUS + " " + port.name, functools.partial(_fill_port, port))
        if params.fork_server and isinstance(port, ListeningPort):
            rospy.loginfo("%s: waiting for devices", port.name)
            self._listener = threading.Thread(target=self._listen, args=(port,), name="listener", daemon=True)
            self._listener.start()
        else:
            self._listener = None
            self._add(STATUS, port)
        Ticker(_REPORT_S, self._report, "the report")

    def _add(self, name, port, once=False):
        self._devices[name] = device = Device(port, self._params, self._send, once)
        self._updater.add(name, device.fill)

    def _send(self, message):
        message.header.stamp = rospy.Time.now()
        with contextlib.suppress(rospy.ROSException):  # topics are closed while the node ends
            self._link.publish(message)

    def _report(self):
        for device in list(self._devices.values()):
            device.tell(again=True)

    def _listen(self, port):
        """Add one device for each connection, and remove ended ones."""
        while not self._over.is_set():
            select.select([port], [], [], _LOOK_S)
            accepted = port.accept()
            if accepted is not None:
                line, peer = accepted
                if len(self._devices) < _MOST_DEVICES:
                    self._add("%s %s" % (STATUS, peer), AcceptedPort(line, "tcp %s" % peer, port.baud), once=True)
                else:
                    port.refuse(line, peer, "%d devices are connected, which is the limit" % _MOST_DEVICES)
            for name, device in list(self._devices.items()):
                if device.session.is_over:
                    self._updater.removeByName(name)
                    self._devices.pop(name).close()
        port.close()

    def close(self):
        """Close all lines and end all threads."""
        self._over.set()
        if self._listener is not None:
            self._listener.join(1.0)
        for device in list(self._devices.values()):
            device.close()
