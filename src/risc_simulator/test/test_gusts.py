"""Gusts: velocity of the air, and effect on a vehicle."""

import math
from dataclasses import replace

import numpy as np
import pytest

from risc_lab.lab import load_fleet, load_templates, load_vehicle_type
from risc_lab.lab.yaml_reader import package_file
from risc_simulator.models.gusts import Gusts
from risc_simulator.world import World

FLEET = load_fleet(package_file("..", "launch/fleets/ardrones3.yaml"))
STEP_S = 0.005


def blown(gusts, seconds=400.0, **plant):
    """((k, 3, n) velocity of the air [m/s] in every step, plants of the n vehicles, which stand on the floor)."""
    world = World(FLEET, {"ardrone": load_vehicle_type("ardrone")}, load_templates(), 3, True, gusts, STEP_S)
    for vehicle in world.vehicles.values():
        vehicle.change_plant(**plant)
    wind_m_s = []
    for k in range(round(seconds / STEP_S)):
        world.step_to((k + 1) * STEP_S)
        wind_m_s.append(world._u[6:9].copy())
    return np.array(wind_m_s), [vehicle.plant for vehicle in world.vehicles.values()]


def test_their_spread_and_correlation():
    """Also for vehicles whose plant was changed after the draw; 400 s are 400 times the two-sided correlation time."""
    wind_m_s, plants = blown(Gusts(push_m_s2=0.1, time_s=0.5), drag_n_s_m=0.25)
    for i, plant in enumerate(plants):
        push_m_s2 = wind_m_s[:, :, i] * plant.drag_n_s_m / plant.mass_kg
        assert push_m_s2.std(axis=0) == pytest.approx([0.1] * 3, rel=0.12)
        later = round(0.5 / STEP_S)
        along = (push_m_s2[later:] * push_m_s2[:-later]).mean(axis=0) / push_m_s2.var(axis=0)
        assert along == pytest.approx([math.exp(-1.0)] * 3, abs=0.15)
    assert len({plant.mass_kg for plant in plants}) == 3
    assert np.abs(np.corrcoef(wind_m_s[:, 0].T) - np.eye(3)).max() < 0.2, "each vehicle has its own"


def test_a_push_is_what_accelerates_a_vehicle():
    """Two worlds that differ only in the gusts: their velocities differ by the push times the step."""
    kinds = {"ardrone": load_vehicle_type("ardrone")}
    calm, gusty = (World(FLEET, kinds, load_templates(), 3, True, gusts) for gusts in (False, Gusts(push_m_s2=0.1)))
    for world in (calm, gusty):
        for vehicle in world.vehicles.values():
            vehicle.fly_at((*vehicle.state.position_m[:2], 1.0))
        world.step_to(STEP_S)
    plants = [vehicle.plant for vehicle in gusty.vehicles.values()]
    wind_m_s = gusty._u[6:9].T * [1.0, -1.0, 1.0]
    push_m_s2 = wind_m_s * [[plant.drag_n_s_m / plant.mass_kg] for plant in plants]
    np.testing.assert_allclose((gusty.truth() - calm.truth())[:, 3:6], STEP_S * push_m_s2, rtol=0.03, atol=1e-9)


def test_the_usual_ones_are_those_of_true():
    (same, _), (other, _) = (blown(gusts, 1.0) for gusts in (True, Gusts()))
    np.testing.assert_array_equal(same, other)
    assert not blown(False, 0.1)[0].any()


def test_without_drag_no_air_pushes():
    kind = replace(load_vehicle_type("ardrone"), drag_n_s_m=0.0)
    World(FLEET, {"ardrone": kind}, load_templates(), gusts=True)
    with pytest.raises(ValueError, match="drag"):
        World(FLEET, {"ardrone": kind}, load_templates(), gusts=Gusts(push_m_s2=0.1))
    for wrong in {"push_m_s2": -0.1}, {"time_s": 0.0}, {"speed_m_s": (0.1, 0.1)}:
        with pytest.raises(ValueError, match=next(iter(wrong))):
            Gusts(**wrong)
