"""Who listens to a picture node: told by rospy in the middle of its own work."""

import threading

import pytest

pytest.importorskip("rospy")

from risc_visual.vision.ros.picture_node import Demand  # noqa: E402  (needs ROS)

PATIENCE_S = 30.0


def test_rospy_never_waits_for_the_node_and_no_change_is_lost():
    """The lock stands for rospy's: it is held while rospy tells, and needed by the node that follows."""
    rospys_lock = threading.Lock()
    began, followed = threading.Event(), threading.Semaphore(0)

    def follow():
        began.set()
        with rospys_lock:
            followed.release()

    demand = Demand(follow)
    with rospys_lock:
        demand.peer_subscribe("/picture", None, None)
        assert began.wait(PATIENCE_S)
        demand.peer_unsubscribe("/picture", 0)  # while the node is busy with the first change
    assert followed.acquire(timeout=PATIENCE_S) and followed.acquire(timeout=PATIENCE_S)
