"""Messages <-> values: every field, every unit, both ways."""

import io

import numpy as np
import pytest

pytest.importorskip("risc_msgs")

import genpy  # noqa: E402
from mocap_frames import mocap_message  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from risc_estimation.filters import COUNTS, Status  # noqa: E402
from risc_estimation.given_poses import GivenPoses, PoseFrame  # noqa: E402
from risc_estimation.ros import conversions  # noqa: E402
from risc_estimation.state_estimator import FrameEstimate  # noqa: E402
from risc_maap_msgs.msg import BodyPoses, BodyStatus, BodyStatuses  # noqa: E402
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
    for _ in range(2):  # the message object is reused
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


def pose_frame():
    """PoseFrame of three bodies, the last of which was never seen."""
    quats_xyzw = np.array([[0.0, 0.0, np.sin(0.3), np.cos(0.3)], [0.5, 0.5, 0.5, 0.5], [0.0, 0.0, 0.0, 1.0]])
    covariances = np.arange(108.0).reshape(3, 6, 6)
    covariances[2] = np.nan
    return PoseFrame(
        ("Raven", "fluffy_II", "IRIS"), np.array([True, True, False]), np.array([True, False, False]),
        np.array([12.5, 12.25, -np.inf]), np.arange(9.0).reshape(3, 3), quats_xyzw, covariances, np.arange(3.0),
    )  # fmt: skip


def test_raw_poses_leave_field_by_field_and_come_back():
    frame, poses = pose_frame(), GivenPoses()
    for name in frame.names:
        poses.add(name, True)
    poses.take(12.5, frame)
    message = conversions.poses_to_msg(Header(stamp=genpy.Time(12, 500000000), frame_id="/cortex"), poses)
    sent = over_the_wire(message, BodyPoses)
    assert (sent.header.frame_id, sent.header.stamp) == ("cortex", genpy.Time(12, 500000000))
    assert [body.name for body in sent.bodies] == ["Raven", "fluffy_II", "IRIS"]
    assert [(body.present, body.inside) for body in sent.bodies] == [(True, True), (True, False), (False, False)]
    assert [body.stamp for body in sent.bodies] == [genpy.Time(12, 500000000), genpy.Time(12, 250000000), genpy.Time()]
    first = sent.bodies[1].pose.pose
    assert (first.position.x, first.position.y, first.position.z) == (3.0, 4.0, 5.0)
    assert [first.orientation.x, first.orientation.w] == pytest.approx([0.5, 0.5])
    assert (sent.bodies[1].pose.covariance[:3], sent.bodies[1].residual) == ((36.0, 37.0, 38.0), 1.0)

    back = conversions.poses_from_msg(over_the_wire(sent, conversions.BodyPosesArrays))
    assert back.names == frame.names
    for k in (0, 1):
        for name in ("present", "inside", "stamps_s", "positions_m", "covariances", "residuals_m"):
            np.testing.assert_array_equal(getattr(back, name)[k], getattr(frame, name)[k])
        np.testing.assert_allclose(back.quats_xyzw[k], frame.quats_xyzw[k], atol=1e-12)
    assert not back.present[2] and np.isnan(back.covariances[2]).all()


def test_nobodys_poses():
    message = conversions.poses_to_msg(Header(), GivenPoses())
    assert over_the_wire(message, BodyPoses).bodies == []
    assert conversions.poses_from_msg(over_the_wire(message, conversions.BodyPosesArrays)).names == ()


def test_statuses_have_the_constants_of_the_message():
    assert {status.name: status.value for status in Status} == {
        name: value for name, value in vars(BodyStatus).items() if name.isupper() and isinstance(value, int)
    }
    counters = np.array([(5, 4, 3, 2, 1)], dtype=COUNTS)
    message = conversions.statuses_to_msg(Header(), ("Raven",), [Status.SUSPECT], counters)
    (body,) = over_the_wire(message, BodyStatuses).bodies
    assert (body.name, body.status, body.counted) == ("Raven", BodyStatus.SUSPECT, True)
    assert [getattr(body, name) for name in COUNTS.names] == [5, 4, 3, 2, 1]
    message = conversions.statuses_to_msg(Header(), ("Raven",), [Status.LOST], None)
    (body,) = over_the_wire(message, BodyStatuses).bodies
    assert (body.status, body.counted, body.poses) == (BodyStatus.LOST, False, 0)


def test_variances_and_accelerations():
    state, covariance = np.arange(12.0), np.diag(np.arange(12.0) + 0.5)
    twist = conversions.position_cov_to_msg(Header(stamp=genpy.Time(3, 4)), state, covariance)
    assert (twist.header.stamp, twist.header.frame_id) == (genpy.Time(3, 4), "cortex")
    assert (twist.twist.linear.x, twist.twist.linear.y, twist.twist.linear.z) == (0.0, 1.0, 2.0)
    assert (twist.twist.angular.x, twist.twist.angular.y, twist.twist.angular.z) == (0.5, 1.5, 2.5)
    point = conversions.acceleration_to_msg(Header(), state, np.array([1.0, 2.0, 3.0])).point
    assert (point.x, point.y, point.z) == (1.0, 2.0, 3.0)
    assert conversions.acceleration_to_msg(Header(), state, np.array([1.0, np.nan, 3.0])) is None
