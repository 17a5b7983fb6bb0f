"""AT commands: golden texts, tolerance, sequence rules, and that nothing received ever raises."""

import json
import math
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ardrone_autonomy.protocol import at
from risc_simulator.vehicles.ardrone import wire
from risc_simulator.vehicles.ardrone.wire import SequenceGate, parse_datagram

GOLDEN = os.path.join(os.path.dirname(os.path.abspath(__file__)), "golden")

with open(os.path.join(GOLDEN, "at_commands.json")) as _file:
    COMMANDS = json.load(_file)


def same(actual, expected):
    return len(actual) == len(expected) and all(
        a == e if isinstance(e, str) else a == pytest.approx(e, abs=1e-7) for a, e in zip(actual, expected)
    )


@pytest.mark.parametrize("golden", COMMANDS, ids=[c["text"] for c in COMMANDS])
def test_golden_commands_both_ways(golden):
    sequence = int(golden["text"].split("=")[1].split(",")[0])
    assert at.encode(golden["name"], sequence, *golden["arguments"]) == golden["text"].encode() + b"\r"
    (command,), malformed = parse_datagram(golden["text"].encode() + b"\r")
    assert malformed == 0
    assert (command.name, command.sequence) == (golden["name"], sequence)
    assert same(command.arguments, golden["arguments"]), command


def test_all_of_them_in_one_datagram_with_any_line_end():
    for end in ("\r", "\n", "\r\n", "\r\0", " \r"):
        text = end.join(c["text"] for c in COMMANDS)  # the last one without any end
        commands, malformed = parse_datagram(text.encode())
        assert malformed == 0
        assert [c.name for c in commands] == [c["name"] for c in COMMANDS]


@pytest.mark.parametrize(
    "value, pattern",
    [
        (0.05, 1028443341),
        (0.2, 1045220557),
        (0.3, 1050253722),
        (-0.8, -1085485875),
        (1.0, 1065353216),
        (-1.0, -1082130432),
        (0.0, 0),
        (-0.0, 0),
    ],
)
def test_float_patterns(value, pattern):
    assert at.encode("LED", 1, 0, value, 1) == b"AT*LED=1,0,%d,1\r" % pattern
    assert at.int_to_float(pattern) == pytest.approx(value, abs=1e-7)


def test_minus_zero_and_unsigned_patterns_are_accepted():
    (command,), _ = parse_datagram(b"AT*PCMD=1,1,-2147483648,2147483648,3212836864,0\r")
    assert command.arguments == (1, 0.0, 0.0, -1.0, 0.0)
    assert math.copysign(1.0, command.arguments[1]) == 1.0


def test_named_encoders():
    assert at.ref(1) == b"AT*REF=1,290717696\r"
    assert at.ref(2, start=True) == b"AT*REF=2,290718208\r"
    assert at.ref(3, select=True) == b"AT*REF=3,290717952\r"
    assert at.pcmd_mag(4) == b"AT*PCMD_MAG=4,0,0,0,0,0,0,0\r"
    assert (
        at.pcmd_mag(5, at.PcmdFlag.PROGRESSIVE, pitch=-0.8, yaw=1.0)
        == b"AT*PCMD_MAG=5,1,0,-1085485875,0,1065353216,0,0\r"
    )


@pytest.mark.parametrize(
    "call",
    [
        lambda: at.encode("REF", 1),
        lambda: at.pcmd_mag(1, 1, roll=float("nan")),
        lambda: at.encode("LED", 1, 0, float("inf"), 1),
        lambda: at.encode("CONFIG", 1, 'a"b', "c"),
        lambda: at.encode("CONFIG", 1, "a:b", "c\r"),
        lambda: at.encode("CONFIG", 1, "a:b", "\u20ac"),
        lambda: at.encode("CONFIG", 1, "a:b", "x" * 1100),
        lambda: at.encode("LED", 1, 0, 1e39, 1),
    ],
)
def test_what_cannot_be_sent_is_refused(call):
    with pytest.raises(ValueError):
        call()


@pytest.mark.parametrize(
    "line",
    [
        b"AT*REF=1",
        b"AT*REF",
        b"AT*REF=,1",
        b"AT*REF=x,1",
        b"AT*=1,2",
        b"REF=1,2",
        b"AT*REF=-1,2",
        b'AT*REF=1,"2"',
        b"AT*PCMD=1,1,0,0,0",
        b"AT*PCMD=1,1,2143289344,0,0,0",
        b"AT*PCMD=1,1,4294967296,0,0,0",
        b"AT*CONFIG=1,a,b",
        b'AT*CONFIG=1,"a"',
        b'AT*CONFIG=1,"a","b',
        b"at*REF=1,2",
        b"AT*REF=1,99999999999999",
        b"AT*REF=1 2,3",
        b"AT*REF=1,2" + b"," * 1100,
        b"AT*REF=\xb2,1",
        b"AT*PCMD=1,1,2139095040,0,0,0",
    ],
)
def test_malformed_lines_are_counted_and_do_not_hide_their_neighbours(line):
    commands, malformed = parse_datagram(b"AT*FTRIM=1\r" + line + b"\rAT*COMWDG=2\r")
    assert malformed == 1
    assert [c.name for c in commands] == ["FTRIM", "COMWDG"]


@pytest.mark.parametrize(
    "line, name, arguments",
    [
        (b"AT*CTRL=1,5", "CTRL", (5, 0)),
        (b"AT*REF=1,512,", "REF", (512,)),
        (b"AT*REF=1,512,7,8", "REF", (512,)),
        (b"AT*COMWDG=1,", "COMWDG", ()),
        (b"AT*ZAP=1,0", "ZAP", (0,)),
        (b'AT*NEW=1,"x",-3', "NEW", ("x", -3)),
        (b'AT*CONFIG=1, "a:b", "c d"', "CONFIG", ("a:b", "c d")),
        (b'AT*CONFIG=1,"a:b",""', "CONFIG", ("a:b", "")),
    ],
)
def test_tolerance(line, name, arguments):
    (command,), malformed = parse_datagram(line + b"\r")
    assert malformed == 0
    assert (command.name, command.arguments) == (name, arguments)


def test_empty_datagrams_hold_nothing():
    for data in (b"", b"\r", b"\n\r\n", b"\0\0"):
        assert parse_datagram(data) == ([], 0)


@pytest.mark.parametrize("most_bytes", [wire.MAX_DATAGRAM_BYTES, 70_000])
def test_a_datagram_of_thousands_of_lines_is_not_looked_at(monkeypatch, most_bytes):
    """Parsing it would hold up the lab for a cycle or more. The control arm has no limit."""
    monkeypatch.setattr(wire, "MAX_DATAGRAM_BYTES", most_bytes)
    commands, malformed = parse_datagram(b"AT*COMWDG=1\r" * 4000)
    assert (len(commands), malformed) == ((0, 1) if most_bytes == 4096 else (4000, 0))


def test_sequence_rules():
    gate = SequenceGate()
    assert gate.accept(7)  # a first command may have any number
    assert [gate.accept(n) for n in (7, 6, 8, 8, 100, 9)] == [False, False, True, False, True, False]
    assert gate.accept(1) and gate.accept(2) and not gate.accept(2)  # 1 always resets
    assert gate.accept(50) and gate.accept(0) and gate.accept(1)  # and so does 0
    assert gate.accept(50) and not gate.accept(5)
    gate.reset()
    assert gate.accept(5)


@given(
    st.one_of(
        st.binary(max_size=200),
        st.text(alphabet='AT*REFPCMDON_IGS=,"0123456789- \r\n', max_size=120).map(lambda s: s.encode()),
        st.tuples(st.sampled_from(sorted(at.SIGNATURES)), st.text(max_size=60)).map(
            lambda t: ("AT*%s=%s" % t).encode("utf-8", "replace")
        ),
    )
)
def test_nothing_received_raises(data):
    commands, malformed = parse_datagram(data)
    assert malformed >= 0
    for command in commands:
        assert 0 <= command.sequence < 2**32
        for kind, value in zip(at.SIGNATURES.get(command.name, ""), command.arguments):
            assert isinstance(value, {"i": int, "f": float, "s": str}[kind])
            assert kind != "f" or math.isfinite(value)


_ARGUMENTS = {
    "i": st.integers(-(2**31), 2**31 - 1),
    "f": st.floats(width=32, allow_nan=False, allow_infinity=False),
    "s": st.text(alphabet=st.characters(min_codepoint=32, max_codepoint=126, exclude_characters='"'), max_size=40),
}


@given(st.data())
def test_round_trip(data):
    name = data.draw(st.sampled_from(sorted(at.SIGNATURES)))
    arguments = tuple(data.draw(_ARGUMENTS[kind]) for kind in at.SIGNATURES[name])
    sequence = data.draw(st.integers(0, 2**31))
    (command,), malformed = parse_datagram(at.encode(name, sequence, *arguments))
    assert malformed == 0
    assert command == (name, sequence, arguments)
