"""The benchmark runs and writes what it says (the figures themselves are for reading, not for asserting)."""

import json

import estimation as bench
import pytest


@pytest.mark.release
def test_bench_writes_its_tables(tmp_path, capsys):
    assert bench.main(["--vehicles", "1", "2", "--json", str(tmp_path / "bench.json")]) == 0
    figures = json.loads((tmp_path / "bench.json").read_text(encoding="utf-8"))
    assert figures["simulated"] is True
    assert [row["vehicles"] for row in figures["time"]] == [1, 2]
    assert all(row["p50_us"] > 0.0 for row in figures["time"])
    assert figures["noise"]["thesis"]["vx_mm_s"] < figures["noise"]["least_squares"]["vx_mm_s"]
    assert "Time per frame" in capsys.readouterr().out
