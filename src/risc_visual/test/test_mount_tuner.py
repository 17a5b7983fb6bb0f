"""Tuning a mount: actions and answers; the file; the sliders' limits; the handles' axes."""

import itertools
import math
import os
import re
import threading
from dataclasses import replace

import numpy as np
import pytest

from risc_lab.camera import Camera, bearings_of_rays, cortex_to_camera
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.calibration import FRONT_MOUNT, CameraCalibration, CameraMount, load_mount, save_mount
from risc_lab.lab.fleet import FleetVehicle, Start
from risc_visual.cfg import TransformTunerConfig
from risc_visual.tuner.mount_tuner import LIMITS, NUMBERS, MountTuner, TunerParams, mount_of, numbers_of, text_of
from risc_visual.tuner.ros.mount_marker import mount_marker, numbers_from_pose, pose_of

VEHICLE = FleetVehicle("risc1", "fluffy_II", "ardrone", "127.0.0.2", Start((0.0, 0.0, 0.0)))
TRUE = CameraMount((0.15, 0.03, -0.02), math.radians(1.0), math.radians(8.0), math.radians(-6.0))
CAMERA = Camera(CameraCalibration.from_intrinsics("wide", (640, 360), (580.0, 580.0), (320.0, 180.0)))
PLACES = {"green": (2.3, 0.8, 1.5), "pink": (2.3, -0.8, 1.2)}
T0_S = 1.7e9


def vehicle_with(path):
    save_mount(FRONT_MOUNT, path)
    return replace(VEHICLE, camera_mount=str(path))


def fill(tuner, duration_s=30.0, mount=TRUE, moving=True):
    """Feed the tuner the bearings of a camera at this mount, without noise, while the vehicle moves."""
    tuner.window.see_landmarks(PLACES)
    for k in range(int(50 * duration_s)):
        t_s = k / 50.0 if moving else 0.0
        position = np.array((1.3 * np.sin(0.9 * t_s), np.cos(1.3 * t_s), 1.2 + 0.4 * np.sin(t_s)))
        euler = (0.1 * np.sin(2.0 * t_s), 0.1 * np.cos(1.7 * t_s), 0.3 * np.sin(0.8 * t_s))
        tuner.window.see_pose(T0_S + k / 50.0, position, euler)
        if k % 3 == 0:
            seen = cortex_to_camera(np.array(list(PLACES.values())), position, rotation_body_to_cortex(*euler), mount)
            in_picture = CAMERA.in_picture(CAMERA.project(seen))
            bearings = zip(PLACES, zip(*bearings_of_rays(seen)))
            tuner.window.see_bearings(T0_S + k / 50.0, dict(itertools.compress(bearings, in_picture)))
    return tuner.window.samples()


def test_solve_check_and_save_say_what_they_did(tmp_path):
    tuner = MountTuner(vehicle_with(tmp_path / "mount.yaml"))
    to_solve, to_check = fill(tuner)
    good, text = tuner.check(to_check, CAMERA)
    assert not good and "0.60 deg" in text
    done, text = tuner.solve(to_solve, CAMERA)
    assert done and "WARNING" not in text
    assert "risc1: solved: 0.00 deg (0.0 px) RMS of %d bearings" % len(to_solve.times_s) in text
    np.testing.assert_allclose(numbers_of(tuner.mount), numbers_of(TRUE), atol=1e-3)
    good, text = tuner.check(to_check, CAMERA)
    assert good and text.startswith("risc1: good: 0.00 deg (0.0 px) RMS of %d bearings" % len(to_check.times_s))
    done, text = tuner.save()
    assert done and str(tmp_path / "mount.yaml") in text
    np.testing.assert_allclose(numbers_of(load_mount(str(tmp_path / "mount.yaml"))), numbers_of(tuner.mount))
    assert [path.name for path in tmp_path.iterdir()] == ["mount.yaml"], "nothing is left over"
    saved = tuner.mount
    tuner.change({"yaw": 30.0})
    done, text = tuner.reset()
    assert done and tuner.mount == saved and "file" in text


def test_before_anything_is_saved_reset_goes_back_to_the_beginning(tmp_path):
    tuner = MountTuner(vehicle_with(tmp_path / "mount.yaml"))
    tuner.change({"yaw": 30.0})
    done, text = tuner.reset()
    assert done and tuner.mount == FRONT_MOUNT and "file" in text


def test_a_mount_that_few_bearings_agree_with_is_not_good():
    tuner = MountTuner(VEHICLE)
    to_solve, to_check = fill(tuner)
    assert tuner.solve(to_solve)[0]
    wrong = np.arange(len(to_check.times_s)) % 5 < 2
    to_check.rays[wrong] = (0.0, 0.0, 1.0)  # straight down
    good, text = tuner.check(to_check, CAMERA)
    assert not good and " 35 %" in text and "%d wrong" % wrong.sum() in text
    tuner.change({"yaw": tuner.numbers["yaw"] + 3.0})
    good, text = tuner.check(to_check, CAMERA)
    assert not good and "0.60 deg" in text


def test_a_mount_that_is_reset_while_a_handle_moves_stays_reset():
    tuner = MountTuner(VEHICLE)
    tuner.change({"yaw": 30.0})
    resetting = threading.Thread(target=tuner.reset)

    class Slow(dict):
        """Numbers that are read while another thread resets the mount."""

        def get(self, *arguments):
            if resetting.ident is None:
                resetting.start()
                resetting.join(0.5)
            return dict.get(self, *arguments)

    tuner.change(Slow(x=0.5))
    resetting.join()
    assert tuner.mount == FRONT_MOUNT


def test_solve_warns_when_the_views_are_too_few():
    tuner = MountTuner(VEHICLE)
    to_solve, _ = fill(tuner, moving=False)
    done, text = tuner.solve(to_solve)
    assert done and "WARNING: x is " in text


def test_without_bearings_nothing_changes():
    tuner = MountTuner(VEHICLE)
    nothing, aside = tuner.window.samples()
    for done, text in (tuner.solve(nothing), tuner.check(aside)):
        assert not done and re.match("risc1: .*0 bearings .*30 ", text)
    assert tuner.mount == FRONT_MOUNT


def test_record_begins_afresh():
    tuner = MountTuner(VEHICLE)
    assert len(fill(tuner, 6.0)[0].times_s) > 0
    assert tuner.record()[0]
    assert len(tuner.window.samples()[0].times_s) == 0


def test_save_needs_a_file_that_the_fleet_names_and_that_can_be_written(tmp_path):
    done, text = MountTuner(VEHICLE).save()
    assert not done and "camera_mount for risc1" in text
    path = tmp_path / "mount.yaml"
    tuner = MountTuner(vehicle_with(path))
    before = path.read_bytes()
    (tmp_path / ("mount.yaml.%d" % os.getpid())).mkdir()  # its temporary file cannot be written
    tuner.change({"x": 0.5})
    done, text = tuner.save()
    assert not done and str(path) in text
    assert path.read_bytes() == before
    (tmp_path / "folder.yaml" / "full").mkdir(parents=True)  # the final file cannot be replaced
    tuner = MountTuner(replace(VEHICLE, camera_mount=str(tmp_path / "folder.yaml")), TunerParams(nominal=True))
    done, text = tuner.save()
    assert not done and "folder.yaml" in text
    assert {path.name for path in tmp_path.glob("folder*")} == {"folder.yaml"}, "nothing is left over"
    assert "nominal" in tuner.reset()[1]
    tuner = MountTuner(replace(VEHICLE, camera_mount="package://no_such_package/mount.yaml"), TunerParams(nominal=True))
    done, text = tuner.save()
    assert not done and "no_such_package" in text


def test_a_new_file_is_begun_from_the_nominal_mount(tmp_path):
    path = tmp_path / "new.yaml"
    with pytest.raises(ValueError, match=r"new\.yaml"):
        MountTuner(replace(VEHICLE, camera_mount=str(path)))
    tuner = MountTuner(replace(VEHICLE, camera_mount=str(path)), TunerParams(nominal=True))
    assert tuner.mount == FRONT_MOUNT and "nominal" in tuner.reset()[1]
    assert tuner.save()[0] and load_mount(str(path)) == FRONT_MOUNT


def test_a_linked_file_stays_a_link(tmp_path):
    tuner = MountTuner(vehicle_with(tmp_path / "mount.yaml"))
    (tmp_path / "link.yaml").symlink_to(tmp_path / "mount.yaml")
    tuner = MountTuner(replace(VEHICLE, camera_mount=str(tmp_path / "link.yaml")))
    tuner.change({"yaw": 3.0})
    assert tuner.save()[0]
    assert (tmp_path / "link.yaml").is_symlink()
    assert numbers_of(load_mount(str(tmp_path / "mount.yaml")))[5] == pytest.approx(3.0)


def test_sliders_change_one_number_and_stop_at_their_ends():
    tuner = MountTuner(VEHICLE)
    tuner.change({"yaw": 4.0})
    assert numbers_of(tuner.mount) == pytest.approx((0.21, 0.0, 0.0, 0.0, 0.0, 4.0))
    assert tuner.shows({"x": 0.21, "y": 0.0, "z": 0.0, "roll": 0.0, "pitch": 0.0, "yaw": 4.0})
    assert not tuner.shows({"x": 0.21, "y": 0.0, "z": 0.0, "roll": 0.0, "pitch": 0.0, "yaw": 4.1})
    tuner.change({"x": 7.0, "pitch": -120.0})
    assert tuner.numbers["x"] == 1.0 and tuner.numbers["pitch"] == pytest.approx(-90.0)


def test_a_number_that_is_none_moves_nothing():
    tuner = MountTuner(VEHICLE)
    with pytest.raises(ValueError, match="risc1: .*finite"):
        tuner.change({"x": math.nan})
    assert tuner.mount == FRONT_MOUNT


def test_the_sliders_are_the_numbers_of_a_mount():
    assert tuple(sorted(TransformTunerConfig.defaults)) == tuple(sorted(NUMBERS))
    for name, limit, value in zip(NUMBERS, LIMITS, numbers_of(FRONT_MOUNT)):
        assert (TransformTunerConfig.min[name], TransformTunerConfig.max[name]) == (-limit, limit)
        assert TransformTunerConfig.defaults[name] == pytest.approx(value)


def test_the_text_in_the_view():
    tuner = MountTuner(VEHICLE)
    nothing = tuner.window.samples()
    (line,) = tuner.lines(nothing[0], *nothing, seen=False)
    assert "motion capture" in line
    assert [re.findall(r"\d+", line) for line in tuner.lines(nothing[0], *nothing)] == [["1"], ["0", "0"], []]
    windows = fill(tuner, mount=CameraMount(FRONT_MOUNT.position_m, 0.0, 0.0, math.radians(3.0)))
    tuner.window.see_bearings(T0_S + 29.0, {"unheard_of": (0.0, 0.0)})
    lines = tuner.lines(tuner.window.latest(3.0), *windows, camera=CAMERA)
    rms_deg, rms_px = map(float, re.match(r"risc1: (.*) deg \((.*) px\) RMS of \d+ bearings$", lines[0]).groups())
    assert rms_deg == pytest.approx(3.0, abs=0.1)  # a turn moves what is above or below the axis a little less
    assert rms_px == pytest.approx(580.0 * math.radians(3.0), rel=0.3)
    assert re.findall(r"\d+", lines[1]) == [str(len(window.times_s)) for window in windows]
    assert len(lines) == 3 and " 1," in lines[2] and "unheard_of" in lines[2]
    still = MountTuner(VEHICLE)
    lines = still.lines(still.window.latest(3.0), *fill(still, moving=False))
    assert "x is " in lines[2]


@pytest.mark.parametrize("mount", [FRONT_MOUNT, TRUE, CameraMount((0.0, 0.1, 0.2), 0.5, -1.2, 3.0)])
def test_the_handles_say_the_mount(mount):
    numbers = numbers_from_pose(pose_of(mount))
    np.testing.assert_allclose([numbers[key] for key in NUMBERS], numbers_of(mount), atol=1e-9)
    np.testing.assert_allclose(numbers_of(mount_of(numbers_of(mount))), numbers_of(mount))


def test_the_marker_sits_in_the_body_with_six_handles_and_a_menu():
    marker = mount_marker("risc1", "fluffy_II", TRUE, ["Solve", "Save"])
    assert (marker.name, marker.header.frame_id) == ("risc1", "fluffy_II_body_frame")
    assert not marker.header.stamp.to_sec(), "it goes with the vehicle"
    assert [(entry.id, entry.title) for entry in marker.menu_entries] == [(1, "Solve"), (2, "Save")]
    handles = [control for control in marker.controls if not control.markers]
    assert len({control.name for control in marker.controls}) == len(marker.controls) == 7
    for control, axis in zip(handles, np.vstack((np.eye(3), np.eye(3)))):
        turn = control.orientation
        x = np.array(  # where the quaternion turns the x axis to
            (
                1.0 - 2.0 * (turn.y**2 + turn.z**2),
                2.0 * (turn.x * turn.y + turn.w * turn.z),
                2.0 * (turn.x * turn.z - turn.w * turn.y),
            )
        )
        np.testing.assert_allclose(x, axis, atol=1e-12)


def test_a_mount_in_words():
    assert text_of(CameraMount((-1e-5, 0.0, -0.0312), 0.0, -1e-6, 0.1)) == (
        "x 0.000, y 0.000, z -0.031 m, roll 0.00, pitch 0.00, yaw 5.73 deg"
    )
    assert text_of(FRONT_MOUNT) == "x 0.210, y 0.000, z 0.000 m, roll 0.00, pitch 0.00, yaw 0.00 deg"


@pytest.mark.parametrize("bad", [{"rate_hz": 0.0}, {"live_s": -1.0}, {"rms_good_deg": 0.0}])
def test_bad_settings_are_named(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        TunerParams(**bad)
