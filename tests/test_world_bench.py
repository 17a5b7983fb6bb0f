"""The benchmark measures flights: it must fly, and must notice when it does not."""

import json

import pytest
import world as bench

from risc_simulator.models.flight import FlightPhase, Setpoint


@pytest.mark.release
def test_row_and_file(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(bench, "COUNTS", (1, 3))
    monkeypatch.setattr(bench, "REPEATS", 1)
    monkeypatch.setattr(bench, "LAB_TAKE_OFF_S", 0.2)
    monkeypatch.setattr(bench, "LAB_MEASURED_S", 0.3)
    monkeypatch.setattr(bench, "REQUIRED_TIMES_REAL_TIME", {})
    assert bench.main(["--json", str(tmp_path / "b.json")]) == 0
    rows = json.loads((tmp_path / "b.json").read_text())["offline_world"]
    assert [row["vehicles"] for row in rows] == [1, 3]
    assert all(row["times_real_time"] > 1 and 0.0 < row["lab_cores"] < 1.0 for row in rows)
    assert "times real time" in capsys.readouterr().out
    monkeypatch.setattr(bench, "COUNTS", (1,))
    monkeypatch.setattr(bench, "REQUIRED_TIMES_REAL_TIME", {1: 1e9})
    assert bench.main([]) == 1


@pytest.mark.parametrize("kind", bench.TYPES)
def test_vehicles_move_and_stay_in_the_net_for_the_longest_run(kind):
    world, places_m = bench.make_world(50, kind)
    bench.fly(world, places_m, 5.0)
    assert not world.crashes
    for vehicle, place_m in zip(world.vehicles.values(), places_m):
        assert vehicle.phase is FlightPhase.FLYING
        assert abs(vehicle.state.position_m - place_m).max() > 0.01


@pytest.mark.release
def test_irises_are_flown_in_the_whole_lab():
    row = bench.measure_lab(2, "iris", take_off_s=8.0, measured_s=0.5)
    assert row["lab_flying"] == 2 and row["lab_cores"] > 0.0


def test_a_crash_spoils_the_figure(monkeypatch):
    monkeypatch.setattr(bench, "Setpoint", lambda *_: Setpoint(climb_m_s=-2.0))
    with pytest.raises(RuntimeError, match="floor"):
        bench.measure(1, repeats=1, duration_s=3.0)
