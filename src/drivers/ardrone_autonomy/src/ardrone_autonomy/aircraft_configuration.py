"""Which configuration is written to the aircraft, and in which order.

Every key that is set as a parameter is written.  The original driver left out values that equal the SDK's defaults; but
common keys stay in the aircraft from one client to the next, so it would keep flying with, say, the outdoor limits that
a phone app has set.  The driver's own values are written where they differ from the SDK's defaults.

`control:outdoor` comes first, because switching it copies the indoor_ or outdoor_ limits over the active ones; then the
other common keys, then the keys that belong to our profiles.  The profiles of earlier runs are deleted first, so that
none of their values survives.
"""

from ardrone_autonomy.protocol import at, config
from ardrone_autonomy.protocol.config import Category
from ardrone_autonomy.protocol.navdata import ALL_OPTIONS_MASK

APPLICATION_NAME = "ardrone_driver"  # names both the application and the user profile
APPLICATION_ID = config.crc_id("%s:%s" % (APPLICATION_NAME, config.SDK_VERSION))
USER_ID = config.crc_id(APPLICATION_NAME)

MAX_STRING_CHARS = 127

VIDEO_CODEC_LIVE = 0x81  # H.264, 360p
VIDEO_CODEC_RECORD = 0x82  # 360p to the client, 720p to the USB key

# Values that the driver writes unless a parameter sets another; all other keys stay as they are in the aircraft. An
# aircraft without commands keeps its last tilt for com_watchdog seconds (a whole number): in the SDK's 2 s it can leave
# the net.
DRIVER_DEFAULTS = {
    "max_bitrate": 4000,
    "navdata_options": ALL_OPTIONS_MASK,
    "navdata_demo": False,
    "com_watchdog": 1,
}

# Parameters of the driver that reach the aircraft, by bare name.
WRITABLE_KEYS = {key.name: key for key in config.KEYS.values() if not key.read_only and key.section != "custom"}


def wire_text(key, value):
    """Return the wire text of a parameter value for one ConfigKey.

    value: number, bool or string from the parameter server.  Numbers are read as floats and converted to the kind of
    the key; strings are cut at MAX_STRING_CHARS.  ValueError when that is not possible.
    """
    try:
        if key.kind is str:
            text = str(value)[:MAX_STRING_CHARS]
        else:
            text = config.format_value(key.kind, float(value))
        at.encode("CONFIG", 1, key.key, text)  # raises if no command can carry it
    except (ValueError, TypeError) as error:
        raise ValueError(
            "parameter ~%s: %r cannot be written as %s (%s): correct it in the launch file"
            % (key.name, value, key.kind.__name__, error)
        ) from None
    return text


def wanted_texts(parameters):
    """Return {bare name: wire text} of all keys to write.

    parameters: {bare name: value}, all written whatever their value; names that are not keys are skipped.  ValueError
    on a bad value.
    """
    values = {**DRIVER_DEFAULTS, **parameters}
    return {name: wire_text(WRITABLE_KEYS[name], value) for name, value in values.items() if name in WRITABLE_KEYS}


def setup_writes(texts, session_id):
    """Return all configuration writes after a connection, in order: list of ("section:name", wire text).

    texts: from wanted_texts.  session_id: 8 hexadecimal digits, new for every run.
    """
    writes = [
        ("general:navdata_demo", texts["navdata_demo"]),  # makes the aircraft leave its bootstrap state
        ("custom:session_id", "-all"),
        ("custom:profile_id", "-" + USER_ID),
        ("custom:application_id", "-" + APPLICATION_ID),
        ("custom:session_id", session_id),
        ("custom:profile_id", USER_ID),
        ("custom:application_id", APPLICATION_ID),
        # From here on the ids sent before each write are the active ones: the aircraft ignores writes with other ids
        ("custom:session_desc", "session %s" % session_id),
        ("custom:profile_desc", APPLICATION_NAME),
        ("custom:application_desc", "%s:%s" % (APPLICATION_NAME, config.SDK_VERSION)),
    ]
    names = [name for name in WRITABLE_KEYS if name in texts and name != "navdata_demo"]
    names.sort(key=lambda name: (name != "outdoor", WRITABLE_KEYS[name].category is not Category.COMMON))
    writes.extend((WRITABLE_KEYS[name].key, texts[name]) for name in names)
    return writes
