"""The link to one device: whether it is alive, when to ask it, and what to send next. No ROS, no ports.

Times are [s] of one clock that never steps; the caller passes the current time. The line is an object with
`write(data)` (returns the number of bytes accepted, raises OSError), `queued()` (bytes accepted but not sent yet),
`discard()` (drop those if possible) and `byte_s` (time to send one byte, 0: unknown).

A device that publishes is alive. A quiet one is asked for its topics: every device answers that at once; nothing else
is needed.
"""

import copy
import enum
import math
import threading
from collections import deque
from dataclasses import dataclass, field

from rosserial_python import protocol
from rosserial_python.protocol import Decoder, Id

USUAL_SILENCE_S = 0.3  # silence after which a link is lost; a larger setting means: do not ask the device often
_IN_FLIGHT_BYTES = 256  # no packet is written while more than this is in the kernel or not acknowledged
_FULL_LINE_S = 0.002  # until a full line is checked again
_WORRY_S = 0.02  # without a valid packet after damage for this long, the device is asked
_APART_S = 0.05  # between two such requests
_OFTEN_S, _OFTEN_SHARE = 0.02, 0.65  # between requests to a lost device: minimum; share of its answer's duration
_SAME_PROGRAM_S = 2.5  # after a shorter silence the device has the same program: loading another takes longer
_AGAIN_S = 0.1  # between two requests while topics are missing
_SECOND_REQUEST_S = 1.0  # after the first announcement: finds announcements that were lost unnoticed
_GROOVY_EVERY = 8  # to a device that never answered, every 8th request is also sent in the old protocol
_TIME_BYTES = len(protocol.encode(Id.TIME, bytes(8)))  # an answer begins with a request for the time
_REPLIES = 64  # answers that may wait to be sent; a device waits for each answer to its own requests


class State(enum.IntEnum):
    """States as in risc_maap_msgs/SerialLink."""

    CLOSED = 0
    WAITING = 1
    UP = 2


@dataclass
class Facts:
    """Observations of a line."""

    state: State = State.CLOSED
    waits_s: float | None = None  # since when the line is open and the device does not answer
    bytes: int = 0  # received since then
    speaks_groovy: bool = False  # the old protocol was received since then
    heard_s: float = -math.inf  # last valid packet, -inf: none yet
    lost_s: deque = field(default_factory=lambda: deque(maxlen=16))  # when the link was lost, of all openings
    damaged_s: deque = field(default_factory=lambda: deque(maxlen=16))  # when damaged data arrived
    counts: dict = field(default_factory=lambda: dict.fromkeys(COUNTS, 0))  # since the start


COUNTS = (
    "packets",  # valid packets from the device
    "damaged",  # packets that began and were not valid
    "stray bytes",  # bytes outside packets
    "openings",  # of the port
    "lost",  # the device fell silent
    "requests",  # for topics
    "sent",  # messages to the device
    "replaced",  # by a newer one before the line was free
    "outdated",  # too old to be sent
)


@dataclass
class _Waiting:
    """The newest message for one topic of the device."""

    packet: bytes
    expires_s: float


class Link:
    """See the module. Any thread may call; packets are returned, not passed to a callback."""

    def __init__(self, silence_s=USUAL_SILENCE_S):
        self._silence_s = silence_s
        self._lock = threading.Lock()
        self._line = self._decoder = None
        self._answers = {}  # {(id, topic id): (bytes, hash)} of the announcements with which a device answers a request
        self._missing = set()  # keys of announcements made before the device was lost, and not repeated yet
        self._unsure = False  # damaged data arrived since the last request: it may have been an announcement
        self._announced = set()  # topic ids to which messages may be sent
        self._announced_before = set()  # topic ids that were in _announced when the device was lost
        self._announced_s = None  # when the first announcement arrived
        self._asked_s = self._suspected_s = -math.inf  # last request; last damage without a valid packet after it
        self._asked_again = False
        self._rest = b""  # unsent end of a packet
        self._longest_bytes = protocol.PLAUSIBLE_BYTES  # of a payload
        self._free_s = -math.inf  # when the line will have sent all bytes it was given
        self._replies, self._waiting = deque(maxlen=_REPLIES), {}  # packets; {topic id: _Waiting}
        self.opened_s = -math.inf
        self.failure = None  # OSError of a write: the line must be closed
        self.facts = Facts()

    # --- the line -------------------------------------------------------------------------------------------------
    def opened(self, line, now_s):
        """Use a line that was opened; ask for topics at once."""
        with self._lock:
            self._line, self._decoder, self.failure = line, Decoder(line.byte_s), None
            self._longest_bytes = protocol.PLAUSIBLE_BYTES
            self.opened_s, facts = now_s, self.facts
            facts.state = State.WAITING
            if facts.waits_s is None:
                facts.waits_s, facts.bytes, facts.speaks_groovy = now_s, 0, False
            facts.counts["openings"] += 1
            self._forget()
            self._free_s = -math.inf
            self._ask(now_s)
            self._flush(now_s)

    def closed(self, now_s, is_gone=False):
        """Note that the line is closed.  is_gone: the device is gone, too; the next line begins from the start."""
        with self._lock:
            if self.facts.state is State.UP:
                self._lose(now_s)
            self.facts.state, self._line = State.CLOSED, None
            if is_gone:
                self.facts.waits_s, self.facts.heard_s = None, -math.inf
            self._forget()

    def received(self, data, now_s):
        """Handle received bytes (b"": none until now_s); return the valid packets that they complete."""
        with self._lock:
            facts, decoder = self.facts, self._decoder
            decoder.longest_bytes = self._longest_bytes
            if self._is_lost:
                # accept no packet longer than those of the expected answer: noise like the head of one must not hide it
                decoder.longest_bytes = max(size for size, _ in self._answers.values())
            damaged, stray = decoder.damaged, decoder.stray_bytes
            packets = decoder.feed(data, now_s)
            facts.bytes += len(data)
            facts.speaks_groovy |= decoder.speaks_groovy
            facts.counts["packets"] += len(packets)
            facts.counts["damaged"] += decoder.damaged - damaged
            facts.counts["stray bytes"] += decoder.stray_bytes - stray
            if decoder.stray_bytes > stray:
                facts.damaged_s.append(now_s)
                self._suspected_s = now_s
                self._unsure |= now_s < self._asked_s + self._limit_s
            if packets:
                if now_s < facts.heard_s + _SAME_PROGRAM_S:
                    self._announced |= self._announced_before
                self._announced_before = set()
                facts.heard_s, facts.waits_s, facts.state = now_s, None, State.UP
                if decoder.stray_bytes == stray:
                    self._suspected_s = -math.inf
            for topic_id, payload in packets:
                if topic_id in protocol.ANNOUNCEMENTS:
                    key = topic_id, int.from_bytes(payload[:2], "little")
                    answer = len(payload) + protocol.OVERHEAD, hash(payload)
                    if self._answers.get(key, answer) != answer:
                        # another program, or damage that the checksum misses: no messages until `confirm` is called
                        self._announced.discard(key[1])
                        self._unsure = True
                    self._answers[key] = answer
                    self._missing.discard(key)
                    self._announced_s = now_s if self._announced_s is None else self._announced_s
            self._flush(now_s)
            return packets

    def snapshot(self):
        """Return (current Facts, silence after which the link is lost [s]), for other threads than the line's."""
        with self._lock:
            return copy.deepcopy(self.facts), self._limit_s

    # --- time -----------------------------------------------------------------------------------------------------
    @property
    def _limit_s(self):
        """Silence after which the link is lost [s]: longer if the answer to a request takes long."""
        return max(self._silence_s, 2.0 * self._answer_s + 0.5 * self._silence_s)

    @property
    def _answer_s(self):
        """Duration of the device's answer to a request [s]."""
        answer_bytes = _TIME_BYTES + sum(size for size, _ in self._answers.values())
        return answer_bytes * self._line.byte_s if self._line else 0.0

    def tick(self, now_s):
        """Detect a loss, ask, write what may be written. Call after `received`, and at `due_s`."""
        with self._lock:
            if self._line is None:
                return
            if self.facts.state is State.UP and now_s - self.facts.heard_s >= self._limit_s:
                self._lose(now_s)
                self.facts.state = State.WAITING
                self._line.discard()
                self._free_s = now_s
                before = set(self._announced)
                self._forget()
                self._announced_before = before
            if now_s >= self._ask_s():
                self._ask(now_s)
            self._flush(now_s)

    def flush(self, now_s):
        """Write waiting packets that may be sent. Use at the end instead of `tick`, which would ask a silent device."""
        with self._lock:
            self._flush(now_s)

    def due_s(self, now_s):
        """When to call `received` with no bytes, and `tick`, unless bytes arrive earlier [s]."""
        with self._lock:
            if self._line is None:
                return math.inf
            due_s = min(self._ask_s(), self._decoder.due_s)
            if self.facts.state is State.UP:
                due_s = min(due_s, self.facts.heard_s + self._limit_s)
            if self._rest or self._replies or any(topic_id in self._announced for topic_id in self._waiting):
                due_s = min(due_s, self._free_s if self._free_s > now_s else now_s + _FULL_LINE_S)
            return due_s

    @property
    def _is_lost(self):
        """Whether a device was lost whose answer is known."""
        facts = self.facts
        return facts.state is State.WAITING and bool(self._answers) and math.isfinite(facts.heard_s)

    def _ask_s(self):
        """When to ask the device for its topics next."""
        asked_s, quiet_s = self._asked_s, 0.5 * self._silence_s
        is_patient = self._silence_s > USUAL_SILENCE_S
        often_s = math.inf if is_patient else max(_OFTEN_S, _OFTEN_SHARE * self._answer_s)
        if self.facts.state is not State.UP:
            return asked_s + (min(quiet_s, often_s) if self._is_lost else quiet_s)
        # a device with long answers is asked less often, so that its answers use at most half of the line
        due_s = max(self.facts.heard_s + quiet_s, asked_s + max(0.5 * quiet_s, 2.0 * self._answer_s))
        if math.isfinite(self._suspected_s):
            due_s = min(due_s, max(self._suspected_s + _WORRY_S, asked_s + _APART_S))
        if self._announced_s is None or self._unsure or self._missing:
            due_s = min(due_s, asked_s + max(_AGAIN_S, 2.0 * self._answer_s))
        if self._missing:
            due_s = min(due_s, asked_s + often_s)
        if self._announced_s is not None and not self._asked_again:
            due_s = min(due_s, self._announced_s + _SECOND_REQUEST_S)
        return due_s

    def _ask(self, now_s):
        counts, facts = self.facts.counts, self.facts
        counts["requests"] += 1
        self._suspected_s, self._unsure = -math.inf, False
        if self._announced_s is not None and now_s >= self._announced_s + _SECOND_REQUEST_S:
            self._asked_again = True
            self._answers = {key: answer for key, answer in self._answers.items() if key not in self._missing}
            self._announced -= {topic_id for _, topic_id in self._missing}
            self._missing.clear()  # the device has another program
        self._asked_s = now_s
        if protocol.REQUEST_TOPICS not in self._replies:
            self._replies.append(protocol.REQUEST_TOPICS)
        if not math.isfinite(facts.heard_s) and counts["requests"] % _GROOVY_EVERY == 0:
            self._replies.append(protocol.GROOVY_REQUEST)

    def _lose(self, now_s):
        facts = self.facts
        facts.lost_s.append(now_s)
        facts.counts["lost"] += 1
        facts.waits_s, facts.bytes, facts.speaks_groovy = now_s, 0, False

    def _forget(self):
        """Drop what the device announced: it may come back as a different one."""
        self._announced.clear()
        self._announced_before.clear()
        self._replies.clear()
        self._missing = set(self._answers)
        self._announced_s, self._asked_again, self._suspected_s, self._rest = None, False, -math.inf, b""
        self._unsure = False

    # --- to the device --------------------------------------------------------------------------------------------
    def ask_topics(self, now_s):
        """Ask for topics, because something arrived that does not fit the known topics."""
        with self._lock:
            self._unsure = self._line is not None
            if self._line is not None and now_s >= self._ask_s():
                self._ask(now_s)
                self._flush(now_s)

    def confirm(self, topic, now_s):
        """Accept an announced protocol.Topic: messages to or from it are valid."""
        with self._lock:
            if self._line is None:
                return
            self._announced.add(topic.topic_id)
            self._longest_bytes = max(self._longest_bytes, min(topic.buffer_bytes, protocol.MOST_BYTES))
            self._flush(now_s)

    def post(self, topic_id, payload, now_s, expires_s=math.inf):
        """Send a message to a topic of the device as soon as the line is free; it replaces an older waiting one.

        Returns False when it has to wait: `due_s` has then changed.
        """
        packet = protocol.encode(topic_id, payload)
        with self._lock:
            self.facts.counts["replaced"] += topic_id in self._waiting
            self._waiting[topic_id] = _Waiting(packet, expires_s)
            self._flush(now_s)
            return topic_id not in self._waiting and not self._rest

    def reply(self, topic_id, payload, now_s):
        """Send an answer; answers keep their order and are sent before messages. Returns the same as `post`."""
        packet = protocol.encode(topic_id, payload)
        with self._lock:
            if self._line is None:
                return True
            self._replies.append(packet)
            self._flush(now_s)
            return not (self._replies or self._rest)

    def forget(self, topic_id):
        """Stop sending to this topic."""
        with self._lock:
            self._waiting.pop(topic_id, None)
            self._announced.discard(topic_id)

    @property
    def idle(self):
        """Whether no answer and no started packet waits to be sent."""
        return not (self._rest or self._replies)

    def _flush(self, now_s):
        line = self._line
        if line is None or self.failure is not None:
            return
        try:
            while True:
                if self._rest:
                    self._rest = self._rest[line.write(self._rest) :]
                    if self._rest:
                        return
                if now_s < self._free_s or line.queued() > _IN_FLIGHT_BYTES:
                    return
                packet = self._next(now_s)
                if packet is None:
                    return
                self._free_s = now_s + len(packet) * line.byte_s
                self._rest = packet[line.write(packet) :]
        except OSError as error:
            self.failure = error

    def _next(self, now_s):
        """Return the packet to send next, None if there is none."""
        if self._replies:
            return self._replies.popleft()
        counts = self.facts.counts
        for topic_id, waiting in list(self._waiting.items()):
            if now_s >= waiting.expires_s:
                del self._waiting[topic_id]
                counts["outdated"] += 1
            elif topic_id in self._announced and self.facts.state is State.UP:
                del self._waiting[topic_id]  # the next message of this topic queues behind those of other topics
                counts["sent"] += 1
                return waiting.packet
        return None
