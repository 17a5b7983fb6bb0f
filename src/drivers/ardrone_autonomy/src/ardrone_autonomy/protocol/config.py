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


class ConfigError(ValueError):
    """A value or text that does not fit the configuration format."""


# Where a value is kept.
Category = Enum("Category", "COMMON APPLICATION USER SESSION")


class ConfigKey(namedtuple("ConfigKey", "section name default category read_only")):
    """One key; default is typed (bool, int, float, str, tuple of floats)."""

    __slots__ = ()

    @property
    def key(self):
        """section:name"""
        return "%s:%s" % (self.section, self.name)

    @property
    def kind(self):
        """Type of the key's values."""
        return type(self.default)


def _keys():
    table = []

    def add(section, category=Category.COMMON, read_only=False, **defaults):
        table.extend(ConfigKey(section, name, default, category, read_only) for name, default in defaults.items())

    common, appli, user, session = Category.COMMON, Category.APPLICATION, Category.USER, Category.SESSION
    # Units: angles rad, control_vz_max mm/s, control_yaw rad/s, altitudes mm, times s, bit rates kbit/s, vbat mV.
    add("general", common, True, num_version_config=1, num_version_mb=34, num_version_soft="2.4.8")
    add("general", common, True, drone_serial="PS721000000000000", soft_build_date="2014-01-01 00:00")
    for motor in range(1, 5):
        for what, version in (("soft", "1.43"), ("hard", "6.0"), ("supplier", "1.1")):
            add("general", common, True, **{"motor%d_%s" % (motor, what): version})
    add("general", ardrone_name="My ARDrone")
    add("general", common, True, flying_time=0)
    add("general", navdata_demo=False)
    add("general", appli, navdata_options=65537)
    add("general", com_watchdog=2, video_enable=True, vision_enable=True)
    add("general", common, True, vbat_min=9000)

    add("control", common, True, accs_offset=(-2000.0, 2000.0, 2000.0))
    add("control", common, True, accs_gains=(1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0))
    add("control", common, True, gyros_offset=(0.0, 0.0, 0.0), gyros_gains=(0.001, -0.001, -0.001))
    add("control", appli, control_level=0)
    add("control", user, euler_angle_max=0.209440, control_iphone_tilt=0.349066)
    add("control", user, control_vz_max=700.0, control_yaw=1.745329)
    add("control", outdoor=False, flight_without_shell=False, autonomous_flight=False)
    add("control", user, manual_trim=False)
    add("control", altitude_max=3000, altitude_min=50)
    add("control", user, indoor_euler_angle_max=0.209440, indoor_control_vz_max=700.0, indoor_control_yaw=1.745329)
    add("control", user, outdoor_euler_angle_max=0.349066, outdoor_control_vz_max=1000.0, outdoor_control_yaw=3.490659)
    add("control", session, flying_mode=0, hovering_range=1000)
    add("control", flight_anim="0,0", travelling_mode="0,0,0,0,0,0,0,0,0,0", travelling_enable=False)

    add("network", ssid_single_player="ardrone2_000000", ssid_multi_player="ardrone2_000000")
    add("network", wifi_mode=0, wifi_rate=0, owner_mac="00:00:00:00:00:00")
    add("pic", ultrasound_freq=8, ultrasound_watchdog=3)
    add("pic", common, True, pic_version=184877090)

    add("video", session, codec_fps=30, video_codec=0x81)
    add("video", video_slices=0, video_live_socket=0)
    add("video", appli, bitrate=1000)
    add("video", session, max_bitrate=1000)
    add("video", appli, bitrate_ctrl_mode=0, bitrate_storage=4000)
    add("video", session, video_channel=0)
    add("video", video_on_usb=True, video_file_index=1)
    add("leds", leds_anim="0,0,0")
    add("detect", enemy_colors=1, groundstripe_colors=16, enemy_without_shell=0)
    add("detect", session, detect_type=3, detections_select_h=0, detections_select_v_hsync=0, detections_select_v=0)

    add("syslog", output=7, max_size=102400, nb_files=5)
    add("userbox", userbox_cmd="0")
    add("gps", latitude=500.0, longitude=500.0, altitude=0.0)

    add("custom", appli, application_id=DEFAULT_ID, application_desc="Default application configuration")
    add("custom", user, profile_id=DEFAULT_ID, profile_desc="Default profile configuration")
    add("custom", session, session_id=DEFAULT_ID, session_desc="Default session configuration")
    return table


KEYS = {key.key: key for key in _keys()}  # by "section:name", in readback order

# Active limits that `control:outdoor` switches; each also exists with the prefixes indoor_ and outdoor_.
FLIGHT_LIMITS = ("euler_angle_max", "control_vz_max", "control_yaw")


# --- values ------------------------------------------------------------------------------------------------------
def format_value(kind, value):
    """Return the wire text of a value: TRUE, 12, 0.500000, { 1.0000000e+00 ... }. ConfigError on a wrong type."""
    try:
        if kind is bool:
            return "TRUE" if value else "FALSE"
        if kind is int:
            return "%d" % value
        if kind is float and math.isfinite(value):
            return "%f" % value
        if kind is tuple:
            return "{ %s }" % " ".join("%.7e" % x for x in value)
        if kind is str:
            return str(value)
    except (TypeError, ValueError, OverflowError):  # refused below, like values that are not finite
        pass
    raise ConfigError("%r is not of type %s" % (value, kind.__name__))


def parse_value(kind, text):
    """Typed value of a wire text, tolerant in spelling (TRUE/true/1, "3000.0" for an int). ConfigError otherwise."""
    text = text.strip()
    try:
        if kind is tuple:
            return tuple(float(x) for x in text.strip("{} \t").split())
        if kind is str:
            if any(c in text for c in "\0\r\n"):
                raise ValueError("it contains a line break or a quote")
            return text
        if kind is bool and text.lower() in ("true", "false"):
            return text.lower() == "true"
        if kind is int and text.lstrip("+-").isdecimal():
            return int(text)  # of any size
        number = float(text)
        if not math.isfinite(number):
            raise ValueError("it must be finite")
        return kind(number)
    except ValueError as error:
        raise ConfigError("%r is not a configuration value of type %s: %s" % (text, kind.__name__, error)) from None


# --- text on TCP 5559 --------------------------------------------------------------------------------------------
def encode_config_text(values):
    """Encode the readback text: values maps "section:name" to wire text, in order. Bytes that end with a zero byte."""
    return "".join("%s = %s\n" % item for item in values.items()).encode("ascii", "replace") + b"\0"


# --- multi-configuration ids -----------------------------------------------------------------------------------------
def crc_id(name):
    """Return the id of a user or application name: CRC-32 as 8 hexadecimal digits, see the top of this file."""
    return "%08x" % (zlib.crc32(name.encode("utf-8")) & 0xFFFFFFFF)


def is_id(text):
    """True for 8 lower-case hexadecimal digits."""
    return re.fullmatch("[0-9a-f]{8}", text) is not None


def encode_custom_ids(applications, profiles, sessions):
    """Encode the answer to CTRL 6: each argument maps id to description. Bytes that end with a zero byte."""
    parts = ["[common]\r"]
    for section, ids in (("applis", applications), ("profiles", profiles), ("sessions", sessions)):
        parts.append("[%s]\r" % section)
        parts.extend("%s,%s\r" % item for item in ids.items())
    return "".join(parts).encode("ascii", "replace") + b"\0"
