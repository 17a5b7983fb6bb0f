"""Readings of the vehicles' own sensors: units, axes, signs."""

from types import SimpleNamespace

import numpy as np

from risc_estimation.sensors import REGISTRY


def test_navdata_of_an_ardrone_become_si_in_body_axes():
    fields = {"rotX": 10.0, "rotY": -20.0, "rotZ": 30.0, "vx": 100.0, "vy": 200.0, "vz": 300.0, "altd": 1500}
    kind = REGISTRY.module("ardrone")
    found = kind.readings(SimpleNamespace(ax=0.0, ay=0.0, az=0.0, **fields))
    assert set(found) == {"attitude", "velocity", "height"}, "an option that is not sent reads 0"
    np.testing.assert_allclose(np.degrees(found["attitude"]), (10.0, 20.0, -30.0))  # right down, nose up, clockwise
    np.testing.assert_allclose(found["velocity"], (0.1, -0.2, -0.3))  # forward, right, down
    np.testing.assert_allclose(found["height"], (1.5,))
    at_rest = kind.readings(SimpleNamespace(ax=0.0, ay=0.0, az=1.0, **fields))
    np.testing.assert_allclose(at_rest["specific_force"], (0.0, 0.0, -9.80665))
