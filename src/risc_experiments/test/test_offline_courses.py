"""Fast courses offline: what is allowed is flown well, and what is refused would have been left."""

import pathlib

import numpy as np
import pytest

from risc_control import feasibility
from risc_experiments import offline
from risc_experiments.offline import Flight, fly
from risc_lab.lab.yaml_reader import package_file
from risc_lab.states import S, States
from risc_simulator.world import World

LAUNCH = pathlib.Path(package_file("..", "launch"))
EIGHT, LARGE = str(LAUNCH / "waypoints/eight_4m.yaml"), str(LAUNCH / "fleets/large3.yaml")
SMALL_EIGHT = str(LAUNCH / "waypoints/eight_2m.yaml")
SMALL8 = {"length_m": 1.0, "width_m": 0.5, "height_m": 1.2}


@pytest.mark.parametrize(("speed", "rmse_m"), [("0.76", 0.010), ("1.5", 0.020), ("2.18", 0.030)])
def test_the_eight_in_the_large_net(speed, rmse_m):
    """2.18 m/s at most are 1.5 m/s on average."""
    result = fly(Flight(EIGHT, vehicles=1, fleet=LARGE, speed=speed, duration_s=12.0))
    assert result.rmse_m.max() < rmse_m
    assert not result.safety and not any(result.landed)
    speeds_m_s = np.linalg.norm(np.diff(result.reference_m[:, 0], axis=0), axis=1) / np.diff(result.times_s)
    assert speeds_m_s[result.judged[1:]].max() == pytest.approx(float(speed), rel=0.01)


def test_a_course_that_is_refused_is_left_when_it_is_flown_all_the_same(monkeypatch):
    wanted = Flight("flat8", vehicles=1, seed=2, fleet=LARGE, course=SMALL8, duration_s=12.0)
    allowed = fly(Flight(**{**vars(wanted), "speed": "1.6"}))
    assert allowed.rmse_m.max() < 0.05 and allowed.saturated < 0.1
    beyond = Flight(**{**vars(wanted), "speed": "2.3"})
    with pytest.raises(ValueError, match="'flat8' cannot be flown by type 'ardrone': .*at --speed 1.6"):
        fly(beyond)
    monkeypatch.setattr(feasibility, "check_course", lambda *_: None)
    result = fly(beyond)
    assert any(result.landed) or result.rmse_m.max() > 5.0 * allowed.rmse_m.max()


def test_more_than_half_of_the_error_at_speed_is_the_lag_of_the_velocities(monkeypatch):
    """Of the small eight on the nominal plant without noise: with true velocities it is 7 mm, not 17 mm."""
    flight = Flight(SMALL_EIGHT, vehicles=1, speed="1.5", perturbed=False, noise=False, duration_s=12.0)
    estimated, worlds = fly(flight), []

    def make_world(*args, **options):
        worlds.append(World(*args, **options))
        return worlds[-1]

    def with_true_velocities(visible, x):
        x = x.copy()
        x[:, S.U : S.PHI] = worlds[-1].truth()[:, S.U : S.PHI]
        return States(visible, x)

    monkeypatch.setattr(offline, "World", make_world)
    monkeypatch.setattr(offline, "States", with_true_velocities)
    assert fly(flight).rmse_m.max() < 0.5 * estimated.rmse_m.max()
