"""Filters are given what vehicles measure on board in offline flights, too; flights without them stay the same."""

import shutil

import numpy as np
import pytest

from risc_estimation.filters import COMMAND, REGISTRY, least_squares
from risc_experiments.offline import Flight, fly
from risc_lab.lab.yaml_reader import package_file
from risc_lab.registry import VARIABLE
from risc_simulator.faults import FaultEvent

TOY = '''
from risc_estimation.filters import COMMAND, least_squares
from risc_lab.states import S

GIVEN = set()

class Filter(least_squares.Filter):
    """Climb rates as measured on board, between two packets with what they change by according to motion capture."""

    ON_BOARD = (COMMAND, "velocity")

    def __init__(self, params):
        super().__init__(params)
        self._off = {}

    def update(self, poses):
        super().update(poses)
        for row, off in self._off.items():
            self.states[row, S.W] += off

    def on_board(self, row, stamp_s, what, values):
        GIVEN.add(what)
        if what == "velocity":
            self._off[row] = -values[2] - self.states[row, S.W] + self._off.get(row, 0.0)
'''


def recorded(monkeypatch, wanted, **flight):
    """(Result, list of (row, stamp, what, values)) of a flight whose filter records the readings that it gets."""
    given = []
    monkeypatch.setattr(least_squares.Filter, "ON_BOARD", wanted)
    monkeypatch.setattr(least_squares.Filter, "on_board", lambda self, *item: given.append(item))
    return fly(Flight(vehicles=2, seed=3, duration_s=1.0, **flight)), given


def test_readings_come_at_the_rate_of_the_navdata_with_stamps_of_their_own(monkeypatch):
    plain = fly(Flight(vehicles=2, seed=3, duration_s=1.0))
    result, given = recorded(monkeypatch, ("velocity", "height", "specific_force"))
    for name in ("actual_m", "reference_m", "rmse_m"):
        np.testing.assert_array_equal(getattr(result, name), getattr(plain, name))
    assert {what for _, _, what, _ in given} == {"velocity", "height", "specific_force"}
    for row in (0, 1):
        stamps_s = np.array([t for i, t, what, _ in given if i == row and what == "velocity"])
        assert np.diff(stamps_s).mean() == pytest.approx(0.065, abs=1e-3) and (np.diff(stamps_s) > 0.055).all()
        np.testing.assert_allclose(stamps_s % 0.005, 0.001, atol=1e-6)
        heights_m = np.array([values[0] for i, t, what, values in given if i == row and what == "height"])
        true_m = np.interp(stamps_s, result.times_s, result.actual_m[:, row, 2])
        late = stamps_s > result.times_s[0]
        offset_m = (heights_m - true_m)[late]
        assert np.abs(offset_m).max() < 0.15 and offset_m.std() < 0.03, "above standing"
        forces = np.array([values for i, _, what, values in given if i == row and what == "specific_force"])
        assert forces[:, 2].mean() == pytest.approx(-9.8, abs=0.3)
        speeds = np.array([np.hypot(*values[:2]) for i, t, what, values in given if i == row and what == "velocity"])
        true_m_s = np.linalg.norm(np.gradient(result.actual_m[:, row, :2], result.times_s, axis=0), axis=1)
        assert np.abs(speeds - np.interp(stamps_s, result.times_s, true_m_s))[late].std() < 0.05


def test_they_pass_a_wire_with_faults(monkeypatch):
    _, given = recorded(monkeypatch, ("height",))
    faults = (
        FaultEvent("drop", channel="risc1/navdata", severity=0.5),
        FaultEvent("corrupt", channel="risc1/navdata", severity=0.5),
        FaultEvent("delay", channel="risc2/navdata", severity=0.03),
    )
    _, faulty = recorded(monkeypatch, ("height",), wire_faults=faults)
    counts = [[sum(i == row for i, *_ in items) for row in (0, 1)] for items in (given, faulty)]
    assert 0.1 < counts[1][0] / counts[0][0] < 0.45 and counts[1][1] >= counts[0][1] - 1
    first, late = ([t for i, t, *_ in items if i == 1][0] for items in (given, faulty))
    assert late - first == pytest.approx(0.03, abs=0.006)


def test_a_member_flies_by_them(monkeypatch, tmp_path):
    folder = tmp_path / "filters"
    folder.mkdir()
    (folder / "climbing.py").write_text(TOY)
    shutil.copy(package_file("risc_estimation", "config/filters/least_squares.yaml"), folder / "climbing.yaml")
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    result, other = [fly(Flight(vehicles=1, seed=1, duration_s=4.0, estimator=name)) for name in ("climbing", None)]
    assert result.rmse_m[0] < 0.05 and not np.array_equal(result.actual_m, other.actual_m)
    given = REGISTRY.module("climbing").GIVEN
    assert given == {COMMAND, "velocity"}
