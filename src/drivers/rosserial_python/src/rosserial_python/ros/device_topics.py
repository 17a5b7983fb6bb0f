"""Topics and parameters of one device in the graph; its services are in `services`.

The session's thread delivers packets. Calls that may wait for the master (registering, parameters, service calls) run
in a separate thread of this module, so that the monitoring of the link never blocks.
"""

import contextlib
import functools
import math
import queue
import struct
import threading
import time

import genpy
import rospy

from risc_lab.message_age import MessageAges
from risc_lab.ros.clock import ros_time_s
from risc_lab.ros.guard import guarded, subscribe
from risc_lab.ros.raw_messages import raw_class
from risc_lab.ros.until_shutdown import until_shutdown
from rosserial_msgs.srv import RequestParamResponse
from rosserial_python import protocol
from rosserial_python.protocol import Id, PayloadError
from rosserial_python.ros import services
from rosserial_python.ros.definitions import TypesError, known_class, read_message, serialised

_PUBLISHER_QUEUE = 10  # as in the original
_BUFFER_BYTES = 2**18
_JOBS = 256  # that may wait for the master
_MOST_TOPICS = 256  # of a device, including refused ones; a faulty or hostile device may announce new ones endlessly
_REPEAT_S = 5.0  # between equal log lines
_STAMP = struct.Struct("<4xII")  # of std_msgs/Header
_LOG = (rospy.logdebug, rospy.loginfo, rospy.logwarn, rospy.logerr, rospy.logfatal)
_TOO_LARGE = {  # advice by message type
    "risc_msgs/Controls": "send it only its own vehicle's commands (NAMESPACE/controls), not the fleet's (/controls)",
}


class Topics:
    """Topics and services that one device announces. session: uses its `post`, `reply`, `confirm`, `ask_topics`."""

    def __init__(self, session, max_age_s):
        self._session, self._max_age_s = session, max_age_s
        self._kinds = {Id.PUBLISHER: FromDevice, Id.SUBSCRIBER: ToDevice, **services.HALVES}
        self._members = {}  # {(id, topic id): (Topic, object that serves it)}
        self._doubted = {}  # {(id, topic id): Topic that contradicts the served one, announced once so far}
        self._jobs = queue.Queue(_JOBS)
        self._refused = {}  # {name of a topic: (Topic, why)}
        self._oversized = {}  # {name of a topic: time of its last oversized message}
        self.counts = {"bad payloads": 0, "too large": 0, "late": 0}
        self._worker = threading.Thread(target=self._work, name="registrations", daemon=True)
        self._worker.start()

    @property
    def refused(self):
        """Refused topics: {topic: reason}."""
        return {name: why for name, (_, why) in list(self._refused.items())}

    @property
    def oversized(self):
        """{topic: monotonic time [s] of its last message that did not fit into the device}."""
        return dict(self._oversized)

    def close(self):
        """Unregister all topics and services."""
        with contextlib.suppress(queue.Full):  # the master hangs: the worker ends with the program
            self._jobs.put_nowait(None)
        self._worker.join(1.0)  # do not wait longer if the master hangs
        for _, member in list(self._members.values()):
            member.close()
        self._members.clear()

    # --- from the device: nothing here waits -----------------------------------------------------------------------
    def on_packet(self, packet):
        """Handle one valid packet."""
        topic_id, payload = packet
        try:
            if topic_id in protocol.ANNOUNCEMENTS:
                self._announced(topic_id, protocol.topic_of(payload))
            elif topic_id == Id.TIME:
                now = rospy.Time.now()
                self._session.reply(Id.TIME, protocol.time_payload(now.secs, now.nsecs))
            elif topic_id == Id.LOG:
                level, text = protocol.log_of(payload)
                _LOG[min(level, len(_LOG) - 1)]("%s", text)
            elif topic_id == Id.PARAMETER:
                self._later(self._answer_parameter, protocol.name_of(payload))
            else:
                self._message(topic_id, payload)
        except PayloadError as error:
            self.counts["bad payloads"] += 1
            rospy.logwarn_throttle(_REPEAT_S, "dropped a corrupt packet: %s", error)

    def _announced(self, kind, topic):
        key = (kind, topic.topic_id)
        known = self._members.get(key)
        if known is not None and known[0] == topic:
            self._doubted.pop(key, None)
            known[1].confirmed(topic)
        elif self._refused.get(topic.name, (None,))[0] == topic:
            return
        elif known is not None and self._doubted.get(key) != topic:
            self._doubted[key] = topic  # another program, or damage that the checksum misses: ask again to find out
            self._session.ask_topics()
        elif len(self._members) + len(self._refused) >= _MOST_TOPICS and known is None:
            raise PayloadError("the device has announced %d topics; further topics are ignored" % _MOST_TOPICS)
        else:
            self._later(self._join, kind, topic)

    def _message(self, topic_id, payload):
        for kind in (Id.PUBLISHER, Id.SERVER_RESPONSE, Id.CLIENT_REQUEST):
            _, member = self._members.get((kind, topic_id), (None, None))
            if member is not None:
                member.from_device(payload)
                return
        if all(topic.topic_id != topic_id for topic, _ in list(self._refused.values())):
            self._session.ask_topics()

    def _later(self, function, *arguments):
        try:
            self._jobs.put_nowait((function, arguments))
        except queue.Full:
            rospy.logerr_throttle(_REPEAT_S, "the ROS master does not respond: a request of the device was dropped")

    # --- with the master -------------------------------------------------------------------------------------------
    def _work(self):
        while (job := self._jobs.get()) is not None:
            function, arguments = job
            guarded(functools.partial(function, *arguments), "the registration of a topic of the device")()

    def _join(self, kind, topic):
        key = (kind, topic.topic_id)
        if key in self._members:
            if self._members[key][0] == topic:
                return
            self._members.pop(key)[1].close()  # another program in the device
        try:
            member = self._kinds[kind](self, topic)
        except TypesError as error:
            self._refused[topic.name] = (topic, str(error))
            rospy.logerr("%s", error)
            return
        self._refused.pop(topic.name, None)
        self._members[key] = (topic, member)
        member.confirmed(topic)

    def _answer_parameter(self, name):
        response = RequestParamResponse()
        value = rospy.get_param(name, None)
        values = value if isinstance(value, list) else [value]
        for kind, field in ((bool, "ints"), (int, "ints"), (str, "strings"), (float, "floats")):
            if values and all(isinstance(item, kind) for item in values):
                setattr(response, field, [int(item) if kind is bool else item for item in values])
                break
        else:
            numbers = values and all(isinstance(item, (int, float)) for item in values)
            if numbers:
                response.floats = [float(item) for item in values]
            else:
                rospy.logerr(
                    "the device asks for the parameter %s, which %s",
                    rospy.resolve_name(name),
                    "is not set" if value is None else "is not a number, a string or a list of either",
                )
        self.reply(Id.PARAMETER, response)

    # --- for the members -------------------------------------------------------------------------------------------
    def reply(self, topic_id, message):
        """Send a message as an answer."""
        try:
            data = serialised(message)
        except genpy.SerializationError as error:  # e.g. a parameter that fits into no int32
            rospy.logerr("cannot send a reply to the device: %s", error)
        else:
            self._session.reply(topic_id, data)

    def member(self, kind, name):
        """Return the object that serves the topic, or half of a service, of this id and name; None without one."""
        for (its_kind, _), (topic, member) in list(self._members.items()):
            if its_kind == kind and topic.name == name:
                return member
        return None

    def fits(self, topic, size):
        """Whether a message of `size` bytes fits into the device's buffer; logs it if not."""
        if size <= topic.buffer_bytes:
            return True
        self.counts["too large"] += 1
        self._oversized[topic.name] = time.monotonic()
        rospy.logerr_throttle(
            _REPEAT_S,
            "%s: dropped a message of %d bytes, the device's buffer holds %d: %s"
            % (
                topic.name,
                size,
                topic.buffer_bytes,
                _TOO_LARGE.get(
                    topic.type, "publish shorter messages, or enlarge the buffers of the sketch's NodeHandle"
                ),
            ),
        )
        return False

    def expires_s(self, ages, raw):
        """Time until which a message that begins with a header may be sent, monotonic clock; None: it is too late.

        Infinite for a message without a stamp.
        """
        seconds, nanoseconds = _STAMP.unpack_from(raw)
        if not (seconds or nanoseconds):
            return math.inf
        now_s = time.monotonic()
        left_s = self._max_age_s - ages.corrected(ros_time_s() - seconds - 1e-9 * nanoseconds, now_s)
        if left_s > 0.0:
            return now_s + left_s
        self.counts["late"] += 1
        return None

    @property
    def session(self):
        """The session."""
        return self._session


class FromDevice:
    """A topic that the device publishes."""

    def __init__(self, topics, topic):
        self._topics, self._class = topics, known_class(topic)
        self._publisher = rospy.Publisher(topic.name, self._class, queue_size=_PUBLISHER_QUEUE)
        rospy.loginfo("publishes %s [%s]", topic.name, topic.type)

    def confirmed(self, topic):
        self._topics.session.confirm(topic)

    def from_device(self, payload):
        until_shutdown(self._publisher.publish)(read_message(self._class, payload))

    def close(self):
        self._publisher.unregister()


class ToDevice:
    """A topic that the device subscribes to: the newest message is sent at once."""

    def __init__(self, topics, topic):
        self._topics, self._topic = topics, topic
        kind = known_class(topic)
        self._ages = MessageAges() if kind._has_header else None
        self._subscriber = subscribe(
            topic.name, raw_class(kind), self._on_message, queue_size=1, buff_size=_BUFFER_BYTES
        )
        rospy.loginfo("subscribes to %s [%s]", topic.name, topic.type)

    def _on_message(self, message):
        topics, raw = self._topics, message.raw
        if not topics.fits(self._topic, len(raw)):
            return
        expires_s = math.inf if self._ages is None else topics.expires_s(self._ages, raw)
        if expires_s is None:
            rospy.logwarn_throttle(
                _REPEAT_S, "%s: messages arrive older than ~max_age, and are dropped" % self._topic.name
            )
            return
        topics.session.post(self._topic.topic_id, raw, expires_s)

    def confirmed(self, topic):
        self._topics.session.confirm(topic)

    def from_device(self, _payload):
        """Do nothing: the device sends nothing here."""

    def close(self):
        self._subscriber.unregister()
        self._topics.session.link.forget(self._topic.topic_id)
