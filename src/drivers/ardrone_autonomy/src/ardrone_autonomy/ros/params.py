"""Private parameters of the driver node -> one value."""

import math
from collections import namedtuple

from ardrone_autonomy.link import COMMAND_TIMEOUT_S
from ardrone_autonomy.protocol import DEFAULT_ADDRESS
from ardrone_autonomy.protocol.navdata import LAYOUTS
from ardrone_autonomy.settings import WRITABLE_KEYS, SettingError, wanted_texts

OPTION_NAMES = tuple(layout.name for _, layout in sorted(LAYOUTS.items()))

# Parameters of the original driver (and of its older releases) that change nothing here.
WITHOUT_EFFECT = ("root_frame", "do_imu_caliberation")
READ_ELSEWHERE = ("cov", "diagnostic_period", "tf_prefix")

_NO_COVARIANCE = (0.0,) * 9


class ParameterError(ValueError):
    """A parameter that the node cannot work with; the text names it and the cure."""


DriverParams = namedtuple(
    "DriverParams",
    (
        "address",  # host name or IPv4 address of the vehicle
        "looprate_hz",
        "realtime_navdata",  # publish every packet, not the newest one per loop
        "realtime_video",  # publish every picture at once, not the newest one per loop
        "video_latency_s",  # from exposure to reception of a picture
        "camera_info_urls",  # calibrations of front and bottom camera, "" = default
        "legacy_navdata",  # publish navdata, imu, mag
        "options",  # names of the enabled selective messages, e.g. "demo"
        "frame_prefix",  # drone_frame_id
        "cov_imu_la",
        "cov_imu_av",
        "cov_imu_or",  # tuples of 9
        "settle_time_s",
        "command_timeout_s",
        "setting_texts",  # of settings.wanted_texts
        "video_channel",  # 0 front, 1 bottom
        "warnings",  # texts about parameters that are not used, or not as they stand
    ),
)


def parse_params(tree, arguments=()):
    """DriverParams.

    tree: dict of the private parameters as the parameter server holds them (nested for cov/...).
    arguments: command line without the program's name and without ROS remappings; "-ip A.B.C.D" is understood and
    wins over ~drone_ip.  ParameterError on a bad value.
    """
    reader = _Reader(tree)
    address = _address_argument(arguments) or reader.text("drone_ip", DEFAULT_ADDRESS)
    looprate_hz = reader.number("looprate", 50.0)
    if looprate_hz <= 0.0:
        raise ParameterError("parameter ~looprate: %r Hz is not possible, set a positive rate" % looprate_hz)
    options = tuple(name for name in OPTION_NAMES if reader.flag("enable_navdata_" + name, False))
    warnings = []
    covariances = [reader.covariance("cov/" + name, warnings) for name in ("imu_la", "imu_av", "imu_or")]
    try:
        setting_texts = wanted_texts(tree)
    except SettingError as error:
        raise ParameterError(str(error)) from None
    realtime_navdata = reader.flag("realtime_navdata", False)
    realtime_video = reader.flag("realtime_video", False)
    video_latency_s = reader.duration("video_latency", 0.0)
    camera_info_urls = tuple(reader.url(name) for name in ("camera_info_url", "bottom_camera_info_url"))
    legacy_navdata = reader.flag("enable_legacy_navdata", True)
    frame_prefix = reader.text("drone_frame_id", "ardrone_base")
    settle_time_s = reader.duration("settle_time", 5.0)
    command_timeout_s = reader.duration("cmd_timeout", COMMAND_TIMEOUT_S)
    known = reader.known.union(WRITABLE_KEYS, READ_ELSEWHERE)
    warnings.extend(
        "parameter ~%s has no effect%s"
        % (name, "" if name in WITHOUT_EFFECT else ": neither the driver nor the vehicle knows it")
        for name in sorted(set(tree) - known)
    )
    return DriverParams(
        address=address,
        looprate_hz=looprate_hz,
        realtime_navdata=realtime_navdata,
        realtime_video=realtime_video,
        video_latency_s=video_latency_s,
        camera_info_urls=camera_info_urls,
        legacy_navdata=legacy_navdata,
        options=options,
        frame_prefix=frame_prefix,
        cov_imu_la=covariances[0],
        cov_imu_av=covariances[1],
        cov_imu_or=covariances[2],
        settle_time_s=settle_time_s,
        command_timeout_s=command_timeout_s,
        setting_texts=setting_texts,
        video_channel=int(setting_texts.get("video_channel", 0)) % 2,
        warnings=tuple(warnings),
    )


def frame_name(tf_prefix, name):
    """Name of a tf frame: "<tf_prefix>/<name>", or the bare name when the prefix is empty."""
    return "/".join(part for part in (str(tf_prefix or "").strip("/"), name.strip("/")) if part)


def _address_argument(arguments):
    arguments = list(arguments)
    if not arguments:
        return None
    if len(arguments) == 2 and arguments[0] in ("-ip", "--ip"):
        return arguments[1]
    raise ParameterError("unknown arguments %r: the driver takes -ip A.B.C.D" % " ".join(arguments))


class _Reader:
    """Typed access that remembers which names were asked for."""

    def __init__(self, tree):
        self._tree = tree
        self.known = set()

    def _get(self, name, default):
        self.known.add(name)
        return self._tree.get(name, default)

    def number(self, name, default):
        value = self._get(name, default)
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = math.nan
        if not math.isfinite(number):
            raise ParameterError("parameter ~%s: a number is needed, got %r" % (name, value))
        return number

    def duration(self, name, default):
        value = self.number(name, default)
        if value < 0.0:
            raise ParameterError("parameter ~%s: must not be negative, got %r s" % (name, value))
        return value

    def flag(self, name, default):
        value = self._get(name, default)
        if not isinstance(value, (bool, int, float)):
            raise ParameterError("parameter ~%s: true or false is needed, got %r" % (name, value))
        return bool(value)

    def text(self, name, default):
        value = self._get(name, default)
        if not isinstance(value, str) or not value.strip("/ "):
            raise ParameterError("parameter ~%s: a text is needed, got %r" % (name, value))
        return value

    def url(self, name):
        value = self._get(name, "")
        if not isinstance(value, str):
            raise ParameterError("parameter ~%s: a URL like file:///PATH.yaml is needed, got %r" % (name, value))
        return value.strip()

    def covariance(self, path, warnings):
        group, name = path.split("/")
        covariances = self._tree.get(group, {})
        value = covariances.get(name, _NO_COVARIANCE) if isinstance(covariances, dict) else None
        if (
            not isinstance(value, (list, tuple))
            or len(value) != 9
            or not all(isinstance(x, (int, float)) for x in value)
        ):
            warnings.append(
                "parameter ~%s is taken as zero: a list of 9 numbers (3 x 3, row by row) is needed, got %r"
                % (path, value)
            )
            value = _NO_COVARIANCE
        return tuple(float(x) for x in value)
