"""Faults on the wire: effect of each, seeds, statistics, windows, and that every host's datagrams pass through."""

import math

import numpy as np
import pytest

from cortex_ros import wire
from risc_simulator.faults import (
    REGISTRY,
    FaultEvent,
    FaultFile,
    fault_settings,
    load_fault_file,
    load_faults,
    parse_fault,
)
from risc_simulator.wires import MAX_HELD_BYTES, Wires

GAP_S = 0.005
DATAGRAMS = [b"%05d" % k for k in range(4000)]


def carry(*faults, seed=1, count=len(DATAGRAMS), gap_s=GAP_S, channel="risc1/navdata"):
    """[(time sent [s], time of arrival [s], datagram)] of `count` datagrams, in order of arrival."""
    wires = Wires(seed)
    wire, arrived = wires.wire(channel), []
    for fault in faults:
        wires.add(fault)
    for k, datagram in enumerate(DATAGRAMS[:count]):
        now_s = k * gap_s
        while wires.due_s <= now_s:
            wires.release(wires.due_s)
        wire.carry(datagram, k * gap_s, now_s, lambda data, sent_s, at_s: arrived.append((sent_s, at_s, data)))
    while wires.due_s < np.inf:
        wires.release(wires.due_s)
    return arrived


@pytest.mark.parametrize("name", REGISTRY.names())
def test_a_member_says_what_people_need_and_its_default_can_happen(name):
    settings = fault_settings(name)
    assert settings.summary and "\n" not in settings.summary and len(settings.summary) < 80
    on_wires = {"datagrams", "streams", "frames"} & set(settings.acts_on)
    assert bool(settings.channel) == bool(on_wires)
    assert settings.per_vehicle or "{vehicle}" not in settings.channel
    assert set(settings.grades) in (set(), {"mild", "medium", "severe"})
    values = [settings.grades[grade] for grade in ("mild", "medium", "severe") if settings.grades]
    assert values in (sorted(values), sorted(values, reverse=True))
    program = "controller" if settings.on_programs else ""
    event = FaultEvent(name, program=program)
    assert parse_fault("%s:%s" % (name, event.args)) == event == parse_fault("%s:%s" % (name, program))


@pytest.mark.parametrize("severity", [0.0, 0.2, 0.7, 1.0])
def test_drop_loses_its_share_one_by_one(severity):
    arrived = [data for _, _, data in carry(FaultEvent("drop", channel="*", severity=severity))]
    lost = 1.0 - len(arrived) / len(DATAGRAMS)
    assert lost == pytest.approx(severity, abs=4.0 * np.sqrt(severity * (1 - severity) / len(DATAGRAMS)) + 1e-12)
    assert arrived == sorted(arrived)
    gone = np.isin(DATAGRAMS, arrived, invert=True)
    if 0.0 < severity < 1.0:  # losses are independent
        assert (gone[1:] & gone[:-1]).mean() == pytest.approx(severity**2, abs=0.03)


def test_delay_is_the_same_for_all():
    arrived = carry(FaultEvent("delay", channel="*", severity=0.032), count=500)
    np.testing.assert_allclose([at_s - sent_s for sent_s, at_s, _ in arrived], 0.032, atol=1e-9)
    assert [data for _, _, data in arrived] == DATAGRAMS[:500]


def test_jitter_is_uniform_and_lets_datagrams_overtake():
    arrived = carry(FaultEvent("jitter", channel="*", severity=0.02))
    later_s = np.array([at_s - sent_s for sent_s, at_s, _ in arrived])
    assert len(arrived) == len(DATAGRAMS)
    assert 0.0 <= later_s.min() < 0.001 and 0.019 < later_s.max() <= 0.02
    assert later_s.mean() == pytest.approx(0.01, rel=0.03)
    assert later_s.std() == pytest.approx(0.02 / np.sqrt(12.0), rel=0.03)
    assert [data for _, _, data in arrived] != DATAGRAMS


@pytest.mark.parametrize("fault", ["corrupt", "truncate"])
def test_what_has_no_bytes_is_lost_where_it_would_be_damaged(fault):
    """Offline flights carry frames and setpoints as objects, not bytes."""
    wires, arrived = Wires(1), []
    wire = wires.wire("risc1/commands")
    wires.add(FaultEvent(fault, channel="*", severity=0.3))
    for _ in range(1000):
        wire.carry((1.0, 2.0), None, 0.0, lambda data, *_: arrived.append(data))
    assert set(arrived) == {(1.0, 2.0)} and len(arrived) == pytest.approx(700, abs=60)


def test_duplicate_sends_its_share_twice():
    arrived = [data for _, _, data in carry(FaultEvent("duplicate", channel="*", severity=0.3))]
    assert len(arrived) / len(DATAGRAMS) == pytest.approx(1.3, abs=0.03)
    assert sorted(set(arrived)) == DATAGRAMS


def test_reorder_swaps_neighbours_and_loses_none():
    arrived = [data for _, _, data in carry(FaultEvent("reorder", channel="*", severity=0.1))]
    assert sorted(arrived) == DATAGRAMS
    places = np.array([int(data) for data in arrived])
    assert (np.diff(places) < 0).mean() == pytest.approx(0.1, abs=0.03)
    assert np.abs(places - np.arange(len(places))).max() <= 2


def test_corrupt_changes_one_byte():
    arrived = [data for _, _, data in carry(FaultEvent("corrupt", channel="*", severity=0.25))]
    wrong = [sum(a != b for a, b in zip(data, sent)) for data, sent in zip(arrived, DATAGRAMS)]
    assert set(wrong) == {0, 1} and np.mean(wrong) == pytest.approx(0.25, abs=0.03)


def test_truncate_leaves_the_beginning():
    arrived = [data for _, _, data in carry(FaultEvent("truncate", channel="*", severity=0.3))]
    assert all(sent.startswith(data) for data, sent in zip(arrived, DATAGRAMS, strict=True))
    cut = [len(data) for data in arrived if len(data) < 5]
    assert len(cut) / len(DATAGRAMS) == pytest.approx(0.3, abs=0.03)
    assert np.bincount(cut).min() > 150, "anywhere"


def test_wrong_reply_is_another_command_with_the_same_content():
    """In the Cortex protocol; the length stays the same, so the packet is well formed."""
    wires, reply = Wires(1), wire.encode_packet(wire.Command.GENERAL_REPLY, b"abc")
    replies = wires.wire("cortex/replies")
    wires.add(FaultEvent("wrong_reply", channel="cortex/replies", severity=0.5))
    found = [wire.split_packet(replies.carry(reply, None, 0.0, lambda data, *_: data)) for _ in range(400)]
    assert {payload for _, payload in found} == {b"abc"}
    wrong = [command for command, _ in found if command != wire.Command.GENERAL_REPLY]
    assert len(wrong) / len(found) == pytest.approx(0.5, abs=0.1)
    assert set(wrong) == set(wire.Command) - {wire.Command.GENERAL_REPLY}


def test_blackhole_has_a_window():
    arrived = [
        data for _, _, data in carry(FaultEvent("blackhole", channel="*", severity=1.0, start_s=1.0, duration_s=0.5))
    ]
    assert arrived == DATAGRAMS[:200] + DATAGRAMS[300:]


def test_faults_act_one_after_the_other():
    arrived = carry(
        FaultEvent("delay", channel="*", severity=0.01),
        FaultEvent("duplicate", channel="*", severity=1.0),
        FaultEvent("delay", channel="*", severity=0.02),
        count=9,
    )
    assert [data for _, _, data in arrived] == [data for data in DATAGRAMS[:9] for _ in range(2)]
    np.testing.assert_allclose([at_s - sent_s for sent_s, at_s, _ in arrived], 0.03)


def test_a_seed_repeats_it_and_each_wire_and_fault_has_its_own():
    drop = FaultEvent("drop", channel="*", severity=0.5)
    assert carry(drop) == carry(drop)
    assert carry(drop) != carry(drop, seed=2)
    assert [data for _, _, data in carry(drop)] != [data for _, _, data in carry(drop, channel="risc2/navdata")]
    once, twice = carry(drop), carry(drop, drop)
    assert len(twice) / len(once) == pytest.approx(0.5, abs=0.05)
    beside = carry(drop, FaultEvent("delay", channel="*", severity=0.001))
    assert [data for _, _, data in beside] == [data for _, _, data in once]


def test_a_channel_may_mean_several_wires_and_an_end_frees_them():
    wires = Wires()
    for channel in ("risc1/navdata", "risc1/commands", "risc2/navdata"):
        wires.wire(channel)

    def passing():
        return {name: wires.wire(name).carry(b"x", None, 0.0, lambda *_: True) for name in ("risc1/navdata",
                "risc1/commands", "risc2/navdata")}  # fmt: skip

    wires.add(FaultEvent("blackhole", channel="risc1/*"))
    assert passing() == {"risc1/navdata": False, "risc1/commands": False, "risc2/navdata": True}
    wires.clear("*/commands")
    assert passing() == {"risc1/navdata": False, "risc1/commands": True, "risc2/navdata": True}
    assert wires.statistics() == {
        "risc1/navdata": {"sent": 2, "delivered": 0, "later": 0},
        "risc1/commands": {"sent": 1, "delivered": 0, "later": 0},
    }


@pytest.mark.parametrize(
    "fields, message",
    [
        ({"fault": "fire"}, "'fire' .*faults; .*blackhole"),
        ({"severity": 1.5}, r"severity .*\[0, 1\]"),
        ({"severity": float("nan")}, "severity"),
        ({"severity": "much"}, "'severity' .*number"),
        ({"start_s": float("inf")}, "'start_s' .*finite"),
        ({"duration_s": -1.0}, "'duration_s' .*>= 0"),
        ({"fault": "mocap_blackout", "duration_s": 61.0}, r"duration_s .*\[0, 60\]"),
    ],
)
def test_impossible_faults_are_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        FaultEvent(**{"fault": "drop", **fields})


@pytest.mark.parametrize(
    "text, event",
    [
        ("mocap_blackout", FaultEvent("mocap_blackout", duration_s=0.3)),
        ("mocap_blackout:3@2.5", FaultEvent("mocap_blackout", duration_s=3.0, start_s=2.5)),
        ("mocap_blackout:severe", FaultEvent("mocap_blackout", duration_s=3.0)),
        ("jump:0.5,risc2@4", FaultEvent("jump", "risc2", 0.5, start_s=4.0)),
        ("jump:risc2,mild", FaultEvent("jump", "risc2", 0.1)),
        ("jump:*,duration_s=2", FaultEvent("jump", "*", duration_s=2.0)),
        ("drop:severity=0.1,duration_s=2@4", FaultEvent("drop", "", 0.1, 2.0, 4.0)),
        ("drop:0.3,channel=risc1/*", FaultEvent("drop", severity=0.3, channel="risc1/*")),
        ("drop:0.3,duration_s=inf", FaultEvent("drop", severity=0.3)),
        ("node_kill:states_estimation@5", FaultEvent("node_kill", program="states_estimation", start_s=5.0)),
        ("node_stop:driver,risc2,0.3", FaultEvent("node_stop", "risc2", duration_s=0.3, program="driver")),
        ("node_stop:program=controller,inf", FaultEvent("node_stop", duration_s=np.inf, program="controller")),
    ],
)
def test_a_fault_is_read_from_the_command_line_and_written_as_there(text, event):
    assert parse_fault(text) == event
    assert parse_fault(str(event)) == event


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "fault '' .* NAME"),
        (":0.3", ":0.3.* NAME"),
        ("fire:1", "'fire' .*faults"),
        ("jump:much!", "'much!' .*number.* NAME"),
        ("jump:0.3s", "'0.3s' .*number"),
        ("jump:9", r"severity .*\[0, 5\], found 9"),
        ("jump:0.3,0.4", "'severity' .*twice"),
        ("jump:risc1,risc2", "'vehicle' .*twice"),
        ("jump:0.3,height=2", "'height'; .* severity, duration_s, vehicle, channel, program"),
        ("jump:program=controller", "no program.* 'controller' "),
        ("node_kill", "node_kill: which program"),
        ("node_stop:3", "node_stop: which program"),
        ("node_kill:controller,risc1,risc2", "'vehicle' .*twice"),
        ("node_kill:controller,3", r"duration_s .*\[0, 0\], found 3"),
        ("jump:duration_s=-1", "duration_s"),
        ("jump@soon", "'soon' .*number"),
        ("jump@", "'' .*number"),
        ("jump@nan", "'start_s' .*finite"),
    ],
)
def test_a_fault_that_is_misspelt_is_refused(text, message):
    with pytest.raises(ValueError, match=message):
        parse_fault(text)


def test_unknown_channels_are_refused_by_name():
    wires = Wires()
    wires.wire("risc1/navdata")
    with pytest.raises(ValueError, match="'risc1/nav'; .* risc1/navdata"):
        wires.add(FaultEvent("drop", channel="risc1/nav", severity=0.1))


def test_a_file_of_faults(tmp_path):
    path = tmp_path / "faults.yaml"
    path.write_text(
        "faults:\n- {fault: drop, channel: risc1/*, severity: 0.3, start_s: 10, duration_s: 5}\n"
        "- {fault: blackhole, channel: cortex/stream}\n"
    )
    assert load_faults(path) == (
        FaultEvent("drop", channel="risc1/*", severity=0.3, start_s=10.0, duration_s=5.0),
        FaultEvent("blackhole", channel="cortex/stream"),
    )
    assert load_fault_file(path).seed is None
    path.write_text("seed: 7\nfaults: [{fault: drop, channel: '*'}]\n")
    assert load_fault_file(path) == FaultFile((FaultEvent("drop", channel="*"),), 7)
    for content, named in (
        ("faults: [{fault: drop, channel: '*', strength: 1}]", "strength"),
        ("{faults: [], seed: -1}", "seed"),
        ("{faults: [], seed: 1.5}", "seed"),
        ("seed: 7", "'faults'"),
    ):
        path.write_text(content)
        with pytest.raises(ValueError, match=named):
            load_faults(path)


def test_a_clean_wire_hands_over_what_it_gets():
    wires, packet = Wires(), bytearray(b"frame")
    assert wires.wire("cortex/stream").carry(packet, None, 0.0, lambda data, *_: data) is packet
    assert wires.statistics() == {}


def test_a_fault_sees_nothing_before_and_after_its_window():
    wires, arrived = Wires(), []
    wire = wires.wire("risc1/navdata")
    wires.add(FaultEvent("drop", severity=1.0, start_s=1.0, duration_s=1.0, channel="*"))
    for now_s in (0.0, 0.99, 1.0, 1.99, 2.0):
        wire.carry(b"", None, now_s, lambda data, _, at_s: arrived.append(at_s))
    assert arrived == [0.0, 0.99, 2.0]
    assert wires.statistics() == {"risc1/navdata": {"sent": 2, "delivered": 0, "later": 0}}


@pytest.mark.parametrize("text, together", [("burst:0.1", True), ("intermittent:0.5", True), ("loss:0.5", False)])
def test_a_network_that_is_silent_is_so_on_all_channels_at_once(text, together):
    """Otherwise requests and replies would pass while the stream is silent."""
    wires, passed = Wires(seed=1), {"cortex/stream": [], "cortex/replies": []}
    for channel in passed:
        wires.wire(channel)
    wires.add(parse_fault(text))
    for k in range(400):
        for channel, times in passed.items():
            wires.wire(channel).carry(b"", None, 0.01 * k, lambda *_, times=times, k=k: times.append(k))
    stream, replies = passed.values()
    assert 50 < len(stream) < 380 and (stream == replies) is together


# --- streams


class Connection:
    """One end of a stream."""

    def __init__(self):
        self.got, self.times_s, self.is_cut = [], [], False


class Stream:
    """A stream with connections, in simulated time."""

    def __init__(self, *faults, seed=1):
        self.wires, self.now_s = Wires(seed), 0.0
        self.stream = self.wires.stream("risc1/control")
        for fault in faults:
            self.wires.add(fault)

    def write(self, connection, data):
        self.stream.carry(data, connection, self.now_s, self._deliver, self._cut)

    def wait(self, until_s):
        while self.wires.due_s <= until_s:
            self.wires.release(self.wires.due_s if self.wires.due_s > 0.0 else self.now_s)
        self.now_s = until_s

    def _deliver(self, data, connection, now_s):
        connection.got.append(data)
        connection.times_s.append(now_s)

    def _cut(self, connection):
        connection.is_cut = True


@pytest.mark.parametrize(
    "fault", [FaultEvent("delay", channel="*", severity=0.05), FaultEvent("jitter", channel="*", severity=0.5)]
)
def test_bytes_of_a_stream_come_later_and_in_order(fault):
    stream, one, other = Stream(fault), Connection(), Connection()
    for k in range(200):
        stream.wait(0.01 * k)
        stream.write(one, b"%d" % k)
        stream.write(other, b"%d" % k)
    stream.wait(10.0)
    for connection in (one, other):
        assert connection.got == [b"%d" % k for k in range(200)]
        later_s = np.array(connection.times_s) - 0.01 * np.arange(200)
        assert later_s.min() >= 0.0 and later_s.max() == pytest.approx(fault.severity, rel=0.05)
    assert one.times_s != other.times_s or fault.fault == "delay"


def test_order_holds_when_the_fault_ends_while_bytes_are_on_their_way():
    stream, one = Stream(FaultEvent("delay", channel="*", severity=0.1, start_s=0.0, duration_s=0.5)), Connection()
    for k in range(100):
        stream.wait(0.01 * k)
        stream.write(one, bytes([k]))
    stream.wait(2.0)
    assert b"".join(one.got) == bytes(range(100)) and one.times_s[-1] == pytest.approx(0.99)


def test_a_blackhole_holds_a_stream_up_and_loses_nothing():
    stream, one = Stream(FaultEvent("blackhole", channel="*", severity=1.0, start_s=0.2, duration_s=0.3)), Connection()
    for k in range(100):
        stream.wait(0.01 * k)
        stream.write(one, bytes([k]))
    assert b"".join(one.got) == bytes(range(100))
    held = np.array(one.times_s[20:50])
    assert held == pytest.approx(0.5) and one.times_s[19] == pytest.approx(0.19)


def test_clear_lets_go_what_a_blackhole_without_end_holds():
    stream, one = Stream(FaultEvent("blackhole", channel="*")), Connection()
    stream.write(one, b"a")
    stream.write(one, b"b")
    stream.wait(5.0)
    assert one.got == []
    stream.wires.clear("risc1/*")
    stream.write(one, b"c")
    stream.wait(5.1)
    assert one.got == [b"a", b"b", b"c"]


def test_of_a_connection_no_more_is_held_than_its_buffers_take():
    stream, one, other = Stream(FaultEvent("blackhole", channel="*", duration_s=1.0)), Connection(), Connection()
    stream.write(other, b"a")
    written = 0
    while not stream.stream.is_full(one):
        stream.write(one, (bytes(1000), True))
        written += 1
    assert written == math.ceil(MAX_HELD_BYTES / 1000) and not stream.stream.is_full(other)
    stream.wait(1.0)
    assert len(one.got) == written and other.got == [b"a"] and not stream.stream.is_full(one)


def test_what_a_closed_connection_had_to_get_is_forgotten():
    stream, one, other = Stream(FaultEvent("blackhole", channel="*")), Connection(), Connection()
    stream.write(one, b"a")
    stream.write(other, b"b")
    stream.stream.forget(one)
    assert len(stream.stream.held) == 1
    stream.wires.clear()
    stream.wait(1.0)
    assert (one.got, other.got) == ([], [b"b"])


def test_cut_ends_one_connection():
    stream, one, other = (
        Stream(FaultEvent("cut", channel="*", severity=1.0, start_s=0.5, duration_s=0.5)),
        Connection(),
        Connection(),
    )
    stream.write(one, b"a")
    stream.wait(0.6)
    stream.write(one, b"b")
    stream.wait(2.0)
    stream.write(other, b"c")
    assert (one.got, one.is_cut, other.got, other.is_cut) == ([b"a"], True, [b"c"], False)
    assert stream.wires.statistics() == {"risc1/control": {"sent": 1, "cut": 1}}


def test_a_fault_acts_where_it_makes_sense():
    """TCP cannot lose, repeat or damage data. A fault given for both kinds acts only on the channels that allow it."""
    wires = Wires()
    datagrams, stream = wires.wire("risc1/navdata"), wires.stream("risc1/video")
    for fault in ("drop", "duplicate", "reorder", "corrupt", "truncate", "wrong_reply"):
        with pytest.raises(ValueError, match="%s .* datagrams; risc1/video: streams" % fault):
            wires.add(FaultEvent(fault, channel="risc1/video", severity=0.5))
        wires.add(FaultEvent(fault, channel="risc1/*", severity=0.5))
    with pytest.raises(ValueError, match="cut .* streams; risc1/navdata: datagrams"):
        wires.add(FaultEvent("cut", channel="risc1/navdata"))
    wires.add(FaultEvent("cut", channel="risc1/*"))
    wires.add(FaultEvent("blackhole", channel="risc1/*"))
    assert (len(datagrams.acting), len(stream.acting)) == (7, 2)
