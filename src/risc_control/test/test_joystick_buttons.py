"""risc_control.ros.joystick_buttons without a master: what a slow callback must not change."""

import threading
from dataclasses import dataclass
from types import SimpleNamespace

import pytest
import rospy
from sensor_msgs.msg import Joy

from risc_control.ros import joystick_buttons
from risc_control.ros.joystick_buttons import ButtonParams, ButtonSubscriber, claim_buttons

TIMEOUT_S = 30.0


@dataclass(frozen=True)
class Buttons(ButtonParams):
    previous_button: int = 4
    next_button: int = 5


@pytest.fixture
def desk(monkeypatch):
    """The parts of ROS that the subscriber needs: its callback, a clock that the test sets, logged texts."""

    class Desk:
        now_s = 1000.0
        logged = []

        def send(self, *down, sender="/joy_node", age_s=0.0):
            """A message that arrives now."""
            message = Joy(buttons=[int(k in down) for k in range(8)])
            message.header.stamp = rospy.Time.from_sec(self.now_s - age_s)
            self.sender = sender
            self.receive(message)

    found = Desk()
    found.logged = []
    monkeypatch.setattr(joystick_buttons, "claim_buttons", lambda functions: None)
    monkeypatch.setattr(rospy, "Subscriber", lambda topic, kind, callback, **_: setattr(found, "receive", callback))
    monkeypatch.setattr(joystick_buttons, "ros_time_s", lambda: found.now_s)
    monkeypatch.setattr(joystick_buttons, "sender", lambda message: found.sender)
    monkeypatch.setattr(rospy, "logwarn", lambda text, *values: found.logged.append(text % values))
    monkeypatch.setattr(rospy, "logerr", lambda text: found.logged.append(text))
    return found


def test_a_press_counts_while_the_callback_is_busy_with_the_one_before(desk):
    seen, busy, done, both = [], threading.Event(), threading.Event(), threading.Event()

    def callback(buttons):
        seen.append(buttons)
        busy.set()
        assert done.wait(TIMEOUT_S)
        if len(seen) == 2:
            both.set()

    ButtonSubscriber(Buttons(), callback)
    desk.send(5)
    assert busy.wait(TIMEOUT_S)
    desk.send()
    desk.send(4, 5)  # returns while the callback is still busy: no message waits in the socket
    done.set()
    assert both.wait(TIMEOUT_S)
    assert seen == [{5}, {4, 5}]
    assert desk.logged == []


def test_a_callback_that_fails_is_told_and_the_next_press_counts(desk):
    worked = threading.Event()

    def callback(buttons):
        if 4 in buttons:
            raise RuntimeError("no such course")
        worked.set()

    ButtonSubscriber(Buttons(), callback)
    desk.send(4)
    desk.send(5)
    assert worked.wait(TIMEOUT_S)
    assert len(desk.logged) == 1
    assert "RuntimeError: no such course" in desk.logged[0]


def test_a_late_press_is_told_with_its_age_and_not_obeyed(desk):
    seen, worked = [], threading.Event()

    def callback(buttons):
        seen.append(buttons)
        worked.set()

    ButtonSubscriber(Buttons(), callback)
    desk.send(4, age_s=2.0)
    desk.send(5)
    assert worked.wait(TIMEOUT_S)
    assert seen == [{5}]
    assert len(desk.logged) == 1
    assert "2.0 s ago" in desk.logged[0]


@pytest.fixture
def server(monkeypatch):
    """A parameter server, and the names of the nodes that run."""
    found = SimpleNamespace(params={}, nodes={"/controller"}, own="/controller")
    monkeypatch.setattr(rospy, "get_name", lambda: found.own)
    monkeypatch.setattr(rospy, "resolve_name", lambda topic: topic if topic[0] == "/" else "/" + topic)
    monkeypatch.setattr(rospy, "set_param", lambda name, value: found.params.__setitem__(name, value))
    monkeypatch.setattr(rospy, "delete_param", found.params.pop)
    monkeypatch.setattr(rospy, "get_param", lambda name, default: dict(found.params))
    monkeypatch.setattr(joystick_buttons, "_runs", lambda node: node in found.nodes)
    return found


def test_no_button_is_taken_for_two_things(server):
    claim_buttons({"next_button": 5, "previous_button": 4}, ["/risc1/joy"])
    server.own = "/joystick_controller"
    for topics, button in ((["/risc2/joy", "/risc1/joy"], 6), (["/risc2/joy"], 5)):
        claim_buttons({"JoytoWay": button, "Up": 9}, topics)
    with pytest.raises(ValueError, match="5.*/risc1/joy.*JoytoWay.*next_button.*/controller"):
        claim_buttons({"JoytoWay": 5}, ["/risc2/joy", "/risc1/joy"])
    assert [claim["node"] for claim in server.params.values()] == ["/controller"], "who is refused has none"
    server.nodes.clear()
    claim_buttons({"JoytoWay": 5}, ["/risc1/joy"])


def test_two_nodes_may_take_a_button_for_the_same_thing(server):
    """A vehicle node that replaces another one, or one for each of two vehicles with one joystick."""
    for server.own in ("/risc1/joystick_controller", "/risc2/joystick_controller"):
        server.nodes.add(server.own)
        claim_buttons({"JoytoWay": 0}, ["/joy"])
