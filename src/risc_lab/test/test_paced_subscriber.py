"""risc_lab.ros.paced_subscriber on its own; the rostests of the nodes that use it test it on the wire."""

import gc

import pytest

rospy = pytest.importorskip("rospy")

from std_msgs.msg import Bool  # noqa: E402  (needs ROS)

from risc_lab.ros import paced_subscriber  # noqa: E402


def subscribe():
    return paced_subscriber.PacedSubscriber("/topic", Bool, lambda _message: None, 10.0)


def test_those_that_are_gone_leave_nothing_behind():
    subscribe().unregister()
    gc.collect()
    hooks, kept = len(rospy.core._client_shutdown_hooks), len(paced_subscriber._open)
    for _ in range(10):
        subscribe().unregister()
    gc.collect()
    assert (len(rospy.core._client_shutdown_hooks), len(paced_subscriber._open)) == (hooks, kept)


def test_the_end_of_ros_ends_all_that_are_open():
    both = [subscribe(), subscribe()]
    assert paced_subscriber._end_all in rospy.core._client_shutdown_hooks
    paced_subscriber._end_all()
    assert all(one._over.is_set() for one in both)
    for one in both:
        one.unregister()
