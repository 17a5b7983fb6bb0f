"""The operator's joystick: there, readable, and with the buttons and axes that the vehicle node wants?"""

import array
import fcntl
import glob
import os

from joy.device import device_name
from risc_control.joystick import Button, JoystickParams
from risc_doctor.findings import Findings, finding

_PATTERN = "/dev/input/js*"
_JSIOCGAXES, _JSIOCGBUTTONS = 0x80016A11, 0x80016A12  # linux/joystick.h


def check(situation):
    """The devices that were named, else those that are there."""
    devices = situation.joysticks or sorted(glob.glob(_PATTERN))
    if not devices:
        return Findings("joystick").say("none_needed" if situation.simulated else "none", pattern=_PATTERN)
    return [look(path, needed_indices()) for path in devices]


def needed_indices():
    """(highest button index, highest axis index) of the vehicle node."""
    params = JoystickParams()
    buttons = max(getattr(params, button.value) for button in Button)
    return buttons, max(params.AxisRoll, params.AxisPitch, params.AxisYaw)


def look(path, needed):
    """Finding about one device."""
    say, place = "joystick", {"path": path, "pattern": _PATTERN}
    try:
        fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except FileNotFoundError:
        return finding(say, "missing", **place)
    except PermissionError:
        return finding(say, "forbidden", path=path, user=os.environ.get("USER") or "$USER")
    except OSError as error:
        return finding(say, "failed", path=path, error=error.strerror)
    try:
        name = device_name(fd)
        if not name:
            return finding(say, "other_device", **place)
        return judge(path, name, _count(fd, _JSIOCGBUTTONS), _count(fd, _JSIOCGAXES), needed)
    finally:
        os.close(fd)


def judge(path, name, buttons, axes, needed):
    """Finding about a joystick with so many buttons and axes. needed: highest index of each."""
    button, axis = needed
    code = "short" if buttons <= button or axes <= axis else "good"
    return finding("joystick", code, path=path, name=name, buttons=buttons, axes=axes, button=button, axis=axis)


def _count(fd, request):
    buffer = array.array("B", [0])
    fcntl.ioctl(fd, request, buffer, True)
    return buffer[0]
