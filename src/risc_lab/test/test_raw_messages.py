"""Messages that are received as bytes, as rospy makes them of what a connection has read."""

import io

import pytest

rospy = pytest.importorskip("rospy")

import roslib.message  # noqa: E402
from rospy.msg import deserialize_messages, serialize_message  # noqa: E402
from std_msgs.msg import UInt32  # noqa: E402

from risc_lab.ros.raw_messages import raw_class  # noqa: E402

SENT = b"\1\2\3\4", b"\5\6\7\10"


@pytest.mark.parametrize("message_class", [UInt32, rospy.AnyMsg])
def test_rospy_takes_a_raw_class_for_the_class_and_does_not_look_into_its_messages(message_class):
    kind, wire, received = raw_class(message_class), io.BytesIO(), []
    for field in ("_type", "_md5sum", "_full_text", "_has_header"):
        assert getattr(kind, field) == getattr(message_class, field)
    for number, data in enumerate(SENT):
        serialize_message(wire, number, UInt32(int.from_bytes(data, "little")))
    deserialize_messages(wire, received, kind)
    assert tuple(message.raw for message in received) == SENT
    assert raw_class(message_class) is kind is not message_class
    assert roslib.message.get_message_class("std_msgs/UInt32") is UInt32, "others decode theirs"
