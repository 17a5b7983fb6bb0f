"""Calibration and mount files: what is written is read back; errors name file and key."""

import os
from dataclasses import replace

import pytest
import yaml

from risc_lab.lab.calibration import (
    CameraCalibration,
    CameraMount,
    load_calibration,
    load_mount,
    read_calibration,
    resolve_url,
    save_calibration,
    save_mount,
)

CALIBRATION = CameraCalibration.from_intrinsics(
    "front", (640, 360), (570.0, 568.0), (331.4, 135.9), (-0.53, 0.27, 0.02, -0.006, 0.0)
)


def test_calibration_survives_its_file(tmp_path):
    path = tmp_path / "front.yaml"
    save_calibration(CALIBRATION, path)
    assert load_calibration(str(path)) == CALIBRATION
    assert load_calibration("file://%s" % path) == CALIBRATION


def test_numbers_are_read_as_programs_in_cpp_write_them(tmp_path):
    """yaml-cpp, and with it camera_calibration_parsers, writes 1e-05; YAML 1.1 would read it as a string."""
    path = tmp_path / "front.yaml"
    save_calibration(CALIBRATION, path)
    text = path.read_text(encoding="utf-8")
    assert "-0.006" in text
    path.write_text(text.replace("-0.006", "-6e-03").replace("-0.53", "-5.3E-1"), encoding="utf-8")
    assert load_calibration(str(path)) == CALIBRATION


def test_mount_survives_its_file(tmp_path):
    mount = CameraMount((0.2, -0.01, 0.03), 0.1, -0.2, 0.3)
    save_mount(mount, tmp_path / "mount.yaml")
    loaded = load_mount(str(tmp_path / "mount.yaml"))
    assert loaded.position_m == mount.position_m
    assert (loaded.roll_rad, loaded.pitch_rad, loaded.yaw_rad) == pytest.approx((0.1, -0.2, 0.3))


def broken(tmp_path, change):
    path = tmp_path / "broken.yaml"
    save_calibration(CALIBRATION, path)
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    change(content)
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return str(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("image_width"), "image_width"),
        (lambda c: c.pop("camera_matrix"), "camera_matrix"),
        (lambda c: c.update(image_height=360.5), "image_height"),
        (lambda c: c.update(image_width="640 px"), "image_width"),
        (lambda c: c["camera_matrix"].update(rows=2), "'camera_matrix' .* 3 x 3, found 2 rows"),
        (lambda c: c["camera_matrix"]["data"].pop(), "8 numbers"),
        (lambda c: c["projection_matrix"].update(cols=3), "projection_matrix"),
        (lambda c: c["camera_matrix"]["data"].__setitem__(0, "wide"), "wide"),
        (lambda c: c["camera_matrix"]["data"].__setitem__(0, float("nan")), "nan"),
        (lambda c: c["distortion_coefficients"].update(data="-0.5 0.2 0 0 0"), "a list"),
        (lambda c: c["distortion_coefficients"].update(cols=6), "distortion_coefficients"),
        (lambda c: c.update(distortion_model=7), "distortion_model"),
    ],
)
def test_a_wrong_calibration_file_is_one_clear_error(tmp_path, change, message):
    path = broken(tmp_path, change)
    for read in (read_calibration, load_calibration):
        with pytest.raises(ValueError, match=message) as error:
            read(path)
        assert str(error.value).startswith(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c["camera_matrix"]["data"].__setitem__(0, 0.0), "not calibrated"),
        (lambda c: c.update(image_width=0), "no size"),
        (lambda c: c.update(distortion_model="equidistant"), "plumb_bob"),
        (
            lambda c: c["distortion_coefficients"].update(cols=8, data=[0.1] * 8),
            "5 coefficients, .* 8",
        ),
    ],
)
def test_drivers_take_what_our_camera_cannot_use(tmp_path, change, message):
    path = broken(tmp_path, change)
    read_calibration(path)
    with pytest.raises(ValueError, match=message):
        load_calibration(path)


def test_what_others_write_otherwise_is_read(tmp_path):
    def change(content):
        del content["camera_name"], content["distortion_model"]
        content.update(avg_reprojection_error=0.2)
        content["distortion_coefficients"].update(rows=5, cols=1)

    assert load_calibration(broken(tmp_path, change)) == replace(CALIBRATION, name="unknown")
    short = broken(tmp_path, lambda c: c["distortion_coefficients"].update(cols=4, data=[0.1, 0.2, 0.0, 0.0]))
    assert load_calibration(short).D == (0.1, 0.2, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("text", ["", "- 1\n", "image_width: [\n", "%YAML:1.0\n---\n", "\tx: 1\n"])
def test_what_is_no_mapping_is_refused(tmp_path, text):
    (tmp_path / "front.yaml").write_text(text)
    with pytest.raises(ValueError, match="front.yaml"):
        read_calibration(tmp_path / "front.yaml")


def test_debian_reads_what_we_write(tmp_path):
    parsers = pytest.importorskip("camera_calibration_parsers", reason="python3-camera-calibration-parsers is needed")
    save_calibration(CALIBRATION, tmp_path / "new" / "front.yaml")
    name, info = parsers.readCalibration(str(tmp_path / "new" / "front.yaml"))
    assert CameraCalibration.from_info(info, name) == CALIBRATION


def test_a_failed_write_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "front.yaml"
    save_calibration(CALIBRATION, path)

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        save_calibration(replace(CALIBRATION, width_px=1), path)
    assert load_calibration(str(path)) == CALIBRATION
    assert os.listdir(tmp_path) == ["front.yaml"]


def test_a_link_stays_a_link(tmp_path):
    path, link = tmp_path / "front.yaml", tmp_path / "link.yaml"
    save_calibration(CALIBRATION, path)
    link.symlink_to(path)
    save_calibration(replace(CALIBRATION, width_px=320), link)
    assert link.is_symlink() and load_calibration(str(path)).width_px == 320


def test_a_missing_file_is_named():
    with pytest.raises(ValueError, match="nowhere.yaml"):
        load_calibration("/tmp/nowhere.yaml")


def test_bare_names_and_packages_are_found_in_the_workspace():
    assert resolve_url("package://risc_lab/config/vehicle_types/ardrone.yaml").is_file()
    with pytest.raises(ValueError, match="no_such_package"):
        resolve_url("package://no_such_package/camera.yaml")


def test_the_file_of_a_camera_that_is_not_calibrated_yet_has_its_place():
    path = resolve_url("no_such_camera.yaml")
    assert path.parent.is_dir() and not path.exists()
    assert path == resolve_url("package://risc_lab/config/cameras/no_such_camera.yaml")
    with pytest.raises(ValueError, match="no_such_camera.yaml"):
        load_calibration("no_such_camera.yaml")
