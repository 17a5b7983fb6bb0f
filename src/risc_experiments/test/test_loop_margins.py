"""Loop margins: against a loop with known margins, against flights with more delay, and the command line."""

import dataclasses
import json
import math

import numpy as np
import pytest

from risc_experiments import loop_margins
from risc_experiments.loop_margins import FREQUENCIES_RAD_S as W
from risc_experiments.loop_margins import margins, responses, sensitivity
from risc_experiments.offline import Flight
from risc_experiments.offline_chain import FRAME_S
from risc_lab.lab import load_vehicle_type

DELAY_MARGIN_S = 0.2  # of an AR.Drone with 0.1 s of delay


def test_margins_of_an_integrator_with_delay():
    """L = k exp(-jwT) / jw: crossover k, phase margin 90 degrees - kT, gain margin pi/(2kT)."""
    k, T = 3.0, 0.2
    L = k * np.exp(-1j * W * T) / (1j * W)
    found = margins(1.0 / (1.0 + L))
    left_rad = 0.5 * math.pi - k * T
    assert found.crossover_rad_s == pytest.approx(k, rel=2e-3)
    assert found.phase_margin_deg == pytest.approx(math.degrees(left_rad), abs=0.2)
    assert found.delay_margin_ms == pytest.approx(1e3 * left_rad / k, rel=3e-3)
    assert found.gain_margin_db == pytest.approx(20.0 * math.log10(0.5 * math.pi / (k * T)), abs=0.05)
    assert found.max_s == pytest.approx(np.abs(1.0 / (1.0 + L)).max())


def test_sensitivity_of_a_sampled_loop():
    """u = d - k sum(u) h of the frames before: an integrator that is broken at its input."""
    k, n = 2.0, 4000
    u, total = np.zeros(n), 0.0
    for frame in range(n):
        u[frame] = (frame == 0) - k * FRAME_S * total
        total += u[frame]
    response = u - (np.arange(n) == 0)
    z = np.exp(1j * W * FRAME_S)
    L = k * FRAME_S / (z - 1.0)
    assert sensitivity(response) == pytest.approx(1.0 / (1.0 + L), abs=1e-6)


def of_attitude_loops(bandwidth):
    """(Margins of roll, of pitch) of an AR.Drone with 0.1 s of delay and attitude loops of this bandwidth."""
    plant = loop_margins.slower(load_vehicle_type("ardrone"), bandwidth)
    roll, pitch, _ = responses(Flight(delay_s=0.1, plant=plant)).T
    return margins(sensitivity(roll)), margins(sensitivity(pitch))


@pytest.mark.release
def test_the_defaults_are_robust():
    for axis in of_attitude_loops(1.0):
        assert axis.max_s < 2.0 and axis.delay_margin_ms == pytest.approx(1e3 * DELAY_MARGIN_S, abs=30.0)
    # slower than the controller believes
    assert max(axis.max_s for axis in of_attitude_loops(0.7)) < 3.0


@pytest.mark.parametrize("share, steady", [(0.8, True), (1.15, False)])
def test_a_loop_is_steady_up_to_its_delay_margin(share, steady):
    """An independent check: a flight whose link has more delay than the controller knows."""
    plant = {"command_delay_s": 0.1 + share * DELAY_MARGIN_S}
    running = loop_margins._Hovering(Flight(delay_s=0.1, plant=plant, node={"ladder": False}))
    for frame in range(9000):
        running.pulse = frame == 2400
        running.frame()
    tilts = np.abs(np.array(running.commands)[:, :2]).max(axis=1)
    early, late = tilts[2600:4000].max(), tilts[7600:].max()
    assert (late < 0.2 * early) == steady


def test_what_is_printed(monkeypatch, capsys, tmp_path):
    told = np.zeros((3000, 3))
    told[40:240] = -0.004
    monkeypatch.setattr(loop_margins, "responses", lambda *_: told)
    assert loop_margins.main(["--json", "--delay", "0.1", "--bandwidth", "0.7", "--set", "q_tilt=3"]) == 0
    found = json.loads(capsys.readouterr().out)
    keys = {"max_s", "phase_margin_deg", "delay_margin_ms", "gain_margin_db", "crossover_rad_s", "axes"}
    assert set(found) == keys and set(found["axes"]) == {"roll", "pitch", "climb"}
    assert found["max_s"] == max(found["axes"][axis]["max_s"] for axis in ("roll", "pitch")) > 1.0
    assert loop_margins.main(["--plot", str(tmp_path / "loop.png")]) == 0
    assert (tmp_path / "loop.png").stat().st_size > 10000 and "pitch" in capsys.readouterr().out


def test_an_unstable_loop_has_no_margins(monkeypatch, capsys):
    """A link with more delay than the delay margin: one line, exit code 1, and JSON without numbers."""
    hovering = loop_margins._Hovering
    later = {"command_delay_s": 0.1 + 1.5 * DELAY_MARGIN_S}
    monkeypatch.setattr(loop_margins, "_Hovering", lambda flight: hovering(dataclasses.replace(flight, plant=later)))
    monkeypatch.setattr(loop_margins, "_FRAMES", 1)  # one pulse is enough
    assert loop_margins.main(["--json", "--delay", "0.1"]) == 1
    out, err = capsys.readouterr()
    found = json.loads(out)
    numbers = [
        *(value for key, value in found.items() if key != "axes"),
        *(n for a in found["axes"].values() for n in a.values()),
    ]
    assert numbers == [None] * 20 and "loop" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--bandwidth", "0"], "--bandwidth must"),
        (["--set", "q_tlit=3"], "--set q_tlit=3: "),
        (["--set", "q_tilt=much"], "much"),
        (["--type", "zeppelin"], "zeppelin"),
        (["--set", "q_tilt=-1"], "q_tilt"),
    ],
)
def test_wrong_use_is_one_clear_line(arguments, message, capsys):
    with pytest.raises(SystemExit):
        loop_margins.main(arguments)
    assert message in capsys.readouterr().err
