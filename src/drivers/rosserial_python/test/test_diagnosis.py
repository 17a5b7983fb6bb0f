"""Diagnosis of a line from what was observed on it."""

import errno
import math

import pytest

from risc_maap_msgs.msg import SerialLink
from rosserial_python.diagnosis import TEXTS, WARNINGS, Cause, cause_of
from rosserial_python.link import Facts, State

NOW_S = 1000.0


def facts(state, waits_s=None, heard_s=-math.inf, number=0, groovy=False, lost=(), damaged=()):
    seen = Facts(state, NOW_S - waits_s if waits_s is not None else None, number, groovy, heard_s)
    seen.lost_s.extend(NOW_S - ago_s for ago_s in lost)
    seen.damaged_s.extend(NOW_S - ago_s for ago_s in damaged)
    return seen


def test_states_and_causes_are_those_of_the_message():
    assert {cause.name: cause.value for cause in Cause} == {c.name: getattr(SerialLink, c.name) for c in Cause}
    assert {state.name: state.value for state in State} == {s.name: getattr(SerialLink, s.name) for s in State}
    assert set(TEXTS) == set(Cause) > WARNINGS
    assert all(TEXTS[cause] for cause in Cause if cause is not Cause.NONE)


@pytest.mark.parametrize(
    ("number", "cause"),
    [
        (errno.ENOENT, Cause.MISSING),
        (errno.EACCES, Cause.FORBIDDEN),
        (errno.EAGAIN, Cause.TAKEN),
        (errno.ECONNREFUSED, Cause.UNREACHABLE),
        (errno.EIO, Cause.PORT_FAILED),
    ],
)
def test_a_port_that_cannot_be_opened(number, cause):
    assert cause_of(facts(State.CLOSED), NOW_S, OSError(number, "text")) is cause
    assert cause_of(facts(State.CLOSED), NOW_S, TimeoutError("timed out")) is Cause.UNREACHABLE
    assert cause_of(facts(State.CLOSED), NOW_S) is Cause.NONE, "not tried yet"


@pytest.mark.parametrize(
    ("seen", "cause"),
    [
        (facts(State.WAITING, 0.5), Cause.NONE),
        (facts(State.WAITING, 2.0), Cause.SILENT),
        (facts(State.WAITING, 2.0, number=100), Cause.SPEED),
        (facts(State.WAITING, 2.0, number=3), Cause.SILENT),
        (facts(State.WAITING, 0.1, number=20, groovy=True), Cause.VERSION),
        (facts(State.WAITING, 0.0, heard_s=NOW_S - 0.3), Cause.STOPPED),
        (facts(State.UP, heard_s=NOW_S), Cause.NONE),
        (facts(State.UP, heard_s=NOW_S, lost=(5.0, 30.0)), Cause.NONE),
        (facts(State.UP, heard_s=NOW_S, lost=(5.0, 30.0, 50.0)), Cause.BREAKS),
        (facts(State.UP, heard_s=NOW_S, lost=(5.0, 30.0, 500.0)), Cause.NONE),
        (facts(State.UP, heard_s=NOW_S, damaged=(1.0, 2.0, 3.0)), Cause.DAMAGE),
        (facts(State.UP, heard_s=NOW_S, damaged=(100.0, 101.0, 102.0)), Cause.NONE),
    ],
)
def test_an_open_line(seen, cause):
    assert cause_of(seen, NOW_S) is cause


def test_refused_topics_and_messages():
    seen = facts(State.UP, heard_s=NOW_S)
    assert cause_of(seen, NOW_S, refused=("x",)) is Cause.TYPES
    assert cause_of(seen, NOW_S, oversized_s=NOW_S - 1.0) is Cause.SIZE
    assert cause_of(seen, NOW_S, oversized_s=NOW_S - 100.0) is Cause.NONE
