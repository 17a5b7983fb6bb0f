"""The operator's joystick: there, readable, and with the buttons and axes that the vehicle node wants?"""

import array
import fcntl
import glob
import os

from joy.device import device_name
from risc_control.joystick import Button, JoystickParams
from risc_doctor.findings import green, red, yellow

_PATTERN = "/dev/input/js*"
_JSIOCGAXES, _JSIOCGBUTTONS = 0x80016A11, 0x80016A12  # linux/joystick.h


def check(situation):
    """The devices that were named, else those that are there."""
    needed = needed_indices()
    if situation.joysticks:
        return [look(path, needed) for path in situation.joysticks]
    devices = sorted(glob.glob(_PATTERN))
    if devices:
        return [look(path, needed) for path in devices]
    if situation.simulated:
        return [green("joystick", "none is plugged in; the virtual operator needs none")]
    return [
        yellow(
            "joystick",
            "none is plugged in (%s)" % _PATTERN,
            "plug it into the computer that flies the vehicle (a base station needs none); --joystick names others",
        )
    ]


def needed_indices():
    """(highest button index, highest axis index) of the vehicle node."""
    params = JoystickParams()
    buttons = max(getattr(params, button.value) for button in Button)
    return buttons, max(params.AxisRoll, params.AxisPitch, params.AxisYaw)


def look(path, needed):
    """Finding about one device."""
    say = "joystick"
    try:
        fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except FileNotFoundError:
        return red(say, "%s is not there" % path, "plug it in; `ls %s` shows what is there" % _PATTERN)
    except PermissionError:
        cure = "sudo usermod -aG input %s, then log in again" % (os.environ.get("USER") or "$USER")
        return red(say, "%s may not be read by this user" % path, cure)
    except OSError as error:
        return red(say, "%s: %s" % (path, error.strerror), "plug it out and in again")
    try:
        name = device_name(fd)
        if not name:
            return red(say, "%s is no joystick" % path, "name the right device; `ls %s` shows them" % _PATTERN)
        return judge(path, name, _count(fd, _JSIOCGBUTTONS), _count(fd, _JSIOCGAXES), needed)
    finally:
        os.close(fd)


def judge(path, name, buttons, axes, needed):
    """Finding about a joystick with so many buttons and axes. needed: highest index of each."""
    button, axis = needed
    text = "%s is '%s' with %d buttons and %d axes" % (path, name, buttons, axes)
    if buttons <= button or axes <= axis:
        return red(
            "joystick",
            text + "; the vehicle node uses button %d and axis %d (counted from 0)" % needed,
            "use another pad, or set the vehicle node's parameters for its buttons and axes (JoystickParams)",
        )
    return green("joystick", text)


def _count(fd, request):
    buffer = array.array("B", [0])
    fcntl.ioctl(fd, request, buffer, True)
    return buffer[0]
