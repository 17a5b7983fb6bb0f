"""The command line for picture files, without a ROS master."""

import json
import pathlib
import runpy
import sys

import cv2
import numpy as np
import pytest
import yaml
from disc_pictures import camera, exposed, paint_disc, wall
from run_programs import run_program

from risc_lab.lab.calibration import save_calibration
from risc_lab.lab.yaml_reader import package_file

PROGRAM = pathlib.Path(__file__).resolve().parents[1] / "nodes" / "detect_landmarks"


@pytest.fixture
def run(monkeypatch, capsys):
    """run(arguments, folder): (exit code, output, errors), in this process, with an unreachable master."""

    def run_it(*arguments, folder):
        monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:9")
        monkeypatch.chdir(folder)
        monkeypatch.setattr(sys, "argv", [str(PROGRAM), *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(PROGRAM), run_name="__main__")
        return (ended.value.code, *capsys.readouterr())

    return run_it


@pytest.fixture
def pictures(tmp_path):
    """two.png with two landmarks, none.jpg with none; the truth of the first."""
    eye, picture = camera(), wall()
    truth = {
        "green": paint_disc(picture, eye, "green", (200.4, 150.2), 1.6, 30.0, 10.0),
        "Orange": paint_disc(picture, eye, "Orange", (450.0, 200.0), 2.2),
    }
    cv2.imwrite(str(tmp_path / "two.png"), exposed(picture))
    cv2.imwrite(str(tmp_path / "none.jpg"), exposed(wall()))
    return tmp_path, truth


def test_one_json_object_a_line_in_the_order_given(pictures):
    """As a user starts it, without a master."""
    folder, truth = pictures
    done = run_program(PROGRAM, folder, "two.png", "none.jpg", folder / "two.png", "--json")
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert (done.returncode, done.stderr) == (0, "")
    assert [line["image"] for line in lines] == ["two.png", "none.jpg", str(folder / "two.png")]
    assert lines[1] == {"image": "none.jpg", "detections": []}
    assert lines[0]["detections"] == lines[2]["detections"]
    found = {item["name"]: item for item in lines[0]["detections"]}
    assert set(found) == set(truth)
    for name, place in truth.items():
        assert list(found[name]) == ["name", "x", "y", "width", "height", "angle"]
        assert (found[name]["x"], found[name]["y"]) == pytest.approx(tuple(place), abs=0.3)


def test_unreadable_pictures_are_told_and_the_others_done(pictures, run):
    folder, _ = pictures
    (folder / "text.png").write_text("no picture")
    (folder / "empty.png").write_bytes(b"")
    code, out, _ = run("gone.png", "text.png", "empty.png", ".", "two.png", "--json", folder=folder)
    lines = [json.loads(line) for line in out.splitlines()]
    assert code == 1
    assert [set(line) for line in lines] == [{"image", "detections", "error"}] * 4 + [{"image", "detections"}]
    assert [line["detections"] for line in lines[:4]] == [[]] * 4
    for line, cause in zip(lines, ("file", "picture", "picture", "folder")):
        assert cause in line["error"]
    code, out, err = run("gone.png", "two.png", folder=folder)
    assert code == 1
    assert err.startswith("gone.png: ") and err.count("\n") == 1
    assert "two.png: 2 found" in out


def test_a_table_for_people(pictures, run):
    code, out, _ = run("two.png", "none.jpg", folder=pictures[0])
    assert code == 0
    assert out.splitlines()[0] == "two.png: 2 found"
    assert out.splitlines()[-1] == "none.jpg: nothing"
    assert out.split().count("green") == 1


def test_overlays(pictures, run):
    folder, _ = pictures
    (folder / "more").mkdir()
    (folder / "more" / "two.png").write_bytes((folder / "two.png").read_bytes())
    code, _, _ = run("two.png", "more/two.png", "none.jpg", "--overlay", "drawn/here", folder=folder)
    assert code == 0
    assert sorted(path.name for path in (folder / "drawn/here").iterdir()) == ["none.png", "two.png", "two_2.png"]
    plain, drawn = cv2.imread(str(folder / "two.png")), cv2.imread(str(folder / "drawn/here/two.png"))
    assert plain.shape == drawn.shape
    changed = (plain != drawn).any(axis=2)
    assert changed[90:210, 140:260].mean() > 0.02
    assert not changed[:, 560:].any()


def test_another_configuration(pictures, run):
    folder, _ = pictures
    config = yaml.safe_load(package_file("risc_visual", "config/landmark_detector.yaml").read_text(encoding="utf-8"))
    config["landmarks"] = [{"name": "Green_pink", "roi_name": "lawn", "centre": "green", "ring": "pink"}]
    (folder / "my.yaml").write_text(yaml.safe_dump(config))
    _, out, _ = run("two.png", "--json", "--config", "my.yaml", folder=folder)
    assert [item["name"] for item in json.loads(out)["detections"]] == ["lawn"]


@pytest.mark.parametrize(
    "arguments, told",
    [
        ([], "IMAGE"),
        (["two.png", "--config", "gone.yaml"], "gone.yaml"),
        (["two.png", "--config", "bad.yaml"], "bad.yaml.*'colours'"),
        (["two.png", "--calibration", "gone/camera.yaml"], "camera.yaml"),
        (["two.png", "--overlay", "two.png"], "two.png"),
    ],
)
def test_wrong_arguments_are_one_error(pictures, run, arguments, told):
    (pictures[0] / "bad.yaml").write_text("landmarks: []\n")
    code, out, err = run(*arguments, folder=pictures[0])
    assert (code, out) == (2, "")
    assert "Traceback" not in err
    assert told.split(".*")[-1] in err.splitlines()[-1]


def test_a_calibration_for_another_size_is_told(pictures, run):
    folder, truth = pictures
    save_calibration(camera().calibration, folder / "right.yaml")
    save_calibration(camera((320, 180)).calibration, folder / "small.yaml")
    code, out, _ = run("two.png", "--json", "--calibration", "./right.yaml", folder=folder)
    assert code == 0
    found = {item["name"]: (item["x"], item["y"]) for item in json.loads(out)["detections"]}
    assert found["green"] == pytest.approx(tuple(truth["green"]), abs=0.2)
    code, out, _ = run("two.png", "--json", "--calibration", "./small.yaml", folder=folder)
    assert code == 1
    assert "640x360" in json.loads(out)["error"]
    assert "320x180" in json.loads(out)["error"]


def test_grey_and_deep_pictures(pictures, run):
    folder, _ = pictures
    cv2.imwrite(str(folder / "grey.png"), np.full((90, 160), 80, np.uint8))
    cv2.imwrite(str(folder / "deep.png"), np.full((90, 160, 3), 30000, np.uint16))
    code, out, _ = run("grey.png", "deep.png", "--json", folder=folder)
    assert code == 0
    assert [json.loads(line)["detections"] for line in out.splitlines()] == [[], []]
