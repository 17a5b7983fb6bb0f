"""Command lines of driver.py and roscopter_node.py. No ROS."""

import optparse
import typing
from dataclasses import dataclass, fields

from risc_lab.settings import Count, Name, Positive, Settings, between, settings_from
from roscopter import transport

_TRUE, _FALSE = ("true", "1", "yes", "on"), ("false", "0", "no", "off")


@dataclass(frozen=True)
class Options(Settings):
    """Options of driver.py, under the same names with `_` for `-`."""

    device: Name = "/dev/ttyACM0"  # see transport
    baudrate: between(1, 10_000_000) = 115200  # [baud] of a serial device
    vehicle_name: str = ""  # prefix of each line of the log
    type: typing.Literal["ArduCopter", "ArduRover"] = "ArduCopter"  # defines the numbers of the modes
    rate: Positive = 1000.0  # accepted but not used: the driver waits for bytes, it does not poll
    mavlink_rate: between(1, 200) = 10  # [Hz] requested from the autopilot
    source_system: between(1, 255) = 255  # our number: autopilots obey only the one in their parameter SYSID_MYGCS
    enable_rc_control: bool = False  # send_rc becomes RC_CHANNELS_OVERRIDE
    rc_timeout: between(1, 60_000) = 500  # [ms] of silence on send_rc after which the channels are released
    enable_waypoint_control: bool = True  # waypoint and waypoint_list are obeyed
    launch_altitude: Count = 10_000  # [mm]
    minimum_waypoint_altitude: int = 5_000  # [mm] a lower waypoint is refused
    maximum_altitude: int = 50_000  # [mm] a higher waypoint is refused
    waypoint_timeout: Count = 500  # [ms] for an answer while a mission is sent
    arm_timeout: Count = 10_000  # [ms] until the autopilot reports that it has armed or disarmed
    launch_timeout: Count = 15_000  # [ms] until it has accepted the order to take off
    mode_timeout: Count = 1_000  # [ms] until it reports the new mode
    enable_watchdog: bool = False  # overrides need `true` on the topic watchdog
    max_watchdog_time: Positive = 3.0  # [s] how long a `true` is valid
    watchdog_rate: Positive = 1.0  # [Hz] how often that is checked
    enable_ros_failsafe: bool = False  # land (a rover: hold) when the watchdog runs out
    enable_autonomous_control: bool = False  # send_rc is obeyed only while a switch of the pilot's radio is on
    autonomous_channel_id: between(5, 8) = 6  # channel number of that switch

    def __post_init__(self):
        super().__post_init__()
        if self.minimum_waypoint_altitude > self.maximum_altitude:
            raise ValueError(
                "minimum-waypoint-altitude %d mm is above maximum-altitude %d mm"
                % (self.minimum_waypoint_altitude, self.maximum_altitude)
            )
        if not self.minimum_waypoint_altitude <= self.launch_altitude <= self.maximum_altitude:
            raise ValueError(
                "launch-altitude %d mm is not between minimum-waypoint-altitude and maximum-altitude, %d and %d mm"
                % (self.launch_altitude, self.minimum_waypoint_altitude, self.maximum_altitude)
            )


# options of roscopter_node.py: name, field above, default
_OF_NODE = (
    ("baudrate", "baudrate", 57600),
    ("device", "device", "/dev/ttyUSB0"),
    ("rate", "mavlink_rate", 10),
    ("source-system", "source_system", 255),
    ("enable-control", "enable_rc_control", False),
)
_OF_DRIVER = tuple((field.name.replace("_", "-"), field.name, field.default) for field in fields(Options))


def driver_options(arguments):
    """Return (`Options`, ignored arguments) of driver.py. Raises SystemExit, after a line on stderr with the fault."""
    return _parse(_OF_DRIVER, arguments)


def node_options(arguments):
    """Like driver_options for roscopter_node.py, which has fewer options and other defaults."""
    return _parse(_OF_NODE, arguments)


def _parse(known, arguments):
    parser = optparse.OptionParser(usage="%prog [options]; arguments of the form name:=value are left to ROS")
    for name, field, default in known:
        kind = {bool: "true|false", int: "INTEGER", float: "NUMBER"}.get(type(default), "TEXT")
        parser.add_option(
            "--" + name,
            dest=field,
            metavar=kind,
            help="default %s" % (str(default).lower() if type(default) is bool else default or "none"),
        )
    given, rest = parser.parse_args(list(arguments))
    values = {field: default for _, field, default in known}
    for name, field, default in known:
        text = getattr(given, field)
        if text is not None:
            values[field] = _truth(parser, name, text) if type(default) is bool else text
    try:
        options = settings_from(Options, values, "options", lenient=True)
        transport.check(options.device)
    except ValueError as error:
        parser.error(str(error))
    return options, [argument for argument in rest if ":=" not in argument]


def _truth(parser, name, text):
    word = text.strip().lower()
    if word not in _TRUE + _FALSE:
        parser.error("option --%s: must be true or false, found %r" % (name, text))
    return word in _TRUE
