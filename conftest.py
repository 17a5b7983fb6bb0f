"""For all tests: those that hypothesis makes up have no stopwatch, neither for an example nor for making it up."""

from hypothesis import HealthCheck, settings

settings.register_profile("no stopwatch", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("no stopwatch")
