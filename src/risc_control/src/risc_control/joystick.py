"""What a joystick message means (Appendix C): buttons by edge, sticks in manual mode, what is too late. No ROS.

The names of the parameters are those of the original release; house names are used inside.
"""

import enum
import math
from collections import defaultdict, namedtuple
from dataclasses import dataclass, fields

from risc_lab.message_age import MessageAges

LATE_S = 0.3  # [s] a joystick message older than this when it arrives is no word of the operator of now
CLOCK_MEMORY_S = 2.0  # [s] after a joystick's clock was set back, its messages pass for late for one to two of these


class Button(enum.Enum):
    """What the buttons are for; the value is the name of the parameter that holds the button's index."""

    TOGGLE_AUTONOMOUS = "JoytoWay"
    EMERGENCY = "ButtonEmergency"
    TAKEOFF_LAND = "TakeoffLand"
    UP = "Up"
    DOWN = "Down"
    SHUT_DOWN = "ShutDownNode"


# Manual command: fractions in [-1, 1] in the senses of cmd_vel: + forward, + left, + up, + counter-clockwise.
Sticks = namedtuple("Sticks", "forward left up turn_left")
CENTRED = Sticks(0.0, 0.0, 0.0, 0.0)


def parse_bool(value, name):
    """A truth value from a parameter; launch files of old set texts, and bool("False") is true (D-32).

    Raises ValueError for anything but true, false and their spellings.
    """
    if isinstance(value, str):
        text = value.strip().lower()
        if text in ("true", "1", "yes", "on"):
            return True
        if text in ("false", "0", "no", "off"):
            return False
    elif isinstance(value, bool) or value in (0, 1):
        return bool(value)
    raise ValueError("parameter %s must be true or false, found %r" % (name, value))


@dataclass(frozen=True)
class JoystickParams:
    """Mapping of one joystick. Indices count from 0; a manual value is *divided* by its scale.

    The buttons are those of Appendix C. The original release's own defaults (5, 1, 2, 3, 4, 0) had "autonomy off" on
    the button for the next figure, and "motors off" on that of `virtual_target.py`.
    """

    JoytoWay: int = 0  # button: manual/autonomous toggle
    ButtonEmergency: int = 2  # button: reset (motors off in the air, clears an emergency on the ground)
    TakeoffLand: int = 6  # button: take off when landed, land otherwise
    Up: int = 9  # button: climb while held (manual mode)
    Down: int = 10  # button: descend while held (manual mode)
    ShutDownNode: int = 7  # button: land and end the node
    AxisRoll: int = 6  # axis: + left
    AxisPitch: int = 7  # axis: + forward
    AxisYaw: int = 3  # axis: + counter-clockwise
    ScaleRoll: float = 1.0  # [-]
    ScalePitch: float = 1.0  # [-]
    ScaleYaw: float = 1.0  # [-]
    ScaleZ: float = 1.0  # [-]

    def __post_init__(self):
        taken = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
                raise ValueError("parameter %s must be a number, found %r" % (field.name, value))
            if field.name.startswith("Scale"):
                if value <= 0.0:
                    raise ValueError("parameter %s divides and must be > 0, found %r" % (field.name, value))
            elif value != int(value) or value < 0:
                raise ValueError("parameter %s must be an index (0, 1, ...), found %r" % (field.name, value))
            elif not field.name.startswith("Axis"):
                other = taken.setdefault(value, field.name)
                if other != field.name:
                    raise ValueError("parameters %s and %s are both button %d" % (other, field.name, value))


@dataclass(frozen=True)
class JoystickInput:
    """One joystick message, understood."""

    pressed: frozenset  # Buttons that went down with this message
    belated: frozenset  # Buttons that are down, and went down in a message that was late
    held: frozenset  # Buttons that are down
    sticks: Sticks
    problems: tuple  # sentences about what the message lacks


class Joystick:
    """Finds the edges of the buttons; keeps nothing but which were down."""

    def __init__(self, params):
        self._params = params
        self._held = frozenset()
        self._belated = frozenset()  # went down in a late message and are down since

    def update(self, buttons, axes, late=False):
        """buttons: ints, axes: floats (+ left, + forward) of a Joy message, as long as they happen to be.

        late: the message is too old to act on. What went down with it and is still down in the next message in time
        is `belated` there, once.

        Returns a `JoystickInput`. What the message lacks counts as released or centred and is a problem, never an
        error. A button that is down in the very first message counts as pressed: joy_node publishes on change only,
        so the first message a node sees often *is* the press.
        """
        problems = []
        held = frozenset(button for button in Button if self._button(buttons, button.value, problems))
        pressed = held - self._held
        belated = self._belated & held
        self._held = held
        self._belated = (belated | pressed) if late else frozenset()
        p = self._params
        climb = float(Button.UP in held) - float(Button.DOWN in held)
        sticks = Sticks(
            self._axis(axes, "AxisPitch", p.ScalePitch, problems),
            self._axis(axes, "AxisRoll", p.ScaleRoll, problems),
            limited(climb / p.ScaleZ),
            self._axis(axes, "AxisYaw", p.ScaleYaw, problems),
        )
        return JoystickInput(pressed, belated, held, sticks, tuple(problems))

    def _button(self, buttons, name, problems):
        index = int(getattr(self._params, name))
        if index >= len(buttons):
            problems.append(
                "the joystick has %d buttons, but %s is button %d (counted from 0): is it the right joystick, and "
                "is the parameter %s right?" % (len(buttons), name, index, name)
            )
            return False
        return bool(buttons[index])

    def _axis(self, axes, name, scale, problems):
        index = int(getattr(self._params, name))
        if index >= len(axes):
            problems.append(
                "the joystick has %d axes, but %s is axis %d (counted from 0): is it the right joystick, and is the "
                "parameter %s right?" % (len(axes), name, index, name)
            )
            return 0.0
        if not math.isfinite(axes[index]):
            problems.append("axis %d (%s) of the joystick is not a finite number: taken as 0" % (index, name))
            return 0.0
        return limited(axes[index] / scale)


def button_conflict(claims, others):
    """Which button two nodes use for different things, in a sentence; "" when there is none.

    claims: [(topic, function, index), ...] of the one; others: of the other.
    """
    for topic, function, index in claims:
        for their_topic, their_function, their_index in others:
            if (topic, index) == (their_topic, their_index) and function != their_function:
                return "button %d of %s is both %s and %s" % (index, topic, function, their_function)
    return ""


# Frozensets of the buttons that went down with a message in time and with a late one, and its age [s].
Presses = namedtuple("Presses", "in_time late age_s")


class ButtonPresses:
    """When a few buttons go down, for nodes that listen for nothing else.

    Down in the very first message counts, as in `Joystick`.
    Every sender has edges and a clock of its own: beside a virtual operator, which sends all the time, a button that a
    person holds would be a new press with every message.
    """

    def __init__(self, buttons, late_s=LATE_S):
        """buttons: indices from 0.  late_s: limit of the age [s]; inf when no message is too old. Raises ValueError."""
        self._buttons = frozenset(buttons)
        for button in self._buttons:
            if button < 0 or button != int(button):
                raise ValueError("a joystick's button must be an index (0, 1, ...), found %r" % button)
        if not late_s > 0.0:
            raise ValueError("parameter joystick_late_s must be > 0, found %r" % late_s)
        self._late_s = late_s
        self._down = defaultdict(frozenset)
        self._ages = defaultdict(lambda: MessageAges(CLOCK_MEMORY_S))

    def update(self, values, now_s=0.0, age_s=0.0, sender=""):
        """Presses of a message with these button values (0 or 1 each), as many as there happen to be.

        now_s: of a clock that never steps. age_s: by the message's stamp [s]; 0 when it has none. sender: any key.
        What goes down in a late message does not count when it is still down in one that is in time.
        """
        down = frozenset(button for button in self._buttons if button < len(values) and values[button])
        pressed = down - self._down[sender]
        self._down[sender] = down
        age_s = self._ages[sender].corrected(age_s, now_s)
        late = age_s > self._late_s
        return Presses(frozenset() if late else pressed, pressed if late else frozenset(), age_s)


def limited(fraction):
    """A fraction within [-1, 1]."""
    return min(max(fraction, -1.0), 1.0)
