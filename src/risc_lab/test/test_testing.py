"""risc_lab.ros.testing.publishers_heard against a publisher that keeps its subscriber waiting."""

import socket
import struct

import pytest

rospy = pytest.importorskip("rospy")

from rospy.impl.tcpros_base import TCPROSTransport  # noqa: E402
from rospy.impl.tcpros_pubsub import TCPROSSub  # noqa: E402
from std_msgs.msg import Bool  # noqa: E402

from risc_lab.ros.testing import publishers_heard  # noqa: E402


def header(**fields):
    """As TCPROS puts it on the wire."""
    lines = [("%s=%s" % item).encode() for item in fields.items()]
    body = b"".join(struct.pack("<I", len(line)) + line for line in lines)
    return struct.pack("<I", len(body)) + body


def test_a_publisher_counts_when_its_header_has_come():
    subscriber = rospy.Subscriber("/heard", Bool, lambda _message: None)
    transport = TCPROSTransport(TCPROSSub("/heard", Bool), "/heard")
    here, there = socket.socketpair()
    try:
        subscriber.impl.add_connection(transport)
        transport.set_socket(here, "/lidar")
        assert subscriber.get_num_connections() == 1 and publishers_heard(subscriber) == set()
        there.sendall(header(callerid="/lidar", type=Bool._type, md5sum=Bool._md5sum))
        transport.read_header()
        assert publishers_heard(subscriber) == {"/lidar"}
    finally:
        there.close()
        transport.close()
        subscriber.unregister()
