"""The array messages against genpy's: the same bytes, the same numbers, for any names and sizes."""

import io

import numpy as np
import pytest

pytest.importorskip("rospy")

import genpy  # noqa: E402
from hypothesis import given, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402

from risc_lab.ros import fleet_messages  # noqa: E402
from risc_lab.ros.fleet_messages import (  # noqa: E402
    ControlsArrays,
    CortexArrays,
    LandmarksArrays,
    MocapArrays,
    TrajectoriesArrays,
)
from risc_msgs.msg import (  # noqa: E402
    Control,
    Controls,
    Cortex,
    Landmark,
    Landmarks,
    Mocap_data,
    Mocap_marker,
    Mocap_markers,
    States,
    Trajectories,
    Trajectory,
)

numbers = st.floats(width=64)  # infinities and NaN as well
names = st.text(st.characters(exclude_categories=("Cs",)), max_size=12)
stamps = st.builds(genpy.Time, st.integers(0, 2**32 - 1), st.integers(0, 10**9 - 1))


def rows_of(entry, count, *before):
    return st.lists(st.builds(lambda *row: entry(*row), names, *before, *[numbers] * count), max_size=8)


@st.composite
def with_header(draw, kind, entries):
    message = kind(Obj=draw(entries))
    message.header.seq = draw(st.integers(0, 2**32 - 1))
    message.header.stamp = draw(stamps)
    message.header.frame_id = draw(names)
    return message


markers = st.builds(Mocap_marker, numbers, numbers, numbers)
KINDS = {
    CortexArrays: with_header(Cortex, rows_of(States, 12, st.booleans())),
    TrajectoriesArrays: with_header(Trajectories, rows_of(Trajectory, 12)),
    ControlsArrays: with_header(Controls, rows_of(Control, 4)),
    LandmarksArrays: with_header(Landmarks, rows_of(Landmark, 3)),
    MocapArrays: with_header(
        Mocap_data, st.lists(st.builds(Mocap_markers, names, numbers, st.lists(markers, max_size=6)), max_size=6)
    ),
}


def wire(message):
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


@pytest.mark.parametrize("kind", KINDS)
def test_same_type_on_the_wire(kind):
    original = dict(zip(KINDS, (Cortex, Trajectories, Controls, Landmarks, Mocap_data)))[kind]
    for ours in (kind, kind.Raw):
        assert (ours._type, ours._md5sum, ours._full_text) == (original._type, original._md5sum, original._full_text)
    assert kind._has_header  # without it rospy does not set header.seq


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
def test_read_and_written_byte_for_byte_as_by_genpy(kind, data):
    original = data.draw(KINDS[kind])
    sent = wire(original)
    message = kind().deserialize(sent)
    assert wire(message) == sent
    header, theirs = message.header, original.header
    assert (header.seq, header.stamp.secs, header.stamp.nsecs) == (theirs.seq, theirs.stamp.secs, theirs.stamp.nsecs)
    assert header.frame_id == theirs.frame_id
    assert message.names == tuple(entry.name for entry in original.Obj)
    if kind is MocapArrays:
        rows = [(marker.x, marker.y, marker.z) for entry in original.Obj for marker in entry.marker]
        np.testing.assert_array_equal(message.markers_m, np.array(rows, dtype=float).reshape(-1, 3))
        np.testing.assert_array_equal(message.residuals, [entry.residual for entry in original.Obj])
        assert message.layout.entries == tuple((entry.name, len(entry.marker)) for entry in original.Obj)
        return
    skipped = 2 if kind is CortexArrays else 1
    table = np.array([[getattr(e, name) for name in e.__slots__[skipped:]] for e in original.Obj], dtype=float)
    if kind is TrajectoriesArrays:
        d = message.derivatives
        for k, e in enumerate(original.Obj):
            np.testing.assert_array_equal(d[k, 0], [e.x, e.y, e.z, e.psi])
            np.testing.assert_array_equal(d[k, 1], [e.xdot, e.ydot, e.zdot, e.psidot])
            np.testing.assert_array_equal(d[k, 2], [e.xddot, e.yddot, e.zddot, e.psiddot])
        return
    attribute = {CortexArrays: "states", ControlsArrays: "controls", LandmarksArrays: "positions_m"}[kind]
    np.testing.assert_array_equal(getattr(message, attribute), table.reshape(getattr(message, attribute).shape))
    if kind is CortexArrays:
        assert message.visible.tolist() == [entry.visible for entry in original.Obj]


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
def test_bytes_that_are_no_message_are_refused_or_read_as_genpy_reads_them(kind, data):
    sent = wire(data.draw(KINDS[kind]))
    end = data.draw(st.integers(0, len(sent)))
    torn = bytearray(sent[:end])
    for _ in range(data.draw(st.integers(0, 3))):
        if torn:
            torn[data.draw(st.integers(0, len(torn) - 1))] = data.draw(st.integers(0, 255))
    try:
        message = kind().deserialize(bytes(torn))
    except genpy.DeserializationError:
        return
    assert message.data.size == message.layout.size
    message.header.frame_id = ""  # bytes that are not text are replaced by longer ones
    assert len(wire(message)) <= len(torn)


def test_the_bytes_alone_are_read_when_somebody_wants_them():
    sent = wire(Cortex(Obj=[States("a", True, *[1.0] * 12)]))
    raw = CortexArrays.Raw().deserialize(sent)
    assert raw.buff == sent
    own = CortexArrays()
    states = own.deserialize(raw.buff).states
    own.deserialize(wire(Cortex(Obj=[States("a", True, *[2.0] * 12)])))
    assert states.tolist() == [[2.0] * 12], "one's own arrays are written again"


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
@settings(max_examples=50)
def test_names_that_are_no_text_are_read_as_by_genpy_and_written_as_they_came(kind, data):
    """E.g. names from a mocap host that sends Latin-1."""
    original = data.draw(KINDS[kind])
    for k, entry in enumerate(original.Obj):
        entry.name = "B?sch %d" % k
    original.header.frame_id = "cortex"
    sent = wire(original).replace(b"B?sch", b"B\xf6sch")
    message = kind().deserialize(sent)
    assert wire(message) == sent
    assert message.names == tuple(entry.name for entry in type(original)().deserialize(sent).Obj)


def test_names_that_change_and_come_back():
    one, two = [Cortex(Obj=[States(name, True, *[k] * 12) for k, name in enumerate(them)]) for them in ("abc", "bcd")]
    for original in (one, two, one, two, two, one):
        message = CortexArrays().deserialize(wire(original))
        assert message.names == tuple(entry.name for entry in original.Obj)
        assert message.states[:, 11].tolist() == [0.0, 1.0, 2.0]


def test_a_flood_of_names_is_not_kept():
    for k in range(5 * fleet_messages._MOST_LAYOUTS):
        ControlsArrays(("vehicle%d" % k,))
    assert ControlsArrays._layout_of.cache_info().currsize <= fleet_messages._MOST_LAYOUTS


def test_a_message_that_was_read_keeps_its_numbers_when_the_next_one_comes():
    first = CortexArrays().deserialize(wire(Cortex(Obj=[States("a", True, *[1.0] * 12)])))
    CortexArrays().deserialize(wire(Cortex(Obj=[States("a", False, *[2.0] * 12)])))
    assert first.visible.tolist() == [True]
    assert first.states.tolist() == [[1.0] * 12]


def test_a_message_is_filled_again_and_again():
    message = TrajectoriesArrays(["a", "b"])
    message.header.frame_id = "cortex"
    for k in range(3):
        message.derivatives[:] = k
        theirs = Trajectories().deserialize(wire(message))
        assert [entry.zddot for entry in theirs.Obj] == [k, k]
        assert [entry.name for entry in theirs.Obj] == ["a", "b"]
