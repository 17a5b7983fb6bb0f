"""The perturbed plant: deviations from the nominal type, and that each draw affects one vehicle only."""

import dataclasses
import functools

import numpy as np
import pytest

from risc_lab.compiled import record
from risc_lab.lab import AttitudeLoop, load_vehicle_type
from risc_simulator.models import perturbed_plant as plant_module
from risc_simulator.models.perturbed_plant import draw_plant, fill_records, nominal_plant, spreads
from risc_simulator.models.quadrotor import QUADROTOR_FIELDS

ARDRONE = load_vehicle_type("ardrone")


@functools.cache
def draws(count=4000):
    rng = np.random.default_rng(7)
    return [draw_plant(ARDRONE, rng) for _ in range(count)]


def numbers(plant):
    """{name: value} of the drawn parameters; those of the attitude loops are named like "roll.gain"."""
    found = {}
    for name, value in vars(plant).items():
        of_loop = isinstance(value, AttitudeLoop)
        found |= {"%s.%s" % (name, key): v for key, v in vars(value).items()} if of_loop else {name: value}
    return {name: value for name, value in found.items() if name not in fixed()}


@functools.cache
def fixed():
    drawn, nominal = draw_plant(ARDRONE, np.random.default_rng(0)), nominal_plant(ARDRONE)
    return {name for name in vars(nominal) if getattr(drawn, name) == getattr(nominal, name)}


@functools.cache
def table():
    """(draws, names)"""
    return np.array([list(numbers(plant).values()) for plant in draws()])


def spread_of(name):
    """(nominal value, standard deviation) by perturbed_plant.yaml."""
    spread, nominal = vars(spreads()), numbers(nominal_plant(ARDRONE))[name]
    of_loop = {"natural_frequency_rad_s": "bandwidth", "damping_ratio": "damping", "gain": "gain"}
    key = of_loop.get(name.partition(".")[2], name)
    if name.endswith("level_rad") or name in ("climb_bias_m_s", "climb_scale"):
        return nominal, spread[name.partition("_")[2] if name.endswith("level_rad") else name]
    if name == "command_delay_s":
        return nominal, spread["delay_s"]
    for end in ("_kg", "_scale", "_n_s_m", "_s"):
        key = key.removesuffix(end)
    return nominal, nominal * spread[key]


NAMES = list(numbers(nominal_plant(ARDRONE)))


@pytest.mark.parametrize("name", NAMES)
def test_spread_around_nominal(name):
    nominal, spread = spread_of(name)
    values = table()[:, NAMES.index(name)]
    assert values.mean() == pytest.approx(nominal, abs=0.06 * spread)  # 4000 draws: 3.8 sigma of the mean
    assert values.std() == pytest.approx(0.96 * spread, rel=0.05)  # a normal cut at 2 sigma
    assert np.abs(values - nominal).max() <= 2 * spread * (1 + 1e-9)


def test_all_that_the_file_names_is_drawn_and_independently():
    assert len(NAMES) == 16
    correlation = np.corrcoef(table().T) - np.eye(len(NAMES))
    assert np.abs(correlation).max() < 0.08


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


def test_stack_keeps_order():
    plants = draws(3)
    stacked = np.zeros(len(plants), dtype=record(*QUADROTOR_FIELDS))
    fill_records(stacked, plants)
    np.testing.assert_array_equal(stacked["mass_kg"], [plant.mass_kg for plant in plants])
    np.testing.assert_array_equal(stacked["inertia_y_kg_m2"], [ARDRONE.inertia_kg_m2[1]] * 3)
