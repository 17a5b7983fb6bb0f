"""Flights with a named estimator: one that the tree does not have, and the thesis' own with the thesis' controller."""

import json
import pathlib
from dataclasses import replace

import numpy as np
import pytest

from risc_control.controllers import default_params
from risc_experiments import fly as online
from risc_experiments.estimators import estimator_of
from risc_experiments.offline import Flight, fly, fly_all, main
from risc_lab.registry import VARIABLE

MEMBERS = pathlib.Path(__file__).resolve().parents[2] / "risc_estimation" / "test" / "members"
THESIS = "thesis_lqr"


def test_a_filter_of_one_file_and_one_yaml_flies(monkeypatch, tmp_path):
    with pytest.raises(ValueError, match="'alpha_beta' .*filters"):
        fly(Flight("circle", vehicles=1, seed=3, estimator="alpha_beta"))
    monkeypatch.setenv(VARIABLE, str(MEMBERS))
    toy, ours = (
        fly(Flight("circle", vehicles=2, seed=3, duration_s=5.0, estimator=name)) for name in ("alpha_beta", None)
    )
    assert toy.rmse_m.max() < 0.06, "its velocities are 43 ms late"
    assert not np.array_equal(toy.actual_m[:100], ours.actual_m[:100])
    words = ["--trajectory", "circle", "--vehicles", "1", "--seeds", "1", "--duration", "0.5", "--workers", "1"]
    assert main([*words, "--estimator", "alpha_beta", "--json", str(tmp_path / "figures.json")]) == 0
    assert json.loads((tmp_path / "figures.json").read_text())["estimator"] == "alpha_beta"


def test_the_thesis_controller_flies_with_the_thesis_estimator_unless_another_is_named():
    assert (estimator_of(THESIS), estimator_of("differential_flatness"), estimator_of(THESIS, "least_squares")) == (
        "thesis",
        "least_squares",
        "least_squares",
    )
    flight = Flight("circle", vehicles=1, seed=4, perturbed=False, duration_s=10.0, controller=THESIS)
    own, flattered = fly(flight), fly(Flight(**{**vars(flight), "estimator": "least_squares"}))
    assert own.rmse_m[0] > 1.2 * flattered.rmse_m[0]


def test_the_thesis_controller_bears_the_velocities_of_its_own_estimator_which_come_late():
    """With a larger gain on velocity these perturbed vehicles oscillate until the fence lands them. A steady offset
    for lack of an integral does not count.
    """
    flights = [Flight("circle", vehicles=1, seed=seed, controller=THESIS) for seed in (2, 3)]
    for result in fly_all(flights):
        errors_m = (result.actual_m - result.reference_m)[result.judged, 0]
        assert result.landed == (False,) and np.linalg.norm(errors_m.std(axis=0)) < 0.09
    quick = replace(default_params(THESIS), q_velocity=12.0)
    assert all(result.landed == (True,) for result in fly_all([replace(f, params=quick) for f in flights]))


def test_the_estimator_is_an_argument_of_the_launch_file(capsys):
    assert online.arguments([]).estimator == "least_squares"
    assert online.arguments(["df_demo", "--estimator", "thesis"]).estimator == "thesis"
    with pytest.raises(SystemExit):
        online.arguments(["--estimator", "kalmann"])
    assert "least_squares" in capsys.readouterr().err
