"""The benchmark of scale: its rows, which scripts rely on, the lines through them, and what a failed row says."""

import json
import pathlib
import sys

import pytest

FOLDER = pathlib.Path(__file__).resolve().parent / "benchmarks"
sys.path.insert(0, str(FOLDER))
import run  # noqa: E402
import scale  # noqa: E402

KEYS = {
    "kind",
    "vehicles",
    "loaded",
    "p50_ms",
    "p99_ms",
    "frames_lost",
    "cpu_cores",
    "memory_mb",
    "times_real_time",
}


@pytest.mark.release
def test_rows_as_bench_writes_them(tmp_path, monkeypatch, capfd):
    what, command = run.BENCHMARKS["scale"]
    short = command + ["--kinds", "offline", "--vehicles", "1", "2", "3", "--seconds", "1", "--load", "quiet"]
    monkeypatch.setitem(run.BENCHMARKS, "scale", (what, short))
    monkeypatch.setattr(sys, "argv", ["maap bench", "scale", "--json", str(tmp_path / "figures.json")])
    assert run.main() == 0
    rows = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))["rows"]
    assert [(row["kind"], row["vehicles"], row["loaded"]) for row in rows] == [("offline", n, False) for n in (1, 2, 3)]
    for row in rows:
        assert set(row) >= KEYS
        assert row["p50_ms"] is row["p99_ms"] is row["frames_lost"] is None, "nothing of real time is measured"
        assert row["times_real_time"] > 1.0 and row["cpu_cores"] < 1.2 and 30.0 < row["memory_mb"] < 3000.0
        of_one_second = row["cpu_cores"] / row["times_real_time"]  # processor time, whatever else the computer does
        assert 0.005 < of_one_second < 0.3
        assert row["rmse_mm"] < 30.0
    assert "offline" in capfd.readouterr().out


@pytest.mark.release
def test_a_row_that_fails_keeps_its_keys_and_is_told(tmp_path, monkeypatch, capfd):
    path = tmp_path / "figures.json"
    options = ["--kinds", "offline", "--vehicles", "1", "251", "--seconds", "1", "--load", "quiet", "--json", str(path)]
    monkeypatch.setattr(sys, "argv", ["scale.py", *options])
    assert scale.main() == 1
    good, bad = json.loads(path.read_text(encoding="utf-8"))["rows"]
    assert good["times_real_time"] > 1.0
    assert set(bad) >= KEYS and {bad[name] for name in scale.FIGURES} == {None}
    assert not bad["passed"] and "1 to 250 vehicles, 251" in bad["reasons"][0]
    assert "failed: " in capfd.readouterr().out


@pytest.mark.release
def test_the_filter_that_was_asked_for_flies(tmp_path, monkeypatch):
    path, rmse_mm = tmp_path / "figures.json", []
    for options in (), ("--estimator", "ekf"):
        words = ["--kinds", "offline", "--vehicles", "1", "--seconds", "1", "--load", "quiet", "--json", str(path)]
        monkeypatch.setattr(sys, "argv", ["scale.py", *words, *options])
        assert scale.main() == 0
        rmse_mm += [row["rmse_mm"] for row in json.loads(path.read_text(encoding="utf-8"))["rows"]]
    assert len(set(rmse_mm)) == 2


@pytest.mark.parametrize("kind", ["graph", "estimation"])
def test_lines_through_the_rows(kind):
    rows = [
        dict(dict.fromkeys(KEYS), kind=kind, vehicles=n, loaded=loaded, p99_ms=2.0 + 0.1 * n, cpu_cores=load * n)
        for n in (1, 10, 50)
        for loaded, load in ((False, 0.02), (True, 0.03))
    ]
    rows.append(dict(rows[0], vehicles=100, p99_ms=None, cpu_cores=None))  # could not be measured
    found = {(loaded, figure): (none, each) for of, loaded, figure, none, each in scale.slopes(rows) if of == kind}
    assert set(found) == {(loaded, figure) for loaded in (False, True) for figure in ("p99_ms", "cpu_cores")}
    assert found[False, "p99_ms"] == pytest.approx((2.0, 0.1))
    assert found[True, "cpu_cores"] == pytest.approx((0.0, 0.03), abs=1e-9)


def test_the_line_of_offline_flights_is_through_seconds_of_computing_for_a_second_of_flight():
    rows = [
        dict(dict.fromkeys(KEYS), kind="offline", vehicles=n, loaded=False, times_real_time=1.0 / (0.01 + 0.002 * n))
        for n in (1, 3, 50)
    ]
    ((kind, loaded, figure, none, each),) = scale.slopes(rows)
    assert (kind, loaded, figure) == ("offline", False, "seconds_per_second")
    assert (none, each) == pytest.approx((0.01, 0.002))
    assert scale.slopes(rows[:2]) == [], "two points are always on a line"
