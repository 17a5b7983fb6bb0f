"""Linux joystick records to the axes and buttons of sensor_msgs/Joy, and when to publish them. No ROS, no devices.

One record of the kernel's joystick API is 8 bytes in native byte order: uint32 time [ms], int16 value, uint8 type,
uint8 number. Type 1 is a button, 2 an axis; bit 0x80 marks the synthetic records that announce the initial state.
"""

import enum
import math
import struct
from dataclasses import dataclass, replace
from typing import NamedTuple

from risc_lab.settings import Settings

_RECORD = struct.Struct("=IhBB")
_BUTTON = 0x01
_AXIS = 0x02
_INIT = 0x80
_FULL_SCALE = 32767.0
_DEADZONE_MAX = 0.9


class JoyEvent(NamedTuple):
    """One record of the joystick device."""

    value: int  # axis: -32767..32767, button: 0 or 1
    type: int
    number: int


class RecordReader:
    """Cuts a byte stream into records; a read may end in the middle of a record."""

    def __init__(self):
        self._rest = b""

    def feed(self, data):
        """Add bytes; return the list of complete `JoyEvent`s."""
        data = self._rest + data
        whole = len(data) - len(data) % _RECORD.size
        self._rest = data[whole:]
        return [JoyEvent(*record[1:]) for record in _RECORD.iter_unpack(data[:whole])]


# How soon an event must be published. NEVER: unknown type; SOON: within coalesce_interval, with other events; NOW.
Urgency = enum.Enum("Urgency", "NEVER SOON NOW")


@dataclass(frozen=True)
class JoySettings(Settings):
    """Parameters of joy_node. Use the result of `checked`."""

    dev: str = "/dev/input/js0"
    dev_name: str = ""  # if set, the first joystick with this name is used
    dev_ff: str = "/dev/input/event0"  # event device for rumble
    deadzone: float = 0.05  # [-] fraction of full scale that reads as 0
    autorepeat_rate: float = 0.0  # [Hz] 0: publish on change only
    coalesce_interval: float = 0.001  # [s] axis events within it make one message
    default_trig_val: bool = False  # True: take the initial axis values as they are announced
    sticky_buttons: bool = False  # True: a press toggles the button, a release does nothing

    def checked(self):
        """Return the settings within their ranges, and one sentence for each value that was changed or looks wrong."""
        fraction = self.deadzone / _FULL_SCALE if self.deadzone >= 1.0 else self.deadzone
        used = {
            "deadzone": min(max(fraction, 0.0), _DEADZONE_MAX),
            "autorepeat_rate": max(self.autorepeat_rate, 0.0),
            "coalesce_interval": max(self.coalesce_interval, 0.0),
        }
        notes = [
            "%s %g is not possible: using %g" % (name, getattr(self, name), value)
            for name, value in used.items()
            if value != getattr(self, name)
        ]
        if fraction != self.deadzone:
            notes[0] += " (1 or more is read as raw units, of which full scale is 32767)"
        if used["autorepeat_rate"] * used["coalesce_interval"] > 1.0:
            notes.append(
                "autorepeat_rate %(autorepeat_rate)g Hz is faster than one message in coalesce_interval, "
                "%(coalesce_interval)g s: messages come at the slower pace" % used
            )
        return replace(self, **used), notes


class JoyState:
    """Current axes and buttons; the arrays grow to the highest number that the device has reported."""

    def __init__(self, settings):
        self.axes = []  # floats in [-1, 1], left and up positive
        self.buttons = []  # 0 or 1
        self._settings = settings

    def axis_value(self, raw):
        """Scale raw -32767..32767 to [-1, 1]: subtract the dead zone, stretch the rest; left and up positive."""
        dead = _FULL_SCALE * self._settings.deadzone
        beyond = max(abs(raw) - dead, 0.0)
        scaled = beyond / (_FULL_SCALE - dead)
        return -math.copysign(min(scaled, 1.0), raw) if beyond else 0.0

    def apply(self, event):
        """Apply one event to the state; return its `Urgency`."""
        kind, is_initial = event.type & ~_INIT, event.type & _INIT  # is_initial: announces the state after opening
        if kind == _BUTTON:
            self._grow(self.buttons, event.number, 0)
            if not self._settings.sticky_buttons:
                self.buttons[event.number] = 1 if event.value else 0
            elif event.value == 1:
                self.buttons[event.number] = 1 - self.buttons[event.number]
            return Urgency.SOON if is_initial else Urgency.NOW
        if kind == _AXIS:
            self._grow(self.axes, event.number, 0.0)
            # Triggers announce 0 until first touched, which would read as half pressed: keep 0 unless default_trig_val.
            if not is_initial or self._settings.default_trig_val:
                self.axes[event.number] = self.axis_value(event.value)
            return Urgency.SOON
        return Urgency.NEVER

    @staticmethod
    def _grow(values, number, zero):
        values.extend([zero] * (number + 1 - len(values)))


class PublishClock:
    """Decides when to publish the state: at once, after the coalesce interval, or as a repetition.

    Times are seconds of any clock that never steps.
    """

    def __init__(self, settings):
        self._coalesce_s = settings.coalesce_interval
        self._repeat_s = 1.0 / settings.autorepeat_rate if settings.autorepeat_rate > 0.0 else math.inf
        self._is_pending = False  # events are being coalesced
        self._due_s = None  # when they or the next repetition are published; None: not determined yet

    def event(self, urgency, now_s):
        """Note an event; return True when the state must be published now."""
        if urgency == Urgency.SOON and not self._is_pending:
            self._is_pending, self._due_s = True, now_s + self._coalesce_s
        return urgency == Urgency.NOW

    def due(self, now_s):
        """True when a coalesced or repeated message is due."""
        return self.wait_s(now_s, math.inf) == 0.0

    def published(self, now_s):
        """Note that the state was published, including all pending events."""
        self._is_pending, self._due_s = False, now_s + self._repeat_s

    def wait_s(self, now_s, longest_s):
        """Return how long to wait for the next event, in [0, longest_s]."""
        if self._due_s is None:
            self._due_s = now_s + self._repeat_s
        return min(max(self._due_s - now_s, 0.0), longest_s)
