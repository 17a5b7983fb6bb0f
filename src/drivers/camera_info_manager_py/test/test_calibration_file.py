import os

import pytest
import yaml

from camera_info_manager.calibration_file import (
    Calibration,
    CalibrationFileError,
    read_calibration,
    write_calibration,
)

FRONT = Calibration(
    name="ardrone_front",
    width_px=640,
    height_px=360,
    distortion_model="plumb_bob",
    D=(-0.526629, 0.274357, 0.021143, -0.006394, 0.0),
    K=(569.883, 0.0, 331.403, 0.0, 568.007, 135.879, 0.0, 0.0, 1.0),
    R=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
    P=(463.3, 0.0, 328.5, 0.0, 0.0, 524.7, 136.0, 0.0, 0.0, 0.0, 1.0, 0.0),
)


@pytest.fixture
def path(tmp_path):
    return str(tmp_path / "camera_info" / "front.yaml")


def changed(path, change):
    """Path of FRONT's file after a change of its content."""
    write_calibration(FRONT, path)
    with open(path) as file:
        content = yaml.safe_load(file)
    change(content)
    with open(path, "w") as file:
        yaml.safe_dump(content, file)
    return path


def test_round_trip_makes_the_folders(path):
    write_calibration(FRONT, path)
    assert read_calibration(path) == FRONT
    assert os.listdir(os.path.dirname(path)) == ["front.yaml"]  # nothing temporary is left


def test_debian_reads_what_we_write(path):
    parsers = pytest.importorskip("camera_calibration_parsers", reason="python3-camera-calibration-parsers is needed")
    write_calibration(FRONT, path)
    name, info = parsers.readCalibration(path)
    assert name == FRONT.name
    assert (info.width, info.height, info.distortion_model) == (640, 360, "plumb_bob")
    assert (tuple(info.D), tuple(info.K), tuple(info.R), tuple(info.P)) == (FRONT.D, FRONT.K, FRONT.R, FRONT.P)


def test_a_number_that_yaml_takes_for_a_text_is_read(path):
    write_calibration(FRONT, path)
    with open(path) as file:
        text = file.read().replace("-0.006394", "1e-05")
    with open(path, "w") as file:
        file.write(text)
    assert yaml.safe_load(text)["distortion_coefficients"]["data"][3] == "1e-05"
    assert read_calibration(path).D[3] == 1e-5


def test_name_and_model_may_be_missing(path):
    def change(content):
        del content["camera_name"], content["distortion_model"]

    calibration = read_calibration(changed(path, change))
    assert (calibration.name, calibration.distortion_model) == ("unknown", "plumb_bob")


def test_coefficients_in_a_column(path):
    def change(content):
        content["distortion_coefficients"].update(rows=5, cols=1)

    assert read_calibration(changed(path, change)).D == FRONT.D


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda c: c.pop("camera_matrix"), "camera_matrix"),
        (lambda c: c["camera_matrix"]["data"].pop(), "8 numbers"),
        (lambda c: c["projection_matrix"].update(cols=3), "projection_matrix"),
        (lambda c: c["camera_matrix"]["data"].__setitem__(0, "wide"), "wide"),
        (lambda c: c["camera_matrix"]["data"].__setitem__(0, True), "True"),
        (lambda c: c["camera_matrix"]["data"].__setitem__(0, float("nan")), "nan"),
        (lambda c: c["camera_matrix"].update(data=3), "data must be a list"),
        (lambda c: c.update(image_width="640 px"), "image_width"),
        (lambda c: c.update(distortion_model=7), "distortion_model"),
        (
            lambda c: c["distortion_coefficients"].update(cols=3, data=[0.0] * 3),
            "plumb_bob",
        ),
        (lambda c: c["distortion_coefficients"].update(cols=6), "distortion_coefficients"),
    ],
)
def test_a_malformed_file_is_named_with_its_cause(path, change, cause):
    with pytest.raises(CalibrationFileError) as caught:
        read_calibration(changed(path, change))
    assert str(caught.value).startswith(path)
    assert cause in str(caught.value)


@pytest.mark.parametrize("text", ["", "- 1\n", "image_width: [\n", "%YAML:1.0\n---\n", "\tx: 1\n"])
def test_what_is_no_mapping_is_refused(path, text):
    os.makedirs(os.path.dirname(path))
    with open(path, "w") as file:
        file.write(text)
    with pytest.raises(CalibrationFileError, match="front.yaml"):
        read_calibration(path)


def test_a_file_that_is_no_text_is_refused(path):
    os.makedirs(os.path.dirname(path))
    with open(path, "wb") as file:
        file.write(b"\xff\xfe\x00")
    with pytest.raises(CalibrationFileError, match="cannot read"):
        read_calibration(path)


def test_no_file(path):
    with pytest.raises(CalibrationFileError, match="cannot read"):
        read_calibration(path)


def test_a_folder_that_cannot_be_made_is_one_error(tmp_path):
    (tmp_path / "camera_info").write_text("a file where the folder should be")
    with pytest.raises(CalibrationFileError, match="cannot write"):
        write_calibration(FRONT, str(tmp_path / "camera_info" / "front.yaml"))


def test_a_failed_write_keeps_the_old_file(path, monkeypatch):
    write_calibration(FRONT, path)

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(CalibrationFileError, match="disk full"):
        write_calibration(FRONT._replace(width_px=1), path)
    assert read_calibration(path) == FRONT
    assert os.listdir(os.path.dirname(path)) == ["front.yaml"]


def test_a_link_stays_a_link(path, tmp_path):
    write_calibration(FRONT, path)
    link = tmp_path / "link.yaml"
    link.symlink_to(path)
    write_calibration(FRONT._replace(width_px=320), str(link))
    assert link.is_symlink()
    assert read_calibration(path).width_px == 320
