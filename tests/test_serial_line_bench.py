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
    groups = dict.fromkeys(("damage", "long damage", "longest damage"), bench.DAMAGES)
    groups["port reopened"] = bench.REOPENED
    assert all(set(figures[group]) == set(kinds) for group, kinds in groups.items())
    back = [row for group in (*groups, "reset button") for of in figures[group].values() for row in of.values()]
    assert len(back) == 3 * (6 + 9) + 2 * 2 + 1 and all(row["p99_ms"] <= 100.0 for row in back)
    assert figures["dead_line"]["max_ms"] <= 301.0
    assert 0.0 < figures["node"]["board"]["p50_ms"] < figures["node"]["signal"]["p50_ms"]
    assert "came to the board" in done.stdout


def test_a_damaged_line_is_back_in_time_and_sooner_as_the_device_is_asked(monkeypatch):
    back = bench.after_damage("noise both ways", 40, bench.SHORT_S)
    assert all(row["p99_ms"] <= 1e3 * bench.REQUIRED_BACK_S for row in back.values())
    asked = back["host"]["p50_ms"]
    monkeypatch.setattr(link, "_WORRY_S", 1e3)
    monkeypatch.setattr(link, "_AGAIN_S", 1e3)
    waiting = bench.after_damage("noise both ways", 40, bench.SHORT_S)["host"]["p50_ms"]
    assert asked < 0.7 * waiting


@pytest.mark.parametrize("what", ["noise both ways", "loss both ways", "cut both ways"])
def test_a_link_that_was_lost_is_back_in_time(what):
    """Before and after the loss is detected, after the failsafe, and when the board may have another sketch."""
    for lasts_s in ((0.1, 0.25), (0.31, 0.45), (0.6, 2.0), bench.LONGEST_S):
        back = bench.after_damage(what, 30, lasts_s)
        assert all(row["p99_ms"] <= 1e3 * bench.REQUIRED_BACK_S for row in back.values()), (lasts_s, back)


@pytest.mark.parametrize("resets", bench.REOPENED.values(), ids=bench.REOPENED)
def test_a_port_that_is_opened_again_is_back_in_time(resets):
    back = bench.after_unplugging(resets, 30)
    assert all(row["p99_ms"] <= 1e3 * bench.REQUIRED_BACK_S for row in back.values())


def test_a_frame_tells_which_command_it_shows():
    for number in (0, 19, 20, 399, 400, bench.COMMANDS - 1, bench.COMMANDS, 3 * bench.COMMANDS + 17):
        sent = bench.controls(number).Obj[0]
        channels_us = [round(1500 + 500 * stick) for stick in (sent.phi, sent.theta, sent.T, sent.psi)]
        assert bench.number_shown(channels_us, number + 1) == bench.number_shown(channels_us, number + 200) == number
    assert bench.number_shown((1500, 1500, 950, 1500), 30) is None, "the failsafe"
    assert bench.number_shown((1505, 1505, 1000, 1502), 30) is None, "a channel that moves"


def test_the_first_frames_of_a_board_after_a_reset_show_no_command():
    """They are centred. Two commands have to come before one is believed: two periods of them, and a frame."""
    board = bench.reset_board(40)
    assert board["p50_ms"] > 2e3 * bench.COMMAND_S


@pytest.mark.parametrize("silence_s", [0.3, 1.0])
def test_how_soon_a_dead_line_is_noticed_is_what_was_asked_for(monkeypatch, silence_s):
    monkeypatch.setattr(bench, "Link", lambda: link.Link(silence_s))
    noticed = bench.dead_line(5)
    assert 1e3 * (silence_s - 0.1) - 1.0 <= noticed["p50_ms"] <= noticed["max_ms"] <= 1e3 * silence_s + 1.0
