"""The perturbed plant: how far vehicles are from their nominal type, and that draws belong to one vehicle only."""

import dataclasses

import numpy as np
import pytest

from risc_lab.compiled import record
from risc_lab.lab import load_vehicle_type
from risc_simulator.models import perturbed_plant as plant_module
from risc_simulator.models.perturbed_plant import draw_plant, fill_records, nominal_plant
from risc_simulator.models.quadrotor import QUADROTOR_FIELDS

ARDRONE = load_vehicle_type("ardrone")


def draws(count=4000):
    rng = np.random.default_rng(7)
    return [draw_plant(ARDRONE, rng) for _ in range(count)]


@pytest.mark.parametrize(
    "what, nominal, spread",
    [
        (lambda p: p.thrust_scale, 1.0, 0.03),
        (lambda p: p.mass_kg, ARDRONE.mass_kg, 0.03 * ARDRONE.mass_kg),
        (
            lambda p: p.roll.natural_frequency_rad_s,
            ARDRONE.roll.natural_frequency_rad_s,
            0.15 * ARDRONE.roll.natural_frequency_rad_s,
        ),
        (
            lambda p: p.pitch.natural_frequency_rad_s,
            ARDRONE.pitch.natural_frequency_rad_s,
            0.15 * ARDRONE.pitch.natural_frequency_rad_s,
        ),
        (lambda p: p.command_delay_s, ARDRONE.command_delay_s, 0.020),
        (lambda p: p.drag_n_s_m, ARDRONE.drag_n_s_m, 0.20 * ARDRONE.drag_n_s_m),
    ],
)
def test_spread_around_nominal(what, nominal, spread):
    values = np.array([what(plant) for plant in draws()])
    assert values.mean() == pytest.approx(nominal, abs=0.06 * spread)  # 4000 draws: 3.8 sigma of the mean
    assert values.std() == pytest.approx(0.96 * spread, rel=0.05)  # a normal cut at 2 sigma
    assert np.abs(values - nominal).max() <= 2 * spread * (1 + 1e-9)


def test_properties_are_drawn_independently():
    table = np.array(
        [
            [
                p.mass_kg,
                p.thrust_scale,
                p.roll.natural_frequency_rad_s,
                p.pitch.natural_frequency_rad_s,
                p.drag_n_s_m,
                p.command_delay_s,
            ]
            for p in draws()
        ]
    )
    correlation = np.corrcoef(table.T) - np.eye(6)
    assert np.abs(correlation).max() < 0.07


def test_delay_stays_positive():
    quick = dataclasses.replace(ARDRONE, command_delay_s=0.005)
    rng = np.random.default_rng(3)
    delays = [draw_plant(quick, rng).command_delay_s for _ in range(500)]
    assert min(delays) == plant_module.MIN_DELAY_S
    assert len(set(delays)) > 200


def test_ideal_is_nominal_and_uses_no_randomness():
    rng = np.random.default_rng(1)
    before = rng.bit_generator.state
    plant = draw_plant(ARDRONE, rng, perturbed=False)
    assert plant == nominal_plant(ARDRONE)
    assert rng.bit_generator.state == before
    assert (plant.mass_kg, plant.thrust_scale, plant.roll) == (ARDRONE.mass_kg, 1.0, ARDRONE.roll)


def test_what_the_vehicle_believes_stays_nominal():
    assert {plant.nominal_mass_kg for plant in draws(20)} == {ARDRONE.mass_kg}
    assert {plant.roll.gain for plant in draws(20)} == {ARDRONE.roll.gain}


def test_stack_keeps_order():
    plants = draws(3)
    stacked = np.zeros(len(plants), dtype=record(*QUADROTOR_FIELDS))
    fill_records(stacked, plants)
    np.testing.assert_array_equal(stacked["mass_kg"], [plant.mass_kg for plant in plants])
    np.testing.assert_array_equal(stacked["inertia_y_kg_m2"], [ARDRONE.inertia_kg_m2[1]] * 3)
