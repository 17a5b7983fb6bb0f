"""Flight modes: their names and numbers. No ROS."""

from pymavlink.dialects.v20 import ardupilotmega as mavlink

_OF_2014 = {8: "POSITION", 10: "OF_LOITER"}  # modes of copters of 2014; later firmware does not have these numbers


def _named(enum):
    """Return {number: name} of one of the dialect's enumerations."""
    prefix = enum + "_"
    entries = {number: entry.name.removeprefix(prefix) for number, entry in mavlink.enums[enum].items()}
    return {number: name for number, name in entries.items() if name != "ENUM_END"}


MODES = {"ArduCopter": {**_OF_2014, **_named("COPTER_MODE")}, "ArduRover": _named("ROVER_MODE")}  # by vehicle type


def mode_number(vehicle_type, name):
    """Return the number of a mode by its name. Raises ValueError if vehicles of this type do not have it."""
    for number, known in MODES[vehicle_type].items():
        if known == name:
            return number
    raise ValueError("an %s has no mode %s" % (vehicle_type, name))


def mode_name(vehicle_type, heartbeat):
    """Return the name of the mode in a HEARTBEAT, as pymavlink writes it."""
    if not heartbeat.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return "Mode(0x%08x)" % heartbeat.base_mode
    return MODES[vehicle_type].get(heartbeat.custom_mode, "Mode(%d)" % heartbeat.custom_mode)
