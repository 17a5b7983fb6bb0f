"""Whole flights of an IRIS+ offline: accuracy, a battery that empties, a mixed fleet, what it does after a loss."""

import numpy as np
import pytest

from risc_control import climb_observer
from risc_control.safety import FailsafeLevel
from risc_control.vehicles import Charge
from risc_control.vehicles.iris import Adapter
from risc_experiments.offline import YAW_BY_SEED_DEG, Flight, Loss, fly, fly_all
from risc_simulator.faults import parse_fault

ALONE = {"vehicles": 1, "types": ("iris",), "delay_s": 0.05}
FIGURES = ("circle", "flat8", "slanted8")


def height_errors_m(result):
    return np.abs(result.reference_m[:, 0, 2] - result.actual_m[:, 0, 2])


def test_a_figure_on_a_perturbed_plant():
    result = fly(Flight("slanted8", seed=1, psi_deg=70.0, duration_s=5.0, **ALONE))
    assert result.rmse_m[0] < 0.008, "the requirement"
    assert result.max_m[0] < 0.02 and not result.safety


@pytest.mark.release
@pytest.mark.parametrize("figure", FIGURES)
def test_the_figures_of_chapter_6(figure):
    flights = [Flight(figure, seed=seed, psi_deg=70.0 * seed, **ALONE) for seed in range(1, 6)]
    assert np.median([result.rmse_m[0] for result in fly_all(flights)]) < 0.008


def emptied():
    """Result of a flight that drains the battery from 100 % to below 40 % in 40 s instead of nine minutes."""
    return fly(Flight("circle", seed=1, duration_s=30.0, overrides={"battery_life_s": 60.0}, **ALONE))


def test_a_battery_that_empties(monkeypatch):
    result = emptied()
    assert result.flown_s > 0.6 * 60.0
    assert height_errors_m(result).max() < 0.03
    # the control arm: the charge is not used, and only the controller's integral adapts
    monkeypatch.setattr(Charge, "note", lambda self, battery_pct, now_s: setattr(self, "pct", 100.0))
    monkeypatch.setattr(climb_observer, "_TRIM_M_S2", 0.0)
    assert height_errors_m(emptied()).max() > 0.03


def test_two_ardrones_and_an_iris_by_one_controller():
    result = fly(Flight("circles3", vehicles=3, fleet="launch/fleets/mixed3.yaml", seed=1, duration_s=5.0))
    assert result.names == ("fluffy_II", "albatross", "IRIS") and not result.safety
    assert result.rmse_m[:2].max() < 0.02 and result.rmse_m[2] < 0.008


@pytest.mark.parametrize("what", ["state", "controls", "laptop"])
def test_it_lands_when_it_loses_what_it_flies_on(what):
    result = fly(Flight("circle", seed=2, duration_s=9.0, loss=Loss(0, what, 1.0), **ALONE))
    assert result.landed == (True,)
    if what != "laptop":  # a dead laptop sends nothing
        assert [said.level for said in result.levels[:2]] == [FailsafeLevel.HOLD, FailsafeLevel.LAND]


def test_commands_that_the_board_would_hold_back_are_not_sent(monkeypatch):
    """After a short loss commands change by more than the board passes; the loop then oscillated into the net."""
    loss = parse_fault("mocap_blackout:0.3@3")
    flight = Flight("circle", seed=5, psi_deg=5 * YAW_BY_SEED_DEG, duration_s=8.0, faults=(loss,), **ALONE)
    assert fly(flight).faults[0].outcome == "completed"
    monkeypatch.setattr(Adapter, "sendable", lambda self, sticks, now_s: sticks)
    assert fly(flight).faults[0].outcome != "completed", "the control arm"


def test_the_thesis_controller_flies_it():
    result = fly(Flight("circle", seed=1, duration_s=5.0, controller="thesis_lqr", **ALONE))
    assert not result.safety and result.rmse_m[0] < 0.12
