"""From bytes to channels: the real firmware behind ctypes, and the receiver at the end of the trainer cord."""

import itertools
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from serial_client import ASK_FOR_TOPICS, STATUS_TOPIC, channels_of, controls, packets

from risc_simulator.vehicles.iris import transmitter
from risc_simulator.vehicles.iris.transmitter import LINE_S, TICKS_PER_US, Board, PpmReceiver

FRAME_US, PULSE_US = 20000, 250
GOOD = (1500, 1400, 1100, 1600)


def edges_of(channels_us, begin_us=0, pulse_us=PULSE_US, pulse_level=0):
    """Edges (time [ticks], level) of a frame, with the pulse that ends its last channel."""
    starts_us = itertools.accumulate(channels_us, initial=begin_us)
    return [
        (round(TICKS_PER_US * (start_us + after_us)), level)
        for start_us in starts_us
        for after_us, level in ((0, pulse_level), (pulse_us, 1 - pulse_level))
    ]


class Signal:
    """Sends consecutive frames to a receiver, in pieces of 5 ms."""

    def __init__(self, **options):
        self.receiver, self._begin_us = PpmReceiver(**options), 0
        self.options = {"pulse_level": options.get("pulse_level", 0)}

    def send(self, channels_us=GOOD, change=None, **how):
        """Send a frame; return the channels that the receiver decodes, or None if refused. change: alters the edges."""
        edges = edges_of(channels_us, self._begin_us, **{**self.options, **how})
        if change is not None:
            edges = change(edges)
        first, self._begin_us = self._begin_us, self._begin_us + FRAME_US
        found = []
        for now_us in range(first, self._begin_us, 5000):
            until = [edge for edge in edges if edge[0] <= TICKS_PER_US * (now_us + 5000)]
            edges = edges[len(until) :]
            found += self.receiver.feed(until, TICKS_PER_US * (now_us + 5000))
        assert len(found) <= 1
        if not found:
            return None
        assert found[0][0] == TICKS_PER_US * first
        return found[0][1]

    @property
    def is_lost(self):
        return self.receiver.is_lost(TICKS_PER_US * self._begin_us)


def synchronised(**options):
    signal = Signal(**options)
    signal.send()
    assert signal.send() == GOOD
    return signal


@pytest.mark.parametrize("pulse_level", [0, 1])
@pytest.mark.parametrize("channels_us", [GOOD, (900, 2100, 900, 2100), (1500,) * 8, (1001, 1999, 1234, 1567, 1500)])
def test_a_good_frame_is_read_to_the_microsecond_in_either_polarity(pulse_level, channels_us):
    signal = Signal(pulse_level=pulse_level)
    assert signal.send(channels_us) is None, "what came before its first edge is unknown"
    for _ in range(5):
        assert signal.send(channels_us) == channels_us
    assert signal.receiver.counts == {"no gap before": 1, "frames": 5}


def test_frames_that_come_in_all_at_once_are_read_too():
    """A busy computer looks at the signal less often than a frame takes."""
    receiver = PpmReceiver()
    edges = [edge for k in range(4) for edge in edges_of(GOOD, k * FRAME_US)]
    assert [channels for _, channels in receiver.feed(edges, TICKS_PER_US * 4 * FRAME_US)] == [GOOD] * 3
    assert receiver.counts == {"no gap before": 1, "frames": 3}


def cut(first, last=None):
    return lambda edges: edges[:first] + (edges[last:] if last is not None else [])


MALFORMED = {
    "too few channels": {"channels_us": GOOD[:3]},
    "too many channels": {"channels_us": (1500,) * 9},
    "a channel out of range": {"channels_us": (1500, 799, 1100, 1600)},
    "a channel that is too long": {"channels_us": (1500, 2201, 1100, 1600)},
    "a pulse of another length": {"pulse_us": 90},
    "a pulse that is too long": {"pulse_us": 501},
    "another number of channels": {"channels_us": (*GOOD, 1500)},
    "a pulse missing": {"change": cut(4, 6)},
    "a falling edge missing": {"change": cut(4, 5)},
    "a rising edge missing": {"change": cut(5, 6)},
    "the last pulse missing": {"change": cut(8)},
    "half of the last pulse": {"change": cut(9)},
    "a spike in a channel": {"change": lambda e: sorted([*e, (e[2][0] + 21000, 0), (e[2][0] + 21100, 1)])},
    "nothing": {"change": lambda e: []},
    "times that go back": {"change": lambda e: [*e[:4], (e[3][0] - 1, 0), (e[3][0] + 10000, 1), *e[4:]]},
}


@pytest.mark.parametrize("what", MALFORMED)
def test_a_malformed_frame_is_refused_and_the_next_one_is_not(what):
    signal = synchronised()
    before = signal.receiver.counts.copy()
    assert signal.send(**MALFORMED[what]) is None
    assert signal.receiver.channels_us == GOOD, "what was is held"
    refused = signal.receiver.counts - before
    assert "frames" not in refused and bool(refused) == (what != "nothing")
    after = [signal.send(), signal.send()]  # a line that stays low also hides the first edge of the next frame
    assert after == [None if what == "half of the last pulse" else GOOD, GOOD]


def test_a_signal_with_another_number_of_channels_is_believed_after_three_frames():
    signal = synchronised()
    six = (*GOOD, 1500, 1000)
    assert [signal.send(six) for _ in range(4)] == [None, None, six, six]
    assert signal.send() is None


def test_loss_is_reported_after_half_a_second_and_ends_with_a_good_frame():
    signal = Signal()
    assert signal.is_lost
    signal = synchronised()
    lost = []
    for _ in range(30):
        signal.send(channels_us=GOOD[:3])
        lost.append(signal.is_lost)
    assert lost.index(True) in (23, 24)  # the last good frame had begun 0.02 s before it ended
    signal.send()
    assert not signal.is_lost


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 20_000), st.integers(0, 1)), max_size=200), st.integers(1, 20))
def test_whatever_edges_come_only_frames_within_the_limits_come_out(steps, pieces):
    receiver, now, edges, found = PpmReceiver(), 0, [], []
    for k, (step_us, level) in enumerate(steps):
        now += TICKS_PER_US * step_us
        edges.append((now, level))
        if k % pieces == 0:
            found += receiver.feed(edges, now)
            edges = []
    found += receiver.feed(edges, now + 10**7)
    assert receiver.counts["frames"] == len(found)
    for _, channels_us in found:
        assert 4 <= len(channels_us) <= 8 and all(800 <= us <= 2200 for us in channels_us)


def test_bits_of_noise_in_a_signal_let_no_wrong_frame_through():
    """Random spikes and lost edges: every frame that is decoded was sent."""
    rng, signal = random.Random(3), synchronised()
    sent, received = set(), []

    def damage(edges):
        edges = [edge for edge in edges if rng.random() > 0.02]
        if rng.random() < 0.3:
            start = edges[0][0] + rng.randrange(600_000)
            edges = sorted([*edges, (start, 0), (start + rng.randrange(8000), 1)])
        return edges

    for _ in range(500):
        channels_us = tuple(rng.randrange(1000, 2001) for _ in range(4))
        sent.add(channels_us)
        received.append(signal.send(channels_us, change=damage))
    good = [channels_us for channels_us in received if channels_us is not None]
    assert 100 < len(good) < 450 and set(good) <= sent


# ------------------------------------------------------------------ with the firmware


class Desk:
    """A board, its receiver, and the bytes of a host computer."""

    def __init__(self):
        self.board, self.receiver, self.now_s, self.frames, self.bytes = Board(), PpmReceiver(), 0.0, [], b""

    def run(self, duration_s, message=None, every_s=0.022):
        """Let time pass in the lab's cycles; message: sent every every_s."""
        end_s, next_s = self.now_s + duration_s, self.now_s
        while self.now_s < end_s - 1e-9:
            if message is not None and next_s <= self.now_s:
                self.board.receive(message)
                next_s += every_s
            self.now_s += 0.005
            self.board.advance(self.now_s)
            self.frames += self.receiver.feed(self.board.edges(), 1e6 * TICKS_PER_US * self.now_s)
            self.bytes += self.board.sent()

    @property
    def channels_us(self):
        return self.receiver.channels_us

    def start(self):
        """Negotiate, and unlock the throttle."""
        self.board.receive(ASK_FOR_TOPICS)
        self.run(0.3)
        self.run(0.3, controls())


@pytest.fixture
def desk():
    desk = Desk()
    yield desk
    desk.board.close()


def test_the_firmware_speaks_rosserial_and_sends_nothing_that_is_malformed(desk):
    desk.start()
    desk.run(1.0, controls(phi=0.5, theta=-0.25, psi=0.1, throttle=0.2))
    assert desk.channels_us == (1750, 1375, 1600, 1550)
    assert set(desk.receiver.counts) <= {"frames", "no gap before"}
    announced = [payload for topic, payload in packets(desk.bytes) if topic == 1]
    assert len(announced) == 1 and b"risc_msgs/Controls" in announced[0] and b"controls" in announced[0]
    states = [channels_of(payload) for topic, payload in packets(desk.bytes) if topic == STATUS_TOPIC]
    assert len(states) >= 10 and states[-1] == (2, desk.channels_us)


def test_the_failsafe_of_the_firmware_and_a_reset_lower_the_throttle_below_the_autopilots_limit(desk):
    desk.start()
    desk.run(0.3, controls(throttle=0.1))
    assert desk.channels_us[2] == 1550
    desk.run(0.7)
    assert desk.channels_us == (1500, 1500, 950, 1500)
    desk.run(0.3, controls())
    desk.run(0.5, controls(throttle=0.1))
    assert desk.channels_us[2] == 1550
    desk.board.reset()
    desk.run(0.2)
    assert desk.channels_us == (1500, 1500, 950, 1500)


def test_a_message_is_in_the_frames_after_its_way_over_the_line(desk):
    desk.start()
    desk.run(0.5, controls(throttle=-0.5))
    began = desk.now_s
    desk.board.receive(controls(throttle=-0.45))
    desk.run(0.1)
    first_s = min(begin / (1e6 * TICKS_PER_US) for begin, us in desk.frames if us[2] == 1275)
    assert began + 0.7 * LINE_S < first_s < began + LINE_S + 0.021
    assert began + 0.7 * LINE_S < desk.board.accepted_s() <= first_s
    accepted_s = desk.board.accepted_s()
    desk.board.receive(controls(throttle=2.0))
    desk.run(0.1)
    assert desk.board.accepted_s() == accepted_s, "out of range"


def test_two_boards_have_nothing_in_common(desk):
    other = Desk()
    desk.start()
    desk.run(0.3, controls(throttle=0.1))
    other.run(desk.now_s)
    assert (desk.channels_us[2], other.channels_us[2]) == (1550, 950)
    other.board.close()
    other.board.close()


def test_a_firmware_that_is_not_built_is_one_clear_error(monkeypatch):
    monkeypatch.setattr(transmitter, "LIBRARY", "libdueppm_elsewhere.so")
    with pytest.raises(OSError, match="./maap build"):
        Board()
