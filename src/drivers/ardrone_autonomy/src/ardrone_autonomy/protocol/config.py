"""Configuration of the aircraft: keys, value formats, the text on TCP 5559, multi-configuration ids.

Writing is AT*CONFIG="section:name","value" (see at.py).  Reading back is text: lines ``section:name = value`` + LF,
one zero byte at the very end.

Keys fall in four categories: COMMON has one value; APPLICATION, USER and SESSION values are kept per id.  Ids are 8
lower-case hexadecimal digits.  User id = CRC-32 (zlib's polynomial) of the user name, application id = CRC-32 of
"name:sdkversion": ``ardrone_driver`` -> cea48d22, ``ardrone_driver:2.0`` -> e182b69b (both checked by a test).
"""

import math
import re
import zlib
from collections import namedtuple
from enum import Enum

DEFAULT_ID = "00000000"
SDK_VERSION = "2.0"
_ID = re.compile(r"[0-9a-f]{8}\Z")


class ConfigError(ValueError):
    """A value or text that does not fit the configuration format."""


class Category(Enum):
    """Where a value is kept."""

    COMMON = "common"
    APPLICATION = "application"
    USER = "user"
    SESSION = "session"


class Kind(Enum):
    """Format of a value on the wire."""

    BOOL = "bool"  # TRUE / FALSE
    INT = "int"  # decimal
    FLOAT = "float"  # %f: six decimals, a dot
    STRING = "string"  # as is
    VECTOR = "vector"  # { a b c }


class ConfigKey(namedtuple("ConfigKey", "section name kind default category read_only")):
    """One key; default is typed (bool, int, float, str, tuple of floats)."""

    __slots__ = ()

    @property
    def key(self):
        """section:name"""
        return "%s:%s" % (self.section, self.name)


def _keys():
    common, appli, user, session = Category.COMMON, Category.APPLICATION, Category.USER, Category.SESSION
    table = []

    def add(section, name, default, category=common, read_only=False):
        kinds = {bool: Kind.BOOL, int: Kind.INT, float: Kind.FLOAT, str: Kind.STRING, tuple: Kind.VECTOR}
        table.append(ConfigKey(section, name, kinds[type(default)], default, category, read_only))

    def fixed(section, name, default):
        add(section, name, default, read_only=True)

    # Units: angles rad, control_vz_max mm/s, control_yaw rad/s, altitudes mm, times s, bit rates kbit/s, vbat mV.
    fixed("general", "num_version_config", 1)
    fixed("general", "num_version_mb", 34)
    fixed("general", "num_version_soft", "2.4.8")
    fixed("general", "drone_serial", "PS721000000000000")
    fixed("general", "soft_build_date", "2014-01-01 00:00")
    for motor in range(1, 5):
        fixed("general", "motor%d_soft" % motor, "1.43")
        fixed("general", "motor%d_hard" % motor, "6.0")
        fixed("general", "motor%d_supplier" % motor, "1.1")
    add("general", "ardrone_name", "My ARDrone")
    fixed("general", "flying_time", 0)
    add("general", "navdata_demo", False)
    add("general", "navdata_options", 65537, appli)
    add("general", "com_watchdog", 2)
    add("general", "video_enable", True)
    add("general", "vision_enable", True)
    fixed("general", "vbat_min", 9000)

    fixed("control", "accs_offset", (-2000.0, 2000.0, 2000.0))
    fixed("control", "accs_gains", (1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0))
    fixed("control", "gyros_offset", (0.0, 0.0, 0.0))
    fixed("control", "gyros_gains", (0.001, -0.001, -0.001))
    add("control", "control_level", 0, appli)
    add("control", "euler_angle_max", 0.209440, user)
    add("control", "control_iphone_tilt", 0.349066, user)
    add("control", "control_vz_max", 700.0, user)
    add("control", "control_yaw", 1.745329, user)
    add("control", "outdoor", False)
    add("control", "flight_without_shell", False)
    add("control", "autonomous_flight", False)
    add("control", "manual_trim", False, user)
    add("control", "altitude_max", 3000)
    add("control", "altitude_min", 50)
    for mode, angle, climb, yaw in (("indoor", 0.209440, 700.0, 1.745329), ("outdoor", 0.349066, 1000.0, 3.490659)):
        add("control", mode + "_euler_angle_max", angle, user)
        add("control", mode + "_control_vz_max", climb, user)
        add("control", mode + "_control_yaw", yaw, user)
    add("control", "flying_mode", 0, session)
    add("control", "hovering_range", 1000, session)
    add("control", "flight_anim", "0,0")
    add("control", "travelling_mode", "0,0,0,0,0,0,0,0,0,0")
    add("control", "travelling_enable", False)

    add("network", "ssid_single_player", "ardrone2_000000")
    add("network", "ssid_multi_player", "ardrone2_000000")
    add("network", "wifi_mode", 0)
    add("network", "wifi_rate", 0)
    add("network", "owner_mac", "00:00:00:00:00:00")

    add("pic", "ultrasound_freq", 8)
    add("pic", "ultrasound_watchdog", 3)
    fixed("pic", "pic_version", 184877090)

    add("video", "codec_fps", 30, session)
    add("video", "video_codec", 0x81, session)
    add("video", "video_slices", 0)
    add("video", "video_live_socket", 0)
    add("video", "bitrate", 1000, appli)
    add("video", "max_bitrate", 1000, session)
    add("video", "bitrate_ctrl_mode", 0, appli)
    add("video", "bitrate_storage", 4000, appli)
    add("video", "video_channel", 0, session)
    add("video", "video_on_usb", True)
    add("video", "video_file_index", 1)

    add("leds", "leds_anim", "0,0,0")

    add("detect", "enemy_colors", 1)
    add("detect", "groundstripe_colors", 16)
    add("detect", "enemy_without_shell", 0)
    add("detect", "detect_type", 3, session)
    add("detect", "detections_select_h", 0, session)
    add("detect", "detections_select_v_hsync", 0, session)
    add("detect", "detections_select_v", 0, session)

    add("syslog", "output", 7)
    add("syslog", "max_size", 102400)
    add("syslog", "nb_files", 5)

    add("userbox", "userbox_cmd", "0")
    add("gps", "latitude", 500.0)
    add("gps", "longitude", 500.0)
    add("gps", "altitude", 0.0)

    add("custom", "application_id", DEFAULT_ID, appli)
    add("custom", "application_desc", "Default application configuration", appli)
    add("custom", "profile_id", DEFAULT_ID, user)
    add("custom", "profile_desc", "Default profile configuration", user)
    add("custom", "session_id", DEFAULT_ID, session)
    add("custom", "session_desc", "Default session configuration", session)
    return tuple(table)


KEYS = {key.key: key for key in _keys()}  # by "section:name", in readback order

# Active limits that `control:outdoor` switches; each has twins with the prefix indoor_ and outdoor_.
FLIGHT_LIMITS = ("euler_angle_max", "control_vz_max", "control_yaw")


# --- values ------------------------------------------------------------------------------------------------------
def format_value(kind, value):
    """Wire text of a typed value. ConfigError when the value does not fit the kind."""
    try:
        if kind is Kind.BOOL:
            return "TRUE" if value else "FALSE"
        if kind is Kind.INT:
            return "%d" % value
        if kind is Kind.FLOAT:
            if not math.isfinite(value):
                raise ConfigError("a configuration float must be finite, got %r" % (value,))
            return "%f" % value
        if kind is Kind.VECTOR:
            return "{ %s }" % " ".join("%.7e" % x for x in value)
    except (TypeError, OverflowError):
        raise ConfigError("%r is not of the kind %s" % (value, kind.value)) from None
    except ConfigError:
        raise
    except ValueError:  # "%d" % nan
        raise ConfigError("%r is not of the kind %s" % (value, kind.value)) from None
    return str(value)


def parse_value(kind, text):
    """Typed value of a wire text, tolerant in spelling (TRUE/true/1, "3000.0" for an int). ConfigError otherwise."""
    text = text.strip()
    try:
        if kind is Kind.BOOL:
            lowered = text.lower()
            if lowered in ("true", "false"):
                return lowered == "true"
            return float(text) != 0.0
        if kind is Kind.INT:
            try:
                return int(text)
            except ValueError:
                return int(float(text))
        if kind is Kind.FLOAT:
            value = float(text)
            if not math.isfinite(value):
                raise ValueError(text)
            return value
        if kind is Kind.VECTOR:
            return tuple(float(x) for x in text.strip("{} \t").split())
    except (ValueError, OverflowError):
        raise ConfigError("%r is not a configuration value of the kind %s" % (text, kind.value)) from None
    if any(c in text for c in "\0\r\n"):
        raise ConfigError("%r cannot stand in a line of the configuration text" % (text,))
    return text


# --- text on TCP 5559 --------------------------------------------------------------------------------------------
def encode_config_text(values):
    """Readback text: values maps "section:name" to wire text, in order. Bytes with the zero byte at the end."""
    lines = ["%s = %s\n" % item for item in values.items()]
    return "".join(lines).encode("ascii", "replace") + b"\0"


# --- multi-configuration ids -----------------------------------------------------------------------------------------
def crc_id(name):
    """8 hexadecimal digits: CRC-32 of the name."""
    return "%08x" % (zlib.crc32(name.encode("utf-8")) & 0xFFFFFFFF)


def user_id(user_name):
    """Id of a user profile."""
    return crc_id(user_name)


def application_id(application_name, sdk_version=SDK_VERSION):
    """Id of an application profile."""
    return crc_id("%s:%s" % (application_name, sdk_version))


def is_id(text):
    """True for 8 lower-case hexadecimal digits."""
    return _ID.match(text) is not None


ID_SECTIONS = ("applis", "profiles", "sessions")


def encode_custom_ids(applications, profiles, sessions):
    """Answer to CTRL 6: each argument maps id to description. Bytes with the zero byte at the end."""
    parts = ["[common]\r"]
    for section, ids in zip(ID_SECTIONS, (applications, profiles, sessions)):
        parts.append("[%s]\r" % section)
        parts.extend("%s,%s\r" % item for item in ids.items())
    return "".join(parts).encode("ascii", "replace") + b"\0"
