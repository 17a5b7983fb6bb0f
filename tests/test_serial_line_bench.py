"""The line to the board of an IRIS+ is back in time after damage (simulated), and the node measures itself (real)."""

import json
import pathlib
import subprocess
import sys

import pytest
import serial_line as bench

from rosserial_python import link


@pytest.mark.release
def test_every_figure_is_there(tmp_path):
    file = tmp_path / "figures.json"
    program = [sys.executable, str(pathlib.Path(bench.__file__)), "--trials", "40", "--messages", "20"]
    done = subprocess.run([*program, "--json", str(file)], capture_output=True, text=True, timeout=300.0)
    assert done.returncode == 0, done.stdout + done.stderr
    figures = json.loads(file.read_text(encoding="utf-8"))
    assert set(figures["damage"]) == set(bench.DAMAGES)
    assert all(row[of]["p99_ms"] <= 100.0 for row in figures["damage"].values() for of in row)
    assert figures["dead_line"]["max_ms"] <= 301.0 and figures["reset"]["p99_ms"] <= 100.0
    assert 0.0 < figures["node"]["board"]["p50_ms"] < figures["node"]["signal"]["p50_ms"]
    assert "came to the board" in done.stdout


def test_a_damaged_line_is_back_in_time_and_sooner_as_the_device_is_asked(monkeypatch):
    back = bench.after_damage("noise both ways", 40)
    assert all(row["p99_ms"] <= 1e3 * bench.REQUIRED_BACK_S for row in back.values())
    asked = back["host"]["p50_ms"]
    monkeypatch.setattr(link, "_WORRY_S", 1e3)
    monkeypatch.setattr(link, "_AGAIN_S", 1e3)
    waiting = bench.after_damage("noise both ways", 40)["host"]["p50_ms"]
    assert asked < 0.7 * waiting


@pytest.mark.parametrize("silence_s", [0.3, 1.0])
def test_how_soon_a_dead_line_is_noticed_is_what_was_asked_for(monkeypatch, silence_s):
    monkeypatch.setattr(bench, "Link", lambda: link.Link(silence_s))
    noticed = bench.dead_line(5)
    assert 1e3 * (silence_s - 0.1) - 1.0 <= noticed["p50_ms"] <= noticed["max_ms"] <= 1e3 * silence_s + 1.0
