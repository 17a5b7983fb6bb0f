"""The benchmark of the pictures: it measures what it names, and notices when it is too slow."""

import json

import pytest
import render as bench


def test_rows_and_file(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(bench, "REPEATS", 3)
    monkeypatch.setattr(bench, "REQUIRED_MS", {})
    assert bench.main(["--json", str(tmp_path / "b.json")]) == 0
    rows = {row["case"]: row for row in json.loads((tmp_path / "b.json").read_text())["pictures"]}
    assert list(rows) == list(bench.cases())
    for row in rows.values():
        stages = row["room_ms"] + row["things_ms"] + row["sensor_ms"]
        assert 0.0 < row["least_ms"] <= row["median_ms"] <= row["p90_ms"]
        assert stages < 1.5 * row["p90_ms"]
    assert rows["down"]["things_ms"] < rows["hover"]["things_ms"]
    assert "turning" in capsys.readouterr().out
    monkeypatch.setattr(bench, "REQUIRED_MS", {"hover": 1e-6})
    assert bench.main([]) == 1


def test_the_cases_show_what_they_are_named_after():
    renderer = bench.make_renderer()
    truths = {name: renderer.truth(*case) for name, case in bench.cases().items()}
    kinds = [truth.kind for truth in truths["hover"]]
    assert sorted(kinds) == ["landmark", "landmark", "vehicle", "vehicle"]
    assert [truth.kind for truth in truths["alone"]] == ["landmark", "landmark"]
    assert truths["down"] == []
    pose, vehicles, _ = bench.cases()["turning"]
    moved_px = renderer.camera.K[0, 0] * pose.rate_rad_s[2] * renderer.imaging.exposure_s
    assert moved_px == pytest.approx(5.0, abs=0.1)
