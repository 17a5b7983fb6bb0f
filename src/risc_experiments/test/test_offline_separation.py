"""Vehicles near each other, whole flights offline: none flies into one that stops, and none holds without reason."""

import math
import pathlib
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import yaml

from risc_control import vehicle_pilot
from risc_control.hover import Hover
from risc_control.safety import Rule, SafetyLimits
from risc_control.separation import Separation
from risc_control.trajectories import COURSES, make_course, minimum_separation
from risc_control.trajectory_manager import make_manager
from risc_experiments import offline
from risc_experiments.fleets import default_fleet
from risc_experiments.offline import Flight, Loss, fly, fly_all
from risc_lab.lab import load_vehicle_type
from risc_lab.states import S
from risc_simulator.faults import parse_fault

LIMITS = SafetyLimits()
OFF = {"separation_m": 0.0}
CONTACT_M = 0.5
more = partial(pytest.param, marks=pytest.mark.release)
MULTI_MACHINE = pathlib.Path(__file__).parents[3] / "launch/Multi_Machine_Experiment.launch"


@pytest.mark.parametrize(
    ("course", "vehicles", "what", "seed", "limit_m"),
    [
        ("circle", 5, "state", 3, LIMITS.separation_m),
        ("circles3", 3, "laptop", 13, LIMITS.separation_m),
        more("circle", 5, "state", 1, LIMITS.separation_m),
        more("circle", 5, "controls", 3, LIMITS.separation_m),
        # it drifts for a second by its last command, regardless of the others: one of thirty seeds collides
        more("circles3", 3, "laptop", 14, CONTACT_M),
        more("circles3", 3, "laptop", 19, CONTACT_M),
    ],
)
def test_nobody_flies_into_one_that_stops(course, vehicles, what, seed, limit_m):
    stops = Flight(
        course, vehicles=vehicles, seed=seed, duration_s=11.0, loss=Loss(seed % vehicles, what, 1.0), node=OFF
    )
    with pytest.raises(RuntimeError, match="collided"):
        fly(stops)
    result = fly(replace(stops, node={}))
    assert result.closest_m > limit_m
    assert all(result.landed)


def test_states_that_are_only_late_land_nobody(monkeypatch):
    """States are about as old as a vehicle node accepts, and often a little older: then it holds for a moment."""
    late = Flight("circles3", seed=5, duration_s=8.0, psi_deg=70.0, faults=(parse_fault("delay:0.09,duration_s=10@1"),))
    result = fly(late)
    rules = [said.rule for said in result.levels]
    assert rules.count(Rule.STATE) > 100 and Rule.SEPARATION not in rules and not any(result.landed)
    # the control arm: braked at once, they leave their courses, and hold and land because of each other
    monkeypatch.setattr(vehicle_pilot, "_WAITS_S", 0.0)
    assert Rule.SEPARATION in {said.rule for said in fly(late).levels}


@pytest.mark.parametrize("seed", [28, *(more(seed) for seed in (5, 20, 106, 182, 183, 210, 268, 307, 370, 395))])
def test_short_losses_one_after_another_bring_nobody_together(seed, monkeypatch):
    """Two AR.Drones and an IRIS+, as near as AR.Drones: after a loss of 0.1 s or more those behind catch up."""
    mixed = {"fleet": "launch/fleets/mixed3.yaml", "course": {"centre_m": 0.5}}
    fault = parse_fault("burst:0.1,duration_s=2@2")
    mixed = Flight("circles3", seed=seed, psi_deg=70.0 * seed, faults=(fault,), **mixed)
    result = fly(mixed)
    assert result.contacts == () and result.breaches == ()
    if seed == 28:  # the control arm: an IRIS+ is braked at once
        hold = Hover.command
        monkeypatch.setattr(Hover, "command", lambda self, *told, waits=False: hold(self, *told))
        assert fly(mixed).contacts


IRIS_M = load_vehicle_type("iris").wider_m


@pytest.mark.parametrize(
    ("types", "what", "seed", "limit_m"),
    [
        (("iris",) * 3, "controls", 4, LIMITS.separation_m + 2.0 * IRIS_M),
        more(("iris", "ardrone", "ardrone"), "controls", 9, LIMITS.separation_m + IRIS_M),
    ],
)
def test_wide_vehicles_keep_farther_from_one_that_stops(types, what, seed, limit_m, monkeypatch):
    """Its node does not announce the stop, as when its laptop is dead."""
    monkeypatch.setattr(Separation, "tell", lambda *_: None)
    stops = Flight("knot", vehicles=3, seed=seed, types=types, duration_s=9.5, loss=Loss(seed % 3, what, 1.0))
    result = fly(stops)
    assert result.closest_m > limit_m and all(result.landed)
    # the control arm: all are treated as AR.Drones
    monkeypatch.setattr(offline, "wider_m", lambda vehicles: {})
    assert fly(stops).closest_m < limit_m


@pytest.mark.release  # with AR.Drones: see below
@pytest.mark.parametrize("seed", range(1, 14))
def test_wide_vehicles_stop_as_soon_as_one_of_them_does(seed, monkeypatch):
    stops = Flight(
        "knot", vehicles=3, seed=seed, types=("iris",) * 3, duration_s=8.0, loss=Loss(seed % 3, "controls", 1.0)
    )
    assert fly(stops).closest_m > LIMITS.separation_m + 2.0 * IRIS_M
    if seed == 9:  # the control arm: no announcement
        monkeypatch.setattr(Separation, "tell", lambda *_: None)
        with pytest.raises(RuntimeError, match="collided"):
            fly(stops)


FIVE = ("controls", 5), ("controls", 8)  # these collide when nodes do not announce a stop
MORE = [(what, seed) for what in ("controls", "state") for seed in range(1, 16) if (what, seed) not in FIVE]


@pytest.mark.parametrize(("what", "seed"), [FIVE[0], more(*FIVE[1]), *(more(*one) for one in MORE)])
def test_five_on_a_circle_stop_as_soon_as_one_of_them_does(what, seed, monkeypatch):
    stops = Flight("circle", vehicles=5, seed=seed, duration_s=11.0, loss=Loss(seed % 5, what, 1.0))
    result = fly(stops)
    assert result.closest_m > LIMITS.separation_m and all(result.landed)
    if (what, seed) in FIVE:
        monkeypatch.setattr(Separation, "tell", lambda *_: None)  # the control arm: no announcement
        with pytest.raises(RuntimeError, match="collided"):
            fly(stops)


@pytest.mark.parametrize(("what", "vehicle"), [("state", 0), ("controls", 1), ("laptop", 2)])
def test_on_the_course_of_the_multi_machine_launch_the_others_fly_on(what, vehicle):
    options = re.search(r"'(\{.+?\})' if course == 'circles3'", MULTI_MACHINE.read_text()).group(1)
    course = {"trajectory": "circles3", "course": yaml.safe_load(options)}
    result = fly(Flight(**course, seed=vehicle + 1, duration_s=9.0, loss=Loss(vehicle, what, 1.0)))
    assert result.landed == tuple(i == vehicle for i in range(3))
    assert {name for _, name, _ in result.safety} <= {result.names[vehicle]}
    assert max(rmse for i, rmse in enumerate(result.rmse_m) if i != vehicle) < 0.02


@pytest.mark.parametrize(("seed", "vehicles", "psi_deg"), [(2, 4, 140.0), more(1, 3, None), more(3, 5, 210.0)])
def test_no_course_makes_anybody_hold(seed, vehicles, psi_deg):
    """From take-over to the course and on it."""
    flights = [
        Flight(name, vehicles=vehicles, seed=seed, psi_deg=psi_deg, duration_s=8.0)
        for name in COURSES
        if not (name == "quadrants" and vehicles > 4)
    ]
    for flight, result in zip(flights, fly_all(flights)):
        assert not isinstance(result, RuntimeError), result
        assert result.safety == (), flight


@pytest.mark.parametrize("vehicles", [3, 4, 5])
def test_neither_changes_of_the_course_nor_ways_home_make_anybody_hold(vehicles):
    """By the references alone, with the noise of motion capture: from each course to the next, and home."""
    names = [name for name in COURSES if not (name == "quadrants" and vehicles > 4)]
    fleet, rng = default_fleet(vehicles, names[0]), np.random.default_rng(vehicles)
    courses = [make_course(name, vehicles) for name in names]
    manager = make_manager(fleet.vehicles, courses[0])
    separation, visible = Separation(manager.names, LIMITS, manager.names), np.ones(vehicles, bool)
    for vehicle in fleet.vehicles:
        start_m = (*vehicle.start.position_m[:2], 1.0)
        manager.see(vehicle.template, start_m, (0.0, 0.0, 0.0), vehicle.start.yaw_rad)
        manager.set_autonomous(vehicle.template, True, 0.0)
    orders = [(lambda now_s, course=course: manager.set_course(course, now_s)) for course in [*courses[1:], courses[0]]]
    closest_m = math.inf
    for k, order in enumerate([*orders, manager.go_home, None]):
        for now_s in 27.3 * k + np.arange(0.0, 27.3, 0.05):
            derivatives = np.ascontiguousarray(manager.sample(now_s).derivatives[:3].transpose(1, 0, 2))
            states = np.zeros((vehicles, len(S)))
            states[:, S.X : S.U] = derivatives[:, 0, :3] + rng.normal(0.0, 0.01, (vehicles, 3))
            states[:, S.U : S.PHI] = derivatives[:, 1, :3] + rng.normal(0.0, 0.02, (vehicles, 3))
            separation.see(manager.names, visible, states, now_s)
            separation.refer(manager.names, derivatives, now_s)
            assert separation.look(now_s) == {}, now_s
            closest_m = min(closest_m, minimum_separation(derivatives[None, :, 0, :3]))
        if order is not None:
            order(27.3 * (k + 1))
    assert closest_m < 0.9, "they came near each other"
