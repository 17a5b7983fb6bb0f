"""Parameters with which differential_flatness learns nothing, for a vehicle that does not obey, e.g. stays in place."""

_KEYS = "level_rad_s", "climb_level_m_s2", "gain_spread", "lag_spread_s", "push_m_s3", "drag_spread_1_s"
UNLEARNT = dict.fromkeys(_KEYS, 0.0)
