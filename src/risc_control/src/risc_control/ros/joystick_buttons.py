"""Joystick messages by sender and age, and the buttons that they press, for nodes that listen for a button or two."""

import queue
import socket
import threading
import time
import urllib.parse
from dataclasses import dataclass
from itertools import product

import rosgraph
import rospy
from sensor_msgs.msg import Joy

from risc_control.joystick import LATE_S, ButtonPresses
from risc_lab.ros.clock import ros_time_s
from risc_lab.ros.guard import guarded, subscribe
from risc_lab.ros.sender import sender
from risc_lab.settings import Positive, Settings

_CLAIMS = "/joystick_buttons/"
_ANSWER_S = 1.0


def origin(message):
    """(age [s], name of the sending node) of a message with a header; without a stamp its age is 0 on arrival.

    The age is by the clocks of two computers: `message_age.MessageAges` corrects it.
    """
    stamp_s = message.header.stamp.to_sec()
    age_s = ros_time_s() - stamp_s if stamp_s else 0.0
    return age_s, sender(message)


def claim_buttons(functions, topics=("joy",)):
    """Tell the other nodes, on the parameter server, what this one uses buttons for.

    functions: {name: index}; topics: of joysticks. Raises ValueError when a node that runs uses one of them for
    something else: the button for the next figure must not stop the motors.
    """
    own = rospy.get_name()
    claims = [[rospy.resolve_name(topic), name, int(index)] for topic in topics for name, index in functions.items()]
    place = _CLAIMS + own.replace("/", "_")
    rospy.set_param(place, {"node": own, "buttons": claims})  # first: of two that start together, one sees the other
    for other in rospy.get_param(_CLAIMS, {}).values():
        for (topic, name, index), (their_topic, their_name, their_index) in product(claims, other["buttons"]):
            is_same = (topic, index) == (their_topic, their_index) and name != their_name
            if other["node"] != own and is_same and _runs(other["node"]):
                rospy.delete_param(place)
                raise ValueError(
                    "button %d of %s is both %s and %s (of %s): set one of the two parameters to another button"
                    % (index, topic, name, their_name, other["node"])
                )


def _runs(node):
    """Whether a node answers; one that was killed stays registered."""
    try:
        address = urllib.parse.urlsplit(rosgraph.Master(rospy.get_name()).lookupNode(node))
        socket.create_connection((address.hostname, address.port), _ANSWER_S).close()
    except (rosgraph.MasterError, OSError):
        return False
    return True


@dataclass(frozen=True)
class ButtonParams(Settings):
    """Parameters of a node that uses buttons; a subclass adds them: {name: index from 0}."""

    joystick_late_s: Positive = LATE_S  # [s] a press that is older on arrival is logged, not obeyed


class ButtonSubscriber:
    """Calls back when buttons go down on `joy`."""

    def __init__(self, params, callback):
        """params: ButtonParams, whose buttons no other node may use for something else.
        callback: takes the frozenset of the indices that one message presses, never empty.

        Presses are handled one after the other in a separate thread: otherwise messages would wait for the callback,
        and look as if the network had delayed them. Raises ValueError for a button that is taken.
        """
        functions = dict(vars(params))
        late_s = functions.pop("joystick_late_s")
        self._judge = ButtonPresses(functions.values(), late_s)
        self._work = guarded(lambda: callback(self._pressed.get()), "a joystick button")
        self._pressed = queue.SimpleQueue()
        self._lock = threading.Lock()  # every sender has a thread of its own
        claim_buttons(functions)
        # Queue every message: in a burst that the network delayed, the first ones show that a press is old.
        subscribe("joy", Joy, self._on_joy, queue_size=None)
        threading.Thread(target=self._run, daemon=True).start()

    def _on_joy(self, message):
        age_s, sender = origin(message)
        with self._lock:
            presses = self._judge.update(message.buttons, time.monotonic(), age_s, sender)
            if presses.in_time:
                self._pressed.put(presses.in_time)
        if presses.late and presses.pressed:
            rospy.logwarn(
                "a joystick button was pressed %.1f s ago and is not obeyed: look at the network, and at the clocks",
                presses.age_s,
            )

    def _run(self):
        while True:
            self._work()
