"""`./maap fly`, wrongly used: refused with one clear line that names what is wrong, before anything starts."""

import pathlib

import pytest
import yaml

from risc_experiments import fly
from risc_experiments.flight_record import write_flight
from risc_experiments.fly import arguments, launch_arguments
from risc_experiments.report import simulation_model
from risc_lab.lab import load_fleet

ROOT = pathlib.Path(__file__).resolve().parents[3]


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (["--vehicles", "0"], "--vehicles"),
        (["df_demo", "--vehicles", "2"], "--vehicles"),
        (["df_demo", "--trajectory", "circle"], "--trajectory"),
        (["--duration", "1"], "--duration"),
        (["--delay", "-1"], "--delay"),
        (["--fps", "10"], "--fps"),
        (["coop", "--fps", "0"], "--fps"),
        (["--mocap-rate", "40"], "--mocap-rate"),
        (["--psi", "nan"], "--psi"),
        (["--trajectory", "loop"], "--trajectory"),
        (["--trajectory", "nowhere.yaml"], "--trajectory"),
        (["--speed", "fast"], "--speed"),
        (["df_demo", "--speed", "2x"], "--speed"),
        (["--controller", "autopilot"], "--controller"),
        (["df_demo", "--controller", "thesis_lqr"], "--controller"),
        (["--fault", "fire"], "--fault"),
        (["--fault", "mocap_blackout:-1"], "--fault"),
        (["--fault", "mocap_blackout:0.3@-1"], "--fault"),
        (["--fault", "mocap_blackout@30"], "--fault"),  # all are home then
        (["df_demo", "--duration", "5", "--fault", "mocap_blackout@39"], "--fault"),
        (["--faults", "nowhere.yaml"], "--faults"),
        (["--seed", "-1"], "--seed"),
    ],
)
def test_a_wrong_option_is_named(capsys, words, option):
    with pytest.raises(SystemExit) as end:
        arguments(words)
    assert end.value.code == 2
    assert option in capsys.readouterr().err.splitlines()[-1]


def test_faults_come_from_the_command_line_and_from_a_file(tmp_path):
    script = tmp_path / "faults.yaml"
    script.write_text("faults:\n  - {fault: mocap_blackout, duration_s: 0.2, start_s: 4}\n")
    args = arguments(["--fault", "wind:mild,risc2@3", "--fault", "mocap_blackout:3", "--faults", str(script)])
    assert [str(event) for event in args.faults] == ["wind:0.5,risc2@3", "mocap_blackout:3@0", "mocap_blackout:0.2@4"]
    assert arguments([]).faults == ()


@pytest.mark.parametrize(
    ("line", "words", "seed"),
    [("", [], 1), ("seed: 7", [], 7), ("seed: 0", [], 0), ("seed: 7", ["--seed=3"], 3), ("seed: 7", ["--seed=0"], 0)],
)
def test_a_file_of_faults_has_the_seed_unless_the_command_line_has_one(tmp_path, line, words, seed):
    script = tmp_path / "faults.yaml"
    script.write_text("%s\nfaults:\n  - {fault: mocap_blackout, duration_s: 0.2}\n" % line)
    args = arguments(["--faults", str(script), *words])
    assert args.seed == seed
    fleet = load_fleet(ROOT / "launch/fleets/ardrones3.yaml")
    assert launch_arguments(args, fleet, tmp_path)["seed"] == seed, "of the lab"
    write_flight(args, fleet, ROOT, tmp_path)
    assert yaml.safe_load((tmp_path / "flight.yaml").read_text())["seed"] == seed
    (tmp_path / "fleet.yaml").write_text(yaml.safe_dump(fleet.to_dict()))
    assert simulation_model(args, tmp_path)["seed"] == seed, "of summary.json"


@pytest.mark.parametrize(
    ("words", "cause"),
    [
        (["--vehicles", "1", "--fault", "wind:risc2"], "risc2"),
        (["--fault", "drop:0.1,channel=risc1/nav"], "risc1/nav"),
        (["--fleet", str(ROOT / "launch/fleets/ardrones5.yaml"), "--vehicles", "9"], "ardrones5"),
        (["--fleet", "nowhere.yaml"], "nowhere.yaml"),
        (["--trajectory", "flat8", "--speed", "4"], "--speed"),
        (["--vehicles", "97"], "101"),  # bodies, with landmarks: one more than Cortex's clients hold
    ],
)
def test_a_fleet_that_cannot_fly_is_one_line(tmp_path, words, cause, capfd, monkeypatch):
    monkeypatch.setattr(fly, "handle_signals", lambda handler: None)
    assert fly.main(["--out", str(tmp_path / "flight"), *words]) == 1
    captured = capfd.readouterr()
    told = captured.out + captured.err
    assert cause in told.splitlines()[-1] and "Traceback" not in told
