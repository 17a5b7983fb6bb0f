"""The operator's joystick: there, readable, and with the buttons and axes that the vehicle node wants?"""

import array
import fcntl
import glob
import os

from joy.device import device_name, open_device
from risc_control.joystick import Button, JoystickParams
from risc_doctor.findings import Findings, finding

_PATTERN = "/dev/input/js*"
_JSIOCGAXES, _JSIOCGBUTTONS = 0x80016A11, 0x80016A12  # linux/joystick.h


def check(situation):
    """Check the devices that were named, else all that there are."""
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
    """Finding about one device. needed: highest index of its buttons and axes."""
    values = {"path": path, "pattern": _PATTERN, "user": os.environ.get("USER") or "$USER"}
    try:
        with open(open_device(path), "rb", buffering=0) as device:
            name, counts = device_name(device), []
            if not name:
                return finding("joystick", "other_device", **values)
            for request in (_JSIOCGBUTTONS, _JSIOCGAXES):
                number = array.array("B", [0])
                fcntl.ioctl(device, request, number)
                counts.append(number[0])
            return judge(path, name, *counts, needed)
    except OSError as error:
        codes = {FileNotFoundError: "missing", PermissionError: "forbidden"}
        return finding("joystick", codes.get(type(error), "failed"), error=error.strerror, **values)


def judge(path, name, buttons, axes, needed):
    """Finding about a joystick with these numbers of buttons and axes. needed: highest index of each."""
    button, axis = needed
    code = "short" if buttons <= button or axes <= axis else "good"
    return finding("joystick", code, path=path, name=name, buttons=buttons, axes=axes, button=button, axis=axis)
