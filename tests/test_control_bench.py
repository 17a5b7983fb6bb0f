"""The benchmark of the controller runs and prints what it measured; the speed itself is not tested."""

import json

import control as bench


def test_every_figure_is_there(tmp_path, capsys):
    file = tmp_path / "figures.json"
    assert bench.main(["--vehicles", "2", "--frames", "100", "--json", str(file)]) == 0
    figures = json.loads(file.read_text(encoding="utf-8"))
    assert [(row["vehicles"], row["delay_s"]) for row in figures["controller"]] == [(2, 0.1), (2, 0.3)]
    assert all(row["frame_us"] > 0.0 for row in figures["controller"])
    assert len(figures["pilot_us"]) == 4 and min(figures["pilot_us"].values()) > 0.0
    assert "construction" in capsys.readouterr().out
