"""Whole flights offline: accuracy on perturbed plant at any yaw, delay, reproducibility."""

import functools
import math

import numpy as np
import pytest

from risc_experiments import offline
from risc_experiments.offline import Flight, fly
from risc_experiments.offline_chain import FRAME_S
from risc_simulator.faults import parse_fault

HULL_M = 0.55


@functools.cache
def three(trajectory, seed, psi_deg):
    return fly(Flight(trajectory, seed=seed, psi_deg=psi_deg, duration_s=10.0))


@functools.cache
def ideal():
    """The flight of a single ideal vehicle."""
    return fly(Flight("circle", vehicles=1, psi_deg=29.0, duration_s=6.0, perturbed=False, noise=False))


CIRCLE = ("circle", 1, 0.0)


@pytest.mark.parametrize(
    ("trajectory", "seed", "psi_deg"),
    [CIRCLE, pytest.param("flat8", 2, 110.0, marks=pytest.mark.release), ("slanted8", 3, -160.0)],
)
def test_three_vehicles_on_perturbed_plants(trajectory, seed, psi_deg):
    result = three(trajectory, seed, psi_deg)
    assert result.names == ("fluffy_II", "albatross", "Raven")
    assert result.rmse_m.max() < 0.01 and result.max_m.max() < 0.015
    assert result.closest_m > HULL_M + 0.1


def test_more_vehicles_than_any_fleet_file_holds():
    """In a generated lab, whose net world, estimator and pilots use."""
    result = fly(Flight("circles3", vehicles=14, seed=1, duration_s=2.0))
    assert len(result.names) == 14
    assert result.closest_m >= 0.7 and result.rmse_m.max() < 0.01
    assert np.abs(result.actual_m[..., 1]).max() > 1.5, "beyond where the laboratory's net lets fly"


def test_turning_noses():
    result = fly(Flight("circles3", seed=4, duration_s=12.0))
    assert result.rmse_m.max() < 0.006


def test_a_delay_of_0_3_s_that_the_controller_knows():
    result = fly(Flight("circle", seed=5, delay_s=0.3, psi_deg=57.0, duration_s=10.0))
    assert np.median(result.rmse_m) < 0.01 and result.rmse_m.max() < 0.015


def test_the_thesis_controller_flies_and_is_less_accurate():
    thesis = fly(Flight("flat8", vehicles=1, seed=4, psi_deg=115.0, duration_s=10.0, controller="thesis_lqr"))
    full = fly(Flight("flat8", vehicles=1, seed=4, psi_deg=115.0, duration_s=10.0))
    assert 2.0 * full.rmse_m[0] < thesis.rmse_m[0] < 0.15


def test_a_vehicle_that_does_not_become_autonomous_at_once_is_asked_again(monkeypatch):
    presses, press = [], offline.Chain.press_autonomous

    def refused_once(chain, now_s):
        presses.append(chain)
        if len(presses) != 2:
            press(chain, now_s)

    monkeypatch.setattr(offline.Chain, "press_autonomous", refused_once)
    assert fly(Flight("circles3", vehicles=2, seed=7, duration_s=1.0)).rmse_m.max() < 0.004
    assert len(presses) == 3 and presses[1] is presses[2], "the other is not pressed again: that would end it"


def test_a_flight_that_never_reaches_its_course_ends(monkeypatch):
    monkeypatch.setattr(offline.Chain, "press_autonomous", lambda chain, now_s: None)
    monkeypatch.setattr(offline, "LONGEST_WAY_S", 5.0)
    with pytest.raises(RuntimeError, match=r" 5 s \(fluffy_II: hold; .* fluffy_II"):
        fly(Flight("circle", vehicles=1))


def test_a_seed_reproduces_a_flight_bit_for_bit_and_many_at_once_are_the_same():
    """In any process, and after any other flights in it."""
    flights = [Flight("circles3", vehicles=2, seed=seed, duration_s=0.5) for seed in (7, 8, 9)]
    over = []
    alone, together = list(offline.fly_all(flights, 1)), list(offline.fly_all(flights, 2, over.append))
    for first, second in zip(alone, together):
        assert np.array_equal(first.actual_m, second.actual_m) and np.array_equal(first.rmse_m, second.rmse_m)
    assert not np.array_equal(alone[0].actual_m[:100], alone[1].actual_m[:100])
    assert over == [1, 2, 3]
    with pytest.raises(ValueError, match="trajectory.*loop"):
        list(offline.fly_all([Flight("loop"), Flight("loop")], 2))


def test_gusts_and_an_ideal_plant_without_noise():
    assert ideal().rmse_m[0] < 0.002
    gusty = fly(Flight("circle", vehicles=1, psi_deg=29.0, duration_s=6.0, gusts=True))
    assert 0.01 < gusty.rmse_m[0] < 0.03


@pytest.mark.parametrize(("estimator", "unseen_frames"), [("ekf", 3), ("least_squares", 9)])
def test_a_reset_of_the_filter_makes_nobody_jump(estimator, unseen_frames):
    """The vehicle counts as not visible until the filter has settled; then its position is right, and it flies on."""
    running = offline.RunningFlight(Flight("circle", vehicles=1, seed=2, duration_s=2.0, estimator=estimator))
    off_m, reset_s = [], math.inf
    while not running.is_over:
        if running._time_s >= running._settled_s + 1.0 and reset_s == math.inf:
            running._estimator._filter.reset()
            reset_s = running._time_s
        running.frame()
        if running._time_s > reset_s + 2.5 * FRAME_S:  # frames on their way were seen before
            off = running._estimate.states[0, :3] - running._world.positions_m()[0]
            off_m.append(np.linalg.norm(off) if running._estimate.visible[0] else math.nan)
    assert 0 < np.isnan(off_m).sum() == np.isnan(off_m[:10]).sum() <= unseen_frames
    assert np.nanmax(off_m) < 0.005 and running.outcome().max_m[0] < 0.015


def test_a_load_that_is_put_on_at_once_is_followed():
    """By the filter ekf, whose model does not contain the load."""

    def outcome(follows):
        load = parse_fault("added_mass:0.2,duration_s=5@1")
        running = offline.RunningFlight(Flight("circle", vehicles=1, duration_s=5.0, estimator="ekf", faults=(load,)))
        if not follows:
            running._estimator._filter._settings["push_m_s2"] = 0.0
        while not running.is_over:
            running.frame()
        return running.outcome().faults[0].outcome

    assert outcome(True) == "completed"
    assert outcome(False) == "landed"  # the control arm


def test_the_nearest_two_of_all_pairs():
    result = three(*CIRCLE)
    apart = np.linalg.norm(result.actual_m[:, [0, 0, 1]] - result.actual_m[:, [1, 2, 2]], axis=2)
    assert result.closest_m == pytest.approx(apart.min(), abs=1e-12)
    assert ideal().closest_m == math.inf


def test_the_table(capsys):
    arguments = ["--trajectory", "circle", "--vehicles", "1", "--seeds", "2", "--duration", "1", "--delay", "0.1"]
    assert offline.main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[:3] == ["course", "delay", "seed"]
    assert [line.split()[:3] for line in lines[1:]] == [
        ["circle", "0.10", "1"],
        ["circle", "0.10", "2"],
        ["circle", "0.10", "all"],
    ]
    errors_mm = [float(line.split()[3]) for line in lines[1:3]]
    told = list(map(float, lines[3].split()[3:]))  # median, 95 %, worst
    expected = [np.median(errors_mm), np.percentile(errors_mm, 95), max(errors_mm)]
    assert told == pytest.approx(expected, abs=0.1) and min(told) > 0.0 and max(told) < 10.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--vehicles", "300"], "300"),
        (["--delay", "2"], "are 2 s"),
        (["--trajectory", "loop"], "choose from circle"),
        (["--workers", "0"], "worker"),
    ],
)
def test_wrong_use_is_one_clear_line(arguments, message, capsys):
    with pytest.raises(SystemExit):
        offline.main(["--seeds", "1"] + arguments)
    assert message in capsys.readouterr().err
