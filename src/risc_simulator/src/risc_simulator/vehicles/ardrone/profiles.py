"""Configuration as the aircraft keeps it: values per category and id, and the side effects of a write."""

from ardrone_autonomy.protocol import config
from ardrone_autonomy.protocol.config import Category

# Accepted range by key; values outside are clipped.  control_yaw: the guide recommends at least 0.7 rad/s, but lower
# values are in use and accepted.
RANGES = {
    "control:euler_angle_max": (0.0, 0.52),
    "control:control_vz_max": (200.0, 2000.0),
    "control:control_yaw": (0.0, 6.11),
    "control:altitude_max": (500, 100000),
    "control:altitude_min": (50, 100000),
}
RANGES.update(
    {
        "control:%s_%s" % (mode, name): RANGES["control:" + name]
        for mode in ("indoor", "outdoor")
        for name in config.FLIGHT_LIMITS
    }
)

_ID_KEYS = {
    "custom:application_id": Category.APPLICATION,
    "custom:profile_id": Category.USER,
    "custom:session_id": Category.SESSION,
}
_DESCRIPTION_KEYS = {
    Category.APPLICATION: "custom:application_desc",
    Category.USER: "custom:profile_desc",
    Category.SESSION: "custom:session_desc",
}

MAX_PROFILES = 64  # of each category: a client could name new ids without end
NO_LIMIT_MM = 100000  # altitude_max of "no limit"


class ConfigurationStore:
    """All values of one aircraft.

    COMMON keys have one value.  APPLICATION, USER and SESSION keys have one per id; the id in force is switched by
    writing custom:application_id, custom:profile_id, custom:session_id (a new id starts from the SDK defaults, a
    leading minus deletes, "-all" deletes all).  Write with the ids of the preceding CONFIG_IDS, or None without one.
    """

    def __init__(self, serial="PS721000000000000", name="My ARDrone"):
        """serial, name: of this aircraft; all else begins with the SDK defaults."""
        self._common = {key: spec.default for key, spec in config.KEYS.items() if spec.category is Category.COMMON}
        self._common.update({"general:drone_serial": serial, "general:ardrone_name": name})
        self._profiles = {category: {config.DEFAULT_ID: {}} for category in _DESCRIPTION_KEYS}  # values by key, by id
        self._current = dict.fromkeys(_DESCRIPTION_KEYS, config.DEFAULT_ID)

    @property
    def current_ids(self):
        """(session, user, application) ids in force, in the order of CONFIG_IDS."""
        return (self._current[Category.SESSION], self._current[Category.USER], self._current[Category.APPLICATION])

    def get(self, key):
        """Typed value in force. KeyError for an unknown key."""
        spec = config.KEYS[key]
        if spec.category is Category.COMMON:
            return self._common[key]
        if key in _ID_KEYS:
            return self._current[_ID_KEYS[key]]
        return self._profiles[spec.category][self._current[spec.category]].get(key, spec.default)

    def write(self, key, text, ids=None):
        """Obey one CONFIG command.

        key, text: as on the wire.  ids: (session, user, application) of the CONFIG_IDS in front, None without.
        Returns True when a value was written, False when the write was ignored: unknown or read-only key, value that
        does not parse, ids that are not those in force (for keys that are kept per id).
        """
        key = key.strip().lower()
        spec = config.KEYS.get(key)
        if spec is None or spec.read_only:
            return False
        if key in _ID_KEYS:
            return self._select(_ID_KEYS[key], text.strip().lower())
        try:
            value = config.parse_value(spec.kind, text)
        except config.ConfigError:
            return False
        if key in RANGES:
            low, high = RANGES[key]
            value = min(high, max(low, value))
        if (
            spec.category is not Category.COMMON
            and ids is not None
            and tuple(i.lower() for i in ids) != self.current_ids
        ):
            return False
        self._set(spec, value, to_default_profile=ids is None)
        self._side_effects(spec, value, to_default_profile=ids is None)
        return True

    def _set(self, spec, value, to_default_profile=False):
        if spec.category is Category.COMMON:
            self._common[spec.key] = value
        else:
            identity = config.DEFAULT_ID if to_default_profile else self._current[spec.category]
            self._profiles[spec.category][identity][spec.key] = value

    def _side_effects(self, spec, value, to_default_profile):
        if spec.key == "control:outdoor":
            mode = "outdoor" if value else "indoor"
            for name in config.FLIGHT_LIMITS:
                self._set(config.KEYS["control:" + name], self.get("control:%s_%s" % (mode, name)))
        elif spec.section == "control" and spec.name in config.FLIGHT_LIMITS:
            mode = "outdoor" if self.get("control:outdoor") else "indoor"
            self._set(config.KEYS["control:%s_%s" % (mode, spec.name)], value, to_default_profile)

    def _select(self, category, text):
        profiles = self._profiles[category]
        if text.startswith("-"):
            doomed = [i for i in profiles if i != config.DEFAULT_ID] if text == "-all" else [text[1:]]
            for identity in doomed:
                if identity == config.DEFAULT_ID or identity not in profiles:
                    return False
                del profiles[identity]
                if self._current[category] == identity:
                    self._current[category] = config.DEFAULT_ID
            return True
        if not config.is_id(text) or (text not in profiles and len(profiles) >= MAX_PROFILES):
            return False
        profiles.setdefault(text, {_DESCRIPTION_KEYS[category]: ""})
        self._current[category] = text
        return True

    def text(self):
        """Readback for CTRL 4, bytes (see config.encode_config_text)."""
        return config.encode_config_text(
            {key: config.format_value(spec.kind, self.get(key)) for key, spec in config.KEYS.items()}
        )

    def custom_ids_text(self):
        """Readback for CTRL 6, bytes."""
        descriptions = [
            {identity: values.get(key, config.KEYS[key].default) for identity, values in self._profiles[kind].items()}
            for kind, key in _DESCRIPTION_KEYS.items()
        ]
        return config.encode_custom_ids(*descriptions)
