"""The link's states, topic requests and queue, with a scripted line in simulated time."""

import itertools
import math

import pytest

from rosserial_python import protocol
from rosserial_python.diagnosis import Cause, cause_of
from rosserial_python.link import Link, State
from rosserial_python.protocol import GROOVY_REQUEST, Decoder, Id, Topic, encode

BYTE_S = 10 / 57600
CONTROLS = Topic(100, "controls", "risc_msgs/Controls", 32 * "0", 512)
STATUS = Topic(125, "ppm_status", "risc_maap_msgs/PpmStatus", 32 * "1", 512)
STEP_S = 0.001


def announcement(kind, topic):
    """Packet with a TopicInfo."""
    texts = b"".join(len(t).to_bytes(4, "little") + t.encode() for t in (topic.name, topic.type, topic.md5sum))
    payload = topic.topic_id.to_bytes(2, "little") + texts + topic.buffer_bytes.to_bytes(4, "little")
    return encode(kind, payload)


ANSWER = (
    encode(Id.TIME, bytes(8)) + announcement(Id.PUBLISHER, STATUS) + announcement(Id.SUBSCRIBER, CONTROLS)
)  # a device's answer to a topic request


class ScriptedLine:
    """Accepts bytes and records them."""

    def __init__(self, byte_s=BYTE_S):
        self.byte_s = byte_s
        self.written = b""
        self.room = math.inf  # [bytes] that it still accepts
        self.waiting = 0  # [bytes] that `queued` returns
        self.discards = 0
        self.error = None
        self._decoder = Decoder()

    def write(self, data):
        if self.error is not None:
            raise self.error
        taken = int(min(len(data), self.room))
        self.room -= taken
        self.written += data[:taken]
        return taken

    def queued(self):
        return self.waiting

    def discard(self):
        self.discards += 1

    def packets(self):
        """Packets written since the last call."""
        data, self.written = self.written, b""
        return self._decoder.feed(data, 0.0)


class Scene:
    """A link, its line and the time; `device(packet)` gives the device's answer (bytes), which comes at once."""

    def __init__(self, device=None, silence_s=0.3, **options):
        self.link, self.line, self.now_s = Link(silence_s), ScriptedLine(**options), 100.0
        self.device = device
        self.sent = []  # (time, packet) to the device
        self.heard = []  # packets from it
        self.link.opened(self.line, self.now_s)
        self.look(b"")

    @property
    def state(self):
        return self.link.facts.state

    def look(self, data):
        """Do what a session does when bytes came, or at the time that `due_s` gave."""
        self.heard += (found := self.link.received(data, self.now_s))
        for topic_id, payload in found:
            if topic_id in (Id.PUBLISHER, Id.SUBSCRIBER):
                topic = protocol.topic_of(payload)
                if topic.name != "unknown":
                    self.link.confirm(topic, self.now_s)
        self.link.tick(self.now_s)
        packets = self.line.packets()
        self.sent += [(self.now_s, packet) for packet in packets]
        if self.device is not None and packets:
            answer = b"".join(map(self.device, packets))
            if answer:
                self.look(answer)

    def run(self, duration_s, came=None):
        """Advance the time. came: {time from now [s]: bytes}."""
        begin_s, came = self.now_s, sorted((came or {}).items())
        due_s = self.link.due_s(self.now_s)
        while self.now_s < begin_s + duration_s:
            data = b""
            self.now_s += STEP_S
            while came and self.now_s - begin_s >= came[0][0]:
                data += came.pop(0)[1]
            if data or self.now_s >= due_s:
                self.look(data)
                due_s = self.link.due_s(self.now_s)

    def requests(self):
        """Times of the topic requests."""
        return [at_s for at_s, packet in self.sent if packet == (Id.PUBLISHER, b"")]


def answers(packet):
    return ANSWER if packet == (Id.PUBLISHER, b"") else b""


def publishing(duration_s, period_s=0.1, data=encode(STATUS.topic_id, b"x")):
    """{time from now [s]: bytes} that a publishing device sends."""
    return {k * period_s: data for k in range(1, round(duration_s / period_s) + 1)}


def test_topics_are_asked_for_at_once_and_until_an_answer_comes():
    scene = Scene()
    scene.run(1.0)
    assert scene.requests()[0] == 100.0 and scene.state is State.WAITING
    assert all(0.1 < b - a < 0.2 for a, b in itertools.pairwise(scene.requests()))
    scene.device = answers
    scene.run(0.15)
    assert scene.state is State.UP
    assert [packet.topic_id for packet in scene.heard] == [Id.TIME, Id.PUBLISHER, Id.SUBSCRIBER]


def test_a_device_that_publishes_is_left_alone():
    scene = Scene(answers)
    scene.run(10.0, publishing(10.0))
    assert len(scene.requests()) == 2, "at once, and a second later in case that an answer was lost without a trace"
    assert scene.link.facts.counts["lost"] == 0


def test_a_quiet_device_is_asked_and_counts_as_alive():
    """As an original device that publishes nothing and asks for the time every 2.5 s."""
    scene = Scene(answers)
    scene.run(10.0, {2.5 * k: encode(Id.TIME, bytes(8)) for k in (1, 2, 3)})
    assert scene.state is State.UP and scene.link.facts.counts["lost"] == 0
    assert 50 < len(scene.requests()) < 80, "10 s / 0.15 s"


@pytest.mark.parametrize("is_quiet", [True, False])
def test_a_dead_link_is_noticed_in_0_3_s(is_quiet):
    scene = Scene(answers)
    scene.run(3.0, {} if is_quiet else publishing(3.0))
    assert scene.state is State.UP
    scene.device, begin_s = None, scene.link.facts.heard_s
    while scene.state is State.UP:
        scene.run(STEP_S)
    assert scene.now_s - begin_s == pytest.approx(0.3, abs=2 * STEP_S)
    assert scene.line.discards == 1 and scene.link.facts.counts["lost"] == 1


def test_one_question_that_is_lost_is_no_dead_link():
    scene, count = Scene(answers), itertools.count()
    scene.run(2.0)
    scene.device = lambda packet: answers(packet) if next(count) % 2 else b""
    scene.run(10.0)
    assert scene.link.facts.counts["lost"] == 0


def test_a_device_that_answers_for_long_is_asked_less_and_given_more_time():
    many = ANSWER + b"".join(announcement(Id.PUBLISHER, STATUS._replace(topic_id=126 + k)) for k in range(24))
    scene = Scene(lambda packet: many if packet == (Id.PUBLISHER, b"") else b"")
    scene.run(5.0)
    before = len(scene.requests())
    scene.run(10.0)
    assert (len(scene.requests()) - before) * len(many) * BYTE_S <= 0.55 * 10.0, "half of the line"
    assert scene.link.snapshot()[1] == pytest.approx(0.15 + 2 * len(many) * BYTE_S, rel=0.02)
    assert scene.link.facts.counts["lost"] == 0
    fast = Scene(scene.device, byte_s=0.0)
    fast.run(5.0)
    assert fast.link.snapshot()[1] == 0.3, "a network has room"


def test_messages_that_nothing_explains_do_not_fill_the_line_with_questions():
    many = ANSWER + b"".join(announcement(Id.PUBLISHER, STATUS._replace(topic_id=126 + k)) for k in range(24))
    scene = Scene(lambda packet: many if packet == (Id.PUBLISHER, b"") else b"")
    scene.run(5.0)
    before = len(scene.requests())
    for _ in range(500):
        scene.link.ask_topics(scene.now_s)
        scene.look(encode(300, b"x"))
        scene.run(0.01)
    assert 5 < len(scene.requests()) - before <= 0.55 * 5.0 / (len(many) * BYTE_S), "half of the line"


def test_a_question_that_comes_too_soon_is_asked_later():
    scene = Scene(answers)
    scene.run(0.03)
    scene.link.ask_topics(scene.now_s)
    scene.run(0.2, publishing(0.2, 0.01))
    assert scene.requests() == pytest.approx([100.0, 100.1], abs=2 * STEP_S)


def silent_for(duration_s):
    """A Scene whose device was up, and then silent for duration_s."""
    scene = Scene(answers)
    scene.run(2.0)
    scene.device = None
    scene.run(duration_s)
    assert scene.state is State.WAITING
    return scene


def lost_for(duration_s):
    """A Scene whose device was silent for duration_s and sends again, but has not announced its topics."""
    scene = silent_for(duration_s)
    scene.sent.clear()
    scene.run(0.01, {0.0: encode(STATUS.topic_id, b"x")})
    assert scene.state is State.UP
    return scene


def commands(scene):
    """Payloads that were sent to CONTROLS until now."""
    scene.look(b"")
    return [packet.payload for _, packet in scene.sent if packet.topic_id == CONTROLS.topic_id]


def test_a_device_that_was_lost_for_long_gets_messages_after_it_has_announced_its_topics():
    scene = lost_for(3.0)
    scene.link.post(CONTROLS.topic_id, b"command", scene.now_s)
    scene.run(0.05)
    assert commands(scene) == [], "perhaps it has another program now"
    scene.device = answers
    scene.run(0.2)
    assert commands(scene) == [b"command"]


def test_a_device_that_was_lost_for_a_moment_gets_messages_at_its_first_packet():
    scene = lost_for(2.0)
    scene.link.post(CONTROLS.topic_id, b"command", scene.now_s)
    scene.run(0.01)
    assert commands(scene) == [b"command"]


@pytest.mark.parametrize(
    "answer",
    [announcement(Id.SUBSCRIBER, CONTROLS._replace(name="unknown")), announcement(Id.PUBLISHER, STATUS)],
    ids=["another topic of this id", "no topic of this id"],
)
def test_a_device_that_was_lost_for_a_moment_and_has_another_program_gets_no_messages_for_the_old_one(answer):
    scene = lost_for(2.0)
    scene.device = lambda packet: answer if packet == (Id.PUBLISHER, b"") else b""
    scene.run(2.5)
    scene.link.post(CONTROLS.topic_id, b"command", scene.now_s)
    assert commands(scene) == []


def test_a_device_behind_a_reopened_port_may_be_another_one():
    scene = silent_for(0.5)
    scene.link.closed(scene.now_s)
    scene.link.opened(scene.line, scene.now_s)
    scene.run(0.01, {0.0: encode(STATUS.topic_id, b"x")})
    scene.link.post(CONTROLS.topic_id, b"command", scene.now_s)
    assert scene.state is State.UP and commands(scene) == []


def test_a_device_that_was_lost_is_asked_often_however_long_it_is_away():
    scene = silent_for(8.0)
    lost_s = [at_s for at_s in scene.requests() if at_s >= scene.link.facts.heard_s + 0.3]
    apart_s = [b - a for a, b in itertools.pairwise(lost_s)]
    assert len(apart_s) > 300 and max(apart_s) <= 0.65 * len(ANSWER) * BYTE_S + 2 * STEP_S
    assert min(apart_s) >= 0.65 * len(ANSWER) * BYTE_S


def test_a_device_that_comes_back_in_the_middle_of_an_answer_is_asked_again_soon():
    scene = silent_for(3.0)
    begin_s = scene.now_s
    scene.link.post(CONTROLS.topic_id, b"command", scene.now_s)
    scene.run(0.005, {0.0: announcement(Id.PUBLISHER, STATUS)})
    scene.device = answers
    scene.run(0.2)
    (sent_s,) = [at_s for at_s, packet in scene.sent if packet.topic_id == CONTROLS.topic_id]
    assert sent_s - begin_s < 0.03


def test_noise_that_looks_like_the_head_of_a_long_packet_does_not_hide_that_a_device_is_back():
    scene = silent_for(0.35)
    begin_s, head = scene.now_s, encode(200, bytes(1780))[:20]
    came = {0.02 * k: encode(Id.TIME, bytes(8)) for k in range(1, 100)}  # no gap of GAP_S, which would end the wait
    scene.run(0.1, {0.0: head, **came})
    assert scene.state is State.UP and scene.now_s - begin_s < 0.11
    scene.device = answers
    scene.run(0.5)
    scene.heard.clear()
    scene.look(encode(STATUS.topic_id, bytes(1780)))
    assert [len(packet.payload) for packet in scene.heard] == [1780], "no limit for a device that is there"


def test_with_a_long_silence_the_boot_loader_of_an_arduino_mega_is_left_2_5_s_between_requests():
    """The boot loader does not start the sketch while bytes come."""
    scene = Scene(answers, silence_s=5.0)
    scene.run(20.0)
    scene.device = None
    scene.run(30.0)
    assert scene.state is State.WAITING
    asked_s = [at_s for at_s in scene.requests() if at_s > scene.link.facts.heard_s + 4.9]
    assert all(b - a > 2.49 for a, b in itertools.pairwise(asked_s)) and len(asked_s) > 8


def test_after_damage_the_device_is_asked_and_not_only_when_it_publishes_next():
    scene = Scene(answers)
    scene.run(2.05, publishing(2.05))
    scene.sent.clear()
    half = encode(STATUS.topic_id, bytes(30))[:20]
    scene.run(0.09, {0.0: half})
    (asked_s,) = scene.requests()
    assert asked_s - (scene.now_s - 0.09) < 0.06
    assert scene.link.facts.heard_s == asked_s


def test_a_sound_packet_after_damage_is_as_good_as_an_answer():
    scene = Scene(answers)
    scene.run(3.05, publishing(3.05))
    scene.sent.clear()
    scene.run(0.05, {0.0: b"noise" + encode(STATUS.topic_id, b"x"), 0.01: encode(STATUS.topic_id, b"x")})
    assert scene.requests() == []


def test_an_announcement_that_is_damaged_comes_again():
    damaged = bytearray(ANSWER)
    damaged[-10] ^= 1
    replies = iter((bytes(damaged), ANSWER))
    scene = Scene(lambda packet: next(replies, b"") if packet == (Id.PUBLISHER, b"") else b"")
    scene.link.post(CONTROLS.topic_id, b"command", scene.now_s)
    scene.run(0.3, publishing(0.3, 0.01))
    (sent_s,) = [at_s for at_s, packet in scene.sent if packet.topic_id == CONTROLS.topic_id]
    assert sent_s - 100.0 < 0.15


def test_an_announcement_that_is_damaged_without_a_trace_is_asked_for_again():
    """An 8-bit sum lets one damaged packet in 256 pass. Messages must not wait until the device falls silent."""
    scene = Scene(answers)
    scene.run(2.0, publishing(2.0))
    scene.look(announcement(Id.SUBSCRIBER, CONTROLS._replace(name="unknown")))
    scene.link.post(CONTROLS.topic_id, b"command", scene.now_s)
    scene.run(0.2, publishing(0.2))
    assert commands(scene) == [b"command"]


def test_an_announcement_that_is_lost_without_a_trace_comes_again():
    replies = iter((ANSWER[: -len(announcement(Id.SUBSCRIBER, CONTROLS))], ANSWER))
    scene = Scene(lambda packet: next(replies, b"") if packet == (Id.PUBLISHER, b"") else b"")
    scene.link.post(CONTROLS.topic_id, b"command", scene.now_s)
    scene.run(1.2, publishing(1.2))
    assert [packet for _, packet in scene.sent if packet.topic_id == CONTROLS.topic_id]


def test_topics_that_a_device_had_before_are_asked_for_soon():
    scene = Scene(answers)
    scene.run(3.0)
    scene.link.closed(scene.now_s)
    replies = iter((ANSWER[: -len(announcement(Id.SUBSCRIBER, CONTROLS))], ANSWER))
    scene.device = lambda packet: next(replies, b"") if packet == (Id.PUBLISHER, b"") else b""
    scene.link.opened(scene.line, scene.now_s)
    scene.sent.clear()
    scene.look(b"")
    scene.link.post(CONTROLS.topic_id, b"command", scene.now_s)
    begin_s = scene.now_s
    scene.run(0.5, publishing(0.5))
    (sent_s,) = [at_s for at_s, packet in scene.sent if packet.topic_id == CONTROLS.topic_id]
    assert sent_s - begin_s < 0.15


def test_a_message_goes_out_at_once():
    scene = Scene(answers)
    scene.run(1.5)
    assert scene.link.post(CONTROLS.topic_id, b"command", scene.now_s)
    assert scene.line.packets() == [(CONTROLS.topic_id, b"command")]


def test_the_newest_message_waits_for_a_busy_line_and_the_older_ones_do_not():
    scene = Scene(answers)
    scene.run(1.5, publishing(1.5))
    assert scene.link.post(CONTROLS.topic_id, bytes(66), scene.now_s)
    begin_s = scene.now_s
    for k in range(20):
        assert not scene.link.post(CONTROLS.topic_id, b"%d" % k, scene.now_s)
    scene.sent.clear()
    scene.line.packets()
    scene.run(0.05)
    assert scene.sent == [(pytest.approx(begin_s + 74 * BYTE_S, abs=2 * STEP_S), (CONTROLS.topic_id, b"19"))]
    assert scene.link.facts.counts["replaced"] == 19


@pytest.mark.parametrize(("byte_s", "most"), [(BYTE_S, 1.0 / (74 * BYTE_S) + 2), (0.0, 1000)])
def test_the_line_is_not_given_more_than_it_carries(byte_s, most):
    """Otherwise the kernel would buffer a second of old commands."""
    scene = Scene(answers, byte_s=byte_s)
    scene.run(1.5)
    scene.sent.clear()
    for _ in range(1000):  # 1 kHz of 74 bytes for 1 s: thirteen times what 57600 baud carry
        scene.link.post(CONTROLS.topic_id, bytes(66), scene.now_s)
        scene.run(STEP_S)
    count = sum(packet.topic_id == CONTROLS.topic_id for _, packet in scene.sent)
    assert 0.6 * most < count <= most


def test_nothing_is_written_while_the_kernel_holds_more_than_a_few_packets():
    scene = Scene(answers, byte_s=0.0)
    scene.run(1.5)
    scene.line.waiting = 2000
    assert not scene.link.post(CONTROLS.topic_id, b"old", scene.now_s)
    scene.run(0.1)
    assert not scene.link.post(CONTROLS.topic_id, b"new", scene.now_s)
    scene.line.waiting, scene.sent = 0, []
    scene.run(0.01)
    assert [packet for _, packet in scene.sent if packet.topic_id == CONTROLS.topic_id] == [(100, b"new")]


def test_an_old_message_is_not_sent():
    scene = Scene(answers)
    scene.run(1.5)
    scene.device = None
    scene.run(0.35)
    assert scene.state is State.WAITING
    scene.link.post(CONTROLS.topic_id, b"old", scene.now_s, scene.now_s + 0.25)
    scene.run(0.5)
    scene.device, scene.sent = answers, []
    scene.run(0.5)
    assert scene.state is State.UP
    assert all(packet.topic_id != CONTROLS.topic_id for _, packet in scene.sent)
    assert scene.link.facts.counts["outdated"] == 1
    scene.link.post(CONTROLS.topic_id, b"new", scene.now_s, scene.now_s + 0.25)
    assert (CONTROLS.topic_id, b"new") in scene.line.packets()


def test_a_packet_that_was_begun_is_finished_before_another_one():
    scene = Scene(answers)
    scene.run(1.5)
    scene.line.room = 5
    assert not scene.link.post(CONTROLS.topic_id, b"first", scene.now_s)
    scene.link.reply(Id.TIME, bytes(8), scene.now_s)
    scene.line.room = math.inf
    scene.sent.clear()
    scene.run(0.05)
    assert [packet for _, packet in scene.sent] == [(CONTROLS.topic_id, b"first"), (Id.TIME, bytes(8))]


def test_topics_take_turns():
    scene = Scene(answers)
    scene.link.confirm(CONTROLS._replace(topic_id=101), scene.now_s)
    scene.run(1.5)
    scene.sent.clear()
    for _ in range(200):
        for topic_id in (100, 101):
            scene.link.post(topic_id, bytes(30), scene.now_s)
        scene.run(STEP_S)
    ids = [packet.topic_id for _, packet in scene.sent if packet.topic_id >= 100]
    assert abs(ids.count(100) - ids.count(101)) <= 1 and len(ids) > 20


def cause(scene):
    """Cause that `~link` would report."""
    return cause_of(scene.link.snapshot()[0], scene.now_s)


def test_noise_is_damage_for_who_asks():
    scene = Scene(answers)
    scene.run(2.0, publishing(2.0))
    assert cause(scene) is Cause.NONE
    scene.run(1.0, publishing(1.0) | {0.25: b"noise", 0.45: b"noise", 0.65: encode(STATUS.topic_id, b"x")[:-1]})
    assert cause(scene) is Cause.DAMAGE
    for _ in scene.link.snapshot()[0].damaged_s:
        scene.look(b"noise")  # a deque over which another thread iterates must not change
    scene.run(10.0, publishing(10.0))
    assert cause(scene) is Cause.NONE


@pytest.mark.parametrize(("losses", "found"), [(2, Cause.NONE), (3, Cause.BREAKS)])
def test_three_losses_within_a_minute_are_a_link_that_breaks(losses, found):
    scene = Scene(answers)
    for _ in range(losses):
        scene.run(2.0)
        scene.device = None
        scene.run(0.5)
        assert cause(scene) is Cause.STOPPED
        scene.device = answers
    scene.run(2.0)
    assert cause(scene) is found
    scene.run(60.0)
    assert cause(scene) is Cause.NONE


def test_a_device_that_never_says_anything_is_silent():
    scene = Scene()
    scene.run(0.9)
    assert cause(scene) is Cause.NONE, "a first answer may take a second"
    scene.run(0.2)
    assert cause(scene) is Cause.SILENT
    scene.run(0.1, {0.0: bytes(20)})
    assert cause(scene) is Cause.SPEED


def test_a_write_that_fails_is_the_end_of_the_line():
    scene = Scene(answers)
    scene.run(1.5)
    scene.line.error = OSError(5, "gone")
    scene.link.post(CONTROLS.topic_id, b"x", scene.now_s)
    assert scene.link.failure is scene.line.error
    scene.link.closed(scene.now_s)
    assert scene.state is State.CLOSED and scene.link.facts.counts["lost"] == 1
    scene.link.post(CONTROLS.topic_id, b"y", scene.now_s)
    scene.link.tick(scene.now_s)
    assert scene.link.due_s(scene.now_s) == math.inf


def test_a_device_of_groovy_is_asked_in_its_own_words_now_and_then():
    scene = Scene()
    scene.run(3.0)
    written = []
    scene.line.packets = lambda: written.append(scene.line.written) or []
    scene.run(3.0)
    assert GROOVY_REQUEST in written[-1]
    scene.run(0.01, {0.0: bytes.fromhex("ffff0a0008000000000000000000ed")})
    assert scene.link.facts.speaks_groovy and scene.state is State.WAITING
