"""`StatesReader`: /cortex_raw as arrays, also after truncated messages."""

import io

import pytest

pytest.importorskip("rospy")

import genpy  # noqa: E402

from risc_control.ros.conversions import StatesReader  # noqa: E402
from risc_msgs.msg import Cortex, States  # noqa: E402


def wire(message):
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def test_a_message_that_is_refused_leaves_the_states_after_it_as_they_come():
    reader = StatesReader(["a"])
    whole = [wire(Cortex(Obj=[States("a", True, *[float(k)] * 12)])) for k in range(3)]
    other = wire(Cortex(Obj=[States("a", True, *[7.0] * 12), States("b", True, *[8.0] * 12)]))
    assert reader.read(whole[0])[1].x[0, 0] == 0.0
    for torn in (whole[1][:-1], other[:-1], other[:20], b""):
        with pytest.raises(genpy.DeserializationError):
            reader.read(torn)
        assert reader.read(whole[2])[1].x[0, 0] == 2.0
        assert reader.read(whole[1])[1].x[0, 0] == 1.0
    assert reader.read(other.replace(b"b", b"\xe4"))[1].x[0, 0] == 7.0
    assert reader.read(whole[2])[1].x[0, 0] == 2.0
    assert reader.unknown == []


def test_what_vehicles_carry_is_in_their_rows():
    reader = StatesReader(["a", "b", "c"], ["ball", None, "tip"])
    bodies = [States(name, name != "b", *[float(k)] * 12) for k, name in enumerate(("tip", "c", "b", "ball", "a", "d"))]
    _, vehicles = reader.read(wire(Cortex(Obj=bodies)))
    assert vehicles.visible.tolist() == [True, False, True] and vehicles.x[:, 0].tolist() == [4.0, 0.0, 1.0]
    assert reader.bodies.visible.tolist() == [True, False, True]
    assert reader.bodies.position_m[:, 2].tolist() == [3.0, 0.0, 0.0]
    assert reader.unknown == ["d"], "they are known"
    former = reader.bodies
    reader.read(wire(Cortex(Obj=bodies[:3])))
    assert reader.bodies.visible.tolist() == [False, False, True], "one that the message lacks"
    assert former.visible.tolist() == [True, False, True], "a controller may keep them"


def test_vehicles_that_carry_nothing_have_no_bodies():
    reader = StatesReader(["a", "b"], [None, None])
    _, vehicles = reader.read(wire(Cortex(Obj=[States("b", True, *[1.0] * 12)])))
    assert reader.bodies is None and vehicles.visible.tolist() == [False, True]
    assert vehicles.x.base is None, "nor rows for them"
