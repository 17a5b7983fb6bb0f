"""The benchmark runs and writes what it says (the figures themselves are for reading, not for asserting)."""

import json

import estimation as bench
import pytest

from risc_estimation.filters import make_filter
from risc_lab.lab.templates import load_templates


@pytest.mark.release
def test_bench_writes_its_tables(tmp_path, capsys):
    assert bench.main(["--vehicles", "1", "2", "--json", str(tmp_path / "bench.json")]) == 0
    figures = json.loads((tmp_path / "bench.json").read_text(encoding="utf-8"))
    assert figures["simulated"] is True
    assert [row["vehicles"] for row in figures["time"]] == [1, 2]
    assert all(row["p50_us"] > 0.0 for row in figures["time"])
    assert figures["noise"]["thesis"]["vx_mm_s"] < figures["noise"]["least_squares"]["vx_mm_s"]
    assert all({*bench.COLUMNS, "lag_ms"} == set(row) for row in figures["noise"].values())
    assert "Time per frame" in capsys.readouterr().out


@pytest.mark.parametrize(("name", "lag_ms"), [("thesis", 122.5), ("least_squares", 5.1)])
def test_the_lag_is_that_of_the_window(name, lag_ms):
    """Half of 50 samples for a line; the phase of a parabola's slope at its newest sample, at the sine's frequency."""
    found_ms = bench.lag_ms(load_templates()["fluffy_II"], make_filter(name), periods=1)
    assert found_ms == pytest.approx(lag_ms, abs=0.5)
