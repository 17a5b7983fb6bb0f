"""Parameters by which differential_flatness learns nothing: of a vehicle that does not obey, e.g. stands in the air."""

_KEYS = "level_rad_s", "climb_level_m_s2", "gain_spread", "lag_spread_s", "push_m_s3", "drag_spread_1_s"
UNLEARNT = dict.fromkeys(_KEYS, 0.0)
