"""Messages <-> values: every field, every unit, both ways."""

import io

import numpy as np
import pytest

pytest.importorskip("risc_msgs")

import genpy  # noqa: E402
from mocap_frames import mocap_message  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from risc_estimation.ros import conversions  # noqa: E402
from risc_estimation.state_estimator import FrameEstimate  # noqa: E402
from risc_msgs.msg import Cortex, Landmarks, Mocap_data  # noqa: E402


def over_the_wire(message, kind):
    """What a subscriber of the ordinary message gets."""
    wire = io.BytesIO()
    message.serialize(wire)
    return kind().deserialize(wire.getvalue())


def estimate():
    states = np.array([[1, 2, 3, 4, 5, 6, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6], np.arange(12) - 5.0])
    return FrameEstimate(
        12.5, ("Raven", "fluffy_II"), np.array([True, False]), states, ("Green_pink",), np.array([[7.0, 8.0, 9.0]])
    )


def test_markers_leave_body_by_body():
    layout = (("Raven", 3), ("empty", 0), ("albatross", 2), ("Raven", 1))
    markers_m = np.arange(18.0).reshape(6, 3)
    markers_m[1], markers_m[2, 2] = np.nan, 9999.999
    message = over_the_wire(mocap_message(Header(), layout, markers_m), Mocap_data)
    assert tuple((body.name, len(body.marker)) for body in message.Obj) == layout
    back = [(marker.x, marker.y, marker.z) for body in message.Obj for marker in body.marker]
    np.testing.assert_array_equal(back, markers_m)


def test_states_leave_in_degrees_field_by_field():
    messages = conversions.EstimateMessages()
    for _ in range(2):  # the message is filled again
        msg = over_the_wire(messages.states(Header(frame_id="cortex"), estimate()), Cortex)
        first = msg.Obj[0]
        assert (first.name, first.visible, msg.Obj[1].visible) == ("Raven", True, False)
        assert (first.x, first.y, first.z, first.u, first.v, first.w) == (1, 2, 3, 4, 5, 6)
        assert [first.phi, first.theta, first.psi, first.p, first.q, first.r] == pytest.approx(
            [5.729578, 11.459156, 17.188734, 22.918312, 28.647890, 34.377468], abs=1e-5
        )


def test_a_vehicle_more():
    messages = conversions.EstimateMessages()
    messages.states(Header(), estimate())
    more = estimate()._replace(names=("a", "b", "c"), visible=np.ones(3, bool), states=np.ones((3, 12)))
    msg = over_the_wire(messages.states(Header(), more), Cortex)
    assert [entry.name for entry in msg.Obj] == ["a", "b", "c"]


def test_landmarks():
    messages = conversions.EstimateMessages()
    msg = over_the_wire(messages.landmarks(Header(), estimate()), Landmarks)
    assert [(entry.name, entry.x, entry.y, entry.z) for entry in msg.Obj] == [("Green_pink", 7.0, 8.0, 9.0)]
    none = estimate()._replace(landmark_names=(), landmarks_m=np.zeros((0, 3)))
    assert over_the_wire(messages.landmarks(Header(), none), Landmarks).Obj == []


@pytest.mark.parametrize("frame_id,expected", [("/cortex", "cortex"), ("cortex", "cortex"), ("", "cortex")])
def test_header_keeps_the_stamp_and_loses_the_slash(frame_id, expected):
    header = conversions.header_for(Header(seq=9, stamp=genpy.Time(12, 34), frame_id=frame_id))
    assert (header.stamp, header.frame_id) == (genpy.Time(12, 34), expected)
    derived = conversions.EstimateMessages().states(Header(stamp=genpy.Time(12, 34), frame_id=frame_id), estimate())
    assert (derived.header.stamp, derived.header.frame_id) == (genpy.Time(12, 34), expected)
