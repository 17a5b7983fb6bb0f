"""Callbacks that run while ROS shuts down."""

import pytest

rospy = pytest.importorskip("rospy")

from risc_lab.ros.until_shutdown import until_shutdown  # noqa: E402  (needs ROS)


def closed_topic(*_args):
    raise rospy.ROSException("publish() to a closed topic")


@pytest.fixture
def shut_down(monkeypatch):
    """Function that sets whether ROS is shutting down."""

    def set_to(value):
        monkeypatch.setattr(rospy.core, "is_shutdown_requested", lambda: value)

    return set_to


def test_a_topic_that_shutting_down_has_closed_is_no_error(shut_down):
    shut_down(True)
    until_shutdown(closed_topic)("message")


def test_it_is_an_error_before(shut_down):
    shut_down(False)
    with pytest.raises(rospy.ROSException, match="closed topic"):
        until_shutdown(closed_topic)("message")


def test_other_errors_pass_and_arguments_arrive(shut_down):
    shut_down(True)
    taken = []
    until_shutdown(lambda *args: taken.append(args))(1, 2)
    assert taken == [(1, 2)]
    with pytest.raises(ZeroDivisionError):
        until_shutdown(lambda: 1 / 0)()
