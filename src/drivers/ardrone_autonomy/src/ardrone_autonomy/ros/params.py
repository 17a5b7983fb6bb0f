"""Private parameters of the driver node -> values."""

from dataclasses import dataclass, make_dataclass
from typing import NamedTuple

from ardrone_autonomy.aircraft_configuration import WRITABLE_KEYS, wanted_texts
from ardrone_autonomy.link import COMMAND_TIMEOUT_S
from ardrone_autonomy.protocol import DEFAULT_ADDRESS
from ardrone_autonomy.protocol.navdata import LAYOUTS
from risc_lab.ros.params import params_from_dict
from risc_lab.settings import Name, NotNegative, Positive, Settings

OPTION_NAMES = tuple(layout.name for _, layout in sorted(LAYOUTS.items()))
_READ_ELSEWHERE = {"cov", "tf_prefix", *WRITABLE_KEYS}


@dataclass(frozen=True)
class DriverParams(Settings):
    """Parameters of the node itself, with the names and defaults of the original driver."""

    drone_ip: Name = DEFAULT_ADDRESS  # host name or IPv4 address of the vehicle
    looprate: Positive = 50.0  # [Hz]
    realtime_navdata: bool = False  # publish every packet, not the newest one per loop
    realtime_video: bool = False  # publish every picture at once, not the newest one per loop
    video_latency: NotNegative = 0.0  # [s] from exposure to reception of a picture
    camera_info_url: str = ""  # calibration of the front camera, "" = default
    bottom_camera_info_url: str = ""
    enable_legacy_navdata: bool = True  # publish navdata, imu, mag
    drone_frame_id: Name = "ardrone_base"
    settle_time: NotNegative = 5.0  # [s] from the first packet to the configuration
    cmd_timeout: NotNegative = COMMAND_TIMEOUT_S  # [s] hover when cmd_vel is older; 0 = never
    cmd_land_timeout: NotNegative = 0.0  # [s] land when cmd_vel is older; 0 = never
    keeper: bool = True  # a process that keeps vehicles hovering when the driver dies or hangs, see `keeper`


_Enabled = make_dataclass(
    "_Enabled", [("enable_navdata_" + name, bool, False) for name in OPTION_NAMES], bases=(Settings,), frozen=True
)


class Configuration(NamedTuple):
    """The settings of one vehicle from its parameters."""

    params: DriverParams
    options: list  # names of the enabled selective messages, e.g. "demo"
    covariances: list  # of imu: acceleration, angular velocity, orientation; tuples of 9
    texts: dict  # from aircraft_configuration.wanted_texts
    warnings: list  # texts about parameters that are unused or were replaced

    @property
    def lost_s(self):
        """Silence [s] after which vehicle and driver each consider the other lost; whole seconds, at least 1."""
        return max(1.0, float(self.texts["com_watchdog"]))

    @property
    def video_channel(self):
        """Camera channel after the configuration: 0 front, 1 bottom."""
        return int(self.texts.get("video_channel", 0)) % 2


def parse_params(tree, arguments=()):
    """Return the Configuration.

    tree: dict of the private parameters as the parameter server holds them (nested for cov/...).
    arguments: command line without the program's name and without ROS remappings; "-ip A.B.C.D" is accepted and
    overrides ~drone_ip.  ValueError on a bad value.
    """
    if arguments:
        if len(arguments) != 2 or arguments[0] not in ("-ip", "--ip"):
            raise ValueError("unknown arguments %r: the driver takes -ip A.B.C.D" % " ".join(arguments))
        tree = dict(tree, drone_ip=arguments[1])
    (params, enabled), unknown = params_from_dict((DriverParams, _Enabled), tree, lenient=True)
    unknown = [name for name in unknown if name not in _READ_ELSEWHERE]
    warnings = ["parameter ~%s has no effect: neither the driver nor the vehicle knows it" % name for name in unknown]
    covariances = [_covariance(tree.get("cov"), name, warnings) for name in ("imu_la", "imu_av", "imu_or")]
    options = [name for name in OPTION_NAMES if getattr(enabled, "enable_navdata_" + name)]
    return Configuration(params, options, covariances, wanted_texts(tree), warnings)


def _covariance(given, name, warnings):
    """Return the 9 numbers of a covariance; zeros, as in the original, if it is missing or invalid."""
    value = given.get(name) if isinstance(given, dict) else given
    if isinstance(value, list) and len(value) == 9 and all(isinstance(x, (int, float)) for x in value):
        return tuple(map(float, value))
    if value is not None:
        warnings.append("parameter ~cov/%s is taken as zero: it must be a list of 9 numbers, found %r" % (name, value))
    return (0.0,) * 9
