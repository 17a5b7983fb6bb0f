"""A battery that empties at a steady rate, which depends on what is switched on."""

GROUND_LOAD = 0.1  # computer and radio alone, as a fraction of the load in flight


class Battery:
    """Full at time 0. load: fraction of the load in flight; 1 empties it in life_s."""

    def __init__(self, life_s):
        self._life_s, self._load = life_s, GROUND_LOAD
        self._pct, self._time_s = 100.0, 0.0

    @property
    def drain_pct_s(self):
        """Discharge rate [%/s]."""
        return 100.0 * self._load / self._life_s

    def pct(self, time_s):
        """Charge in percent, never below 0."""
        return max(0.0, self._pct - 100.0 * (time_s - self._time_s) / (self._life_s / self._load))

    def set_pct(self, pct, time_s):
        """Set the charge [%], limited to 0 to 100."""
        self._pct, self._time_s = min(100.0, max(0.0, pct)), time_s

    def set_load(self, load, time_s):
        """Set the load from now on."""
        self.set_pct(self.pct(time_s), time_s)
        self._load = load
