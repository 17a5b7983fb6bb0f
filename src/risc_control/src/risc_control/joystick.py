"""Meaning of joystick messages (Appendix C): button edges, sticks in manual mode, messages that are too late. No ROS.

The names of the parameters are those of the original release; inside, our own names are used.
"""

import enum
import math
from collections import defaultdict
from dataclasses import dataclass
from typing import NamedTuple

from risc_lab.message_age import MessageAges
from risc_lab.settings import Count, NotNegative, Positive, Settings

LATE_S = 0.3  # [s] a joystick message older than this when it arrives is not current
_FIRST_S = 1.0  # [s] within this time of its start a node hears a joystick that repeats its messages
_CLOCK_MEMORY_S = 2.0  # [s] after a joystick's clock was set back, its messages count as late for one to two of these


class Button(enum.Enum):
    """What the buttons are for; the value is the name of the parameter that holds the button's index."""

    TOGGLE_AUTONOMOUS = "JoytoWay"
    EMERGENCY = "ButtonEmergency"
    TAKEOFF_LAND = "TakeoffLand"
    UP = "Up"
    DOWN = "Down"
    SHUT_DOWN = "ShutDownNode"


class Sticks(NamedTuple):
    """Manual command: fractions in [-1, 1] in the senses of cmd_vel."""

    forward: float
    left: float
    up: float
    turn_left: float  # + counter-clockwise


CENTRED = Sticks(0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class JoystickParams(Settings):
    """Mapping of one joystick. Indices count from 0; a manual value is *divided* by its scale.

    Buttons and axes are those of Appendix C (a game pad under the Linux xpad driver). The original release's own
    defaults (5, 1, 2, 3, 4, 0) had "autonomy off" on the button for the next figure, and "motors off" on that of
    `virtual_target.py`. Its scales of 1 stay; those of Appendix C are 3 for roll and pitch.
    """

    JoytoWay: Count = 0  # button: manual/autonomous toggle
    ButtonEmergency: Count = 2  # button: reset (motors off in the air, clears an emergency on the ground)
    TakeoffLand: Count = 6  # button: take off when landed, land otherwise
    Up: Count = 9  # button: climb while held (manual mode)
    Down: Count = 10  # button: descend while held (manual mode)
    ShutDownNode: Count = 7  # button: land and end the node
    AxisRoll: Count = 6  # axis: + left
    AxisPitch: Count = 7  # axis: + forward
    AxisYaw: Count = 3  # axis: + counter-clockwise
    ScaleRoll: Positive = 1.0  # [-]
    ScalePitch: Positive = 1.0  # [-]
    ScaleYaw: Positive = 1.0  # [-]
    ScaleZ: Positive = 1.0  # [-]
    # [s] silent for longer: sticks count as centred (run joy_node with autorepeat_rate 20); 0 = off: last message stays
    stick_timeout: NotNegative = 0.5
    joystick_late_s: Positive = LATE_S  # [s] a message older than this when it arrives is not obeyed

    def __post_init__(self):
        super().__post_init__()
        names = {}
        for button in Button:
            index = getattr(self, button.value)
            if names.setdefault(index, button.value) != button.value:
                raise ValueError("parameters %s and %s are both button %d" % (names[index], button.value, index))


class Edges(NamedTuple):
    """Buttons of one joystick message."""

    held: frozenset  # are down
    pressed: frozenset  # went down with this message
    belated: frozenset  # are down, and were pressed in an earlier message that came too late
    late: bool  # this message is too old to act on
    age_s: float

    @property
    def in_time(self):
        """Pressed buttons that may be acted on."""
        return frozenset() if self.late else self.pressed


class ButtonEdges:
    """Finds the edges of one joystick's buttons.

    A button that is down in the very first message counts as pressed: joy_node publishes on change only, so the first
    message a node sees often *is* the press. A button that goes down with a late message and is still down in the next
    one in time is `belated` there, once. So is one that is down in a first message right after the node has started: it
    may have been restarted while the button is held.
    """

    def __init__(self, late_s=LATE_S, listens_since_s=-math.inf):
        self._late_s, self._began_s = late_s, listens_since_s
        self._ages = MessageAges(_CLOCK_MEMORY_S)
        self._held = self._belated = frozenset()

    def update(self, held, age_s, now_s):
        """`Edges` of a message with these buttons down (frozenset).

        age_s: by the message's stamp [s]; 0 when it has none.  now_s: of a monotonic clock.
        """
        age_s = self._ages.corrected(age_s, now_s)
        edges = Edges(held, held - self._held, self._belated & held, age_s > self._late_s, age_s)
        if now_s - self._began_s < _FIRST_S:
            edges = edges._replace(pressed=frozenset(), belated=held)
        self._began_s = -math.inf  # that was the first
        self._held, self._belated = held, edges.belated | edges.pressed if edges.late else frozenset()
        return edges


class Joystick:
    """One joystick: the edges of its buttons, and its sticks in the newest message in time."""

    def __init__(self, params, listens_since_s=-math.inf):
        """params: JoystickParams.  listens_since_s: see `ButtonEdges`."""
        self._params = params
        self._edges = ButtonEdges(params.joystick_late_s, listens_since_s)
        self.sticks = CENTRED
        self.heard_s = -math.inf  # arrival of the newest message in time
        self.problems = []  # sentences about what the newest message lacks

    def update(self, buttons, axes, now_s=0.0, age_s=0.0):
        """`Edges` of `Button`, after a message.

        buttons: ints, axes: floats (+ left, + forward) of a Joy message, any number of them. Missing ones count as
        released or centred.  now_s, age_s: see `ButtonEdges`.
        """
        self.problems, p = [], self._params
        held = frozenset(button for button in Button if self._value(buttons, "buttons", button.value))
        edges = self._edges.update(held, age_s, now_s)
        if not edges.late:
            climb = (float(Button.UP in held) - float(Button.DOWN in held)) / p.ScaleZ
            forward, left, turn_left = (
                self._value(axes, "axes", name) / scale
                for name, scale in (("AxisPitch", p.ScalePitch), ("AxisRoll", p.ScaleRoll), ("AxisYaw", p.ScaleYaw))
            )
            self.sticks, self.heard_s = Sticks(*map(limited, (forward, left, climb, turn_left))), now_s
        return edges

    def _value(self, values, kinds, name):
        index = getattr(self._params, name)
        if index >= len(values):
            self.problems.append(
                "the joystick has %d %s, but %s is number %d (counted from 0): is it the right joystick, and is the "
                "parameter %s right?" % (len(values), kinds, name, index, name)
            )
            return 0.0
        if not math.isfinite(values[index]):
            self.problems.append("%s (number %d of the %s) is not finite: taken as 0" % (name, index, kinds))
            return 0.0
        return values[index]


class ButtonPresses:
    """Detects presses of a few buttons, for nodes that need nothing else of a joystick.

    Edges and ages are kept per sender: otherwise, beside a virtual operator that sends all the time, a button that a
    person holds would be a new press with every message.
    """

    def __init__(self, buttons, late_s=LATE_S):
        """buttons: indices from 0.  late_s: limit of the age [s]; inf when no message is too old."""
        self._buttons = frozenset(buttons)
        self._senders = defaultdict(lambda: ButtonEdges(late_s))

    def update(self, values, now_s=0.0, age_s=0.0, sender=""):
        """`Edges` of a message with these button values (0 or 1 each), any number of them.

        now_s, age_s: see `ButtonEdges`.  sender: any key.
        """
        down = frozenset(button for button in self._buttons if button < len(values) and values[button])
        return self._senders[sender].update(down, age_s, now_s)


def limited(fraction):
    """A fraction within [-1, 1]."""
    return min(max(fraction, -1.0), 1.0)
