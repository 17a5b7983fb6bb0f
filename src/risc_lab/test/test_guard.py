"""Callbacks that fail: what is logged, who is notified, and that the next message is handled."""

import functools
import re
from types import SimpleNamespace

import pytest

rospy = pytest.importorskip("rospy")

import genpy  # noqa: E402  (needs ROS)
from std_msgs.msg import Bool  # noqa: E402

from risc_lab.ros import guard, paced_subscriber  # noqa: E402
from risc_lab.ros.guard import guarded, subscribe  # noqa: E402


@pytest.fixture
def desk(monkeypatch):
    """A clock set by the test, the logged texts, and whether ROS is shutting down."""
    found = SimpleNamespace(now_s=100.0, errors=[], warnings=[], closing=False)
    monkeypatch.setattr(guard, "time", SimpleNamespace(monotonic=lambda: found.now_s))
    monkeypatch.setattr(guard, "is_closing", lambda: found.closing)
    monkeypatch.setattr(rospy, "logerr", found.errors.append)
    monkeypatch.setattr(rospy, "logwarn", found.warnings.append)
    return found


@pytest.fixture
def callbacks(monkeypatch):
    """{topic: callback} of the subscriptions."""
    found = {}

    def subscriber(topic, kind, callback, callback_args=None, tcp_nodelay=False, **options):
        assert tcp_nodelay
        found[topic] = callback if callback_args is None else lambda message: callback(message, callback_args)

    monkeypatch.setattr(rospy, "Subscriber", subscriber)
    return found


def failing(_message, error=KeyError, text="of the test"):
    raise error(text)


def test_what_fails_with_every_message_is_logged_once_with_its_traceback_and_then_counted(desk):
    run = guarded(failing, "the test")
    for _ in range(1281):
        run("message")
        desk.now_s += 2.0**-7  # which adds up to 10 s exactly
    first, again = desk.errors
    assert re.match(r"the test .*\(KeyError: 'of the test'\)\nTraceback", first)
    assert "in failing" in first
    assert re.match("the test .* 1280 .*KeyError", again)


def test_another_error_has_a_traceback_of_its_own(desk):
    run = guarded(lambda message: failing(message, message), "the test")
    for error in (KeyError, ValueError):
        run(error)
        desk.now_s += 11.0
    assert ["Traceback" in text for text in desk.errors] == [True, True]


def test_two_that_fail_do_not_hide_each_other(desk):
    for name in ("one", "two"):
        guarded(failing, name)("message")
    assert [text.split()[0] for text in desk.errors] == ["one", "two"]


def test_who_is_to_act_is_told_of_each_error_and_the_result_arrives(desk):
    errors = []
    run = guarded(failing, "the test", errors.append)
    assert run("message") is None and run("message") is None
    assert [type(error) for error in errors] == [KeyError] * 2
    assert guarded(lambda a, b: a + b, "the test", errors.append)(1, 2) == 3


def test_while_ros_shuts_down_nothing_is_told(desk):
    desk.closing, errors = True, []
    guarded(failing, "the test", errors.append)("message")
    assert desk.errors == errors == []


def test_a_message_that_cannot_be_decoded_is_a_warning_and_nobody_has_to_act(desk):
    errors = []
    run = guarded(functools.partial(failing, error=genpy.DeserializationError), "the test", errors.append)
    run("message")
    assert desk.errors == errors == []
    assert len(desk.warnings) == 1 and "of the test" in desk.warnings[0]


def test_callbacks_of_subscriptions_are_guarded(desk, callbacks):
    errors, taken = [], []
    subscribe("/one", Bool, failing, on_error=errors.append, queue_size=1)
    subscribe("/two", Bool, lambda *parts: taken.append(parts), 7, queue_size=1)
    paced = paced_subscriber.PacedSubscriber("/three", Bool, failing, 1000.0, on_error=errors.append)
    for topic in ("/one", "/two", "/three"):
        callbacks[topic]("message")
    assert len(errors) == 2 and taken == [("message", 7)]
    assert ["/one" in desk.errors[0], "/three" in desk.errors[1]] == [True, True]
    paced._over.set()
