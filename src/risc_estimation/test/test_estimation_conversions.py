"""Messages <-> values: every field, every unit, both ways."""

import io

import numpy as np
import pytest

pytest.importorskip("risc_msgs")

import genpy  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from risc_estimation.ros import conversions  # noqa: E402
from risc_estimation.states import FrameEstimate  # noqa: E402
from risc_msgs.msg import Cortex, Mocap_data, Mocap_markers  # noqa: E402


def over_the_wire(msg):
    wire = io.BytesIO()
    msg.serialize(wire)
    return type(msg)().deserialize(wire.getvalue())


def estimate():
    states = np.array([[1, 2, 3, 4, 5, 6, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6], np.arange(12) - 5.0])
    return FrameEstimate(
        12.5, ("Raven", "fluffy_II"), np.array([True, False]), states, ("Green_pink",), np.array([[7.0, 8.0, 9.0]])
    )


def test_markers_round_trip():
    layout = (("Raven", 3), ("empty", 0), ("albatross", 2), ("Raven", 1))
    markers_m = np.arange(18.0).reshape(6, 3)
    markers_m[1], markers_m[2, 2] = np.nan, 9999.999
    back = conversions.markers_from_msg(over_the_wire(conversions.markers_to_msg(Header(), layout, markers_m)))
    assert back[0] == layout
    np.testing.assert_array_equal(back[1], markers_m)


@pytest.mark.parametrize("msg", [Mocap_data(), Mocap_data(Obj=[Mocap_markers(name="empty")])])
def test_empty_frames(msg):
    layout, markers_m = conversions.markers_from_msg(msg)
    assert layout == tuple(("empty", 0) for _ in msg.Obj)
    assert (markers_m.shape, markers_m.dtype) == ((0, 3), float)


def test_states_leave_in_degrees_field_by_field():
    msg = over_the_wire(conversions.cortex_from_estimate(Header(frame_id="cortex"), estimate()))
    first = msg.Obj[0]
    assert (first.name, first.visible, msg.Obj[1].visible) == ("Raven", True, False)
    assert (first.x, first.y, first.z, first.u, first.v, first.w) == (1, 2, 3, 4, 5, 6)
    assert [first.phi, first.theta, first.psi, first.p, first.q, first.r] == pytest.approx(
        [5.729578, 11.459156, 17.188734, 22.918312, 28.647890, 34.377468], abs=1e-5
    )


def test_states_round_trip():
    back = conversions.states_from_cortex(over_the_wire(conversions.cortex_from_estimate(Header(), estimate())))
    for row, name in enumerate(estimate().names):
        assert back[name][0] == estimate().visible[row]
        assert back[name][1] == pytest.approx(estimate().states[row], abs=1e-12)
    assert conversions.states_from_cortex(Cortex()) == {}


def test_landmarks():
    msg = over_the_wire(conversions.landmarks_from_estimate(Header(), estimate()))
    assert [(entry.name, entry.x, entry.y, entry.z) for entry in msg.Obj] == [("Green_pink", 7.0, 8.0, 9.0)]


@pytest.mark.parametrize("frame_id,expected", [("/cortex", "cortex"), ("cortex", "cortex"), ("", "cortex")])
def test_header_keeps_the_stamp_and_loses_the_slash(frame_id, expected):
    header = conversions.header_for(Header(seq=9, stamp=genpy.Time(12, 34), frame_id=frame_id))
    assert (header.stamp, header.frame_id) == (genpy.Time(12, 34), expected)
