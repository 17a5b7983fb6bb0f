"""Fast courses offline: allowed ones are flown well, and vehicles would leave the refused ones."""

import pathlib
from dataclasses import replace

import numpy as np
import pytest

from risc_control import feasibility
from risc_control.controllers import default_params
from risc_experiments.offline import Flight, fly
from risc_lab.lab.yaml_reader import package_file

LAUNCH = pathlib.Path(package_file("..", "launch"))
EIGHT, LARGE = str(LAUNCH / "waypoints/eight_4m.yaml"), str(LAUNCH / "fleets/large3.yaml")
SMALL_EIGHT = str(LAUNCH / "waypoints/eight_2m.yaml")
SMALL8 = {"length_m": 1.0, "width_m": 0.5, "height_m": 1.2}


@pytest.mark.parametrize(
    ("speed", "rmse_m"), [("0.76", 0.010), pytest.param("1.5", 0.020, marks=pytest.mark.release), ("2.18", 0.030)]
)
def test_the_eight_in_the_large_net(speed, rmse_m):
    """A top speed of 2.18 m/s is 1.5 m/s on average."""
    result = fly(Flight(EIGHT, vehicles=1, fleet=LARGE, speed=speed, duration_s=12.0))
    assert result.rmse_m.max() < rmse_m
    assert not result.safety and not any(result.landed)
    speeds_m_s = np.linalg.norm(np.diff(result.reference_m[:, 0], axis=0), axis=1) / np.diff(result.times_s)
    assert speeds_m_s[result.judged[1:]].max() == pytest.approx(float(speed), rel=0.01)


def test_a_course_that_is_refused_is_left_when_it_is_flown_all_the_same(monkeypatch):
    wanted = Flight("flat8", vehicles=1, fleet=LARGE, course=SMALL8, duration_s=12.0)
    allowed = [fly(replace(wanted, seed=seed, speed="1.6")) for seed in (1, 2, 3, 4)]
    assert np.median([result.rmse_m[0] for result in allowed]) < 0.05
    assert max(result.saturated for result in allowed) < 0.1
    beyond = replace(wanted, speed="2.3")
    with pytest.raises(ValueError, match="'flat8' .*'ardrone': .* --speed 1.6"):
        fly(beyond)
    monkeypatch.setattr(feasibility, "check_course", lambda *_: None)
    result = fly(beyond)
    assert any(result.landed) or result.rmse_m[0] > 5.0 * allowed[0].rmse_m[0]


def test_much_of_the_error_at_speed_was_the_lag_of_the_velocities():
    """The small eight on the nominal plant without noise: 8 mm with the velocities of the controller's observer, 15 mm
    with the estimator's.
    """
    flight = Flight(SMALL_EIGHT, vehicles=1, speed="1.5", perturbed=False, noise=False, duration_s=12.0)
    without = replace(default_params("differential_flatness"), push_m_s3=0.0)
    assert fly(flight).rmse_m.max() < 0.6 * fly(replace(flight, params=without)).rmse_m.max()
