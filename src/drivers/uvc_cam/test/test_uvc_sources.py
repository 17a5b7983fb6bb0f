"""Folders, video files and cameras as sources. Cameras are replaced by stand-ins: the test machine has none."""

import dataclasses
import errno
import itertools
import os
import struct
import time

import cv2
import numpy as np
import pytest

from uvc_cam.settings import CameraSettings
from uvc_cam.sources import CameraSource, FolderSource, NoMorePicturesError, SourceError, VideoSource, open_source

FAST = CameraSettings(frame_rate=240.0)
COLOURS = {"a": (200, 30, 30), "b": (30, 200, 30), "c": (30, 30, 200)}  # blue green red


def settings_for(path, **changes):
    return dataclasses.replace(FAST, device=str(path), **changes)


def next_picture(source):
    source.wait()
    return source.picture()


@pytest.fixture
def folder(tmp_path):
    for name, bgr in COLOURS.items():
        cv2.imwrite(str(tmp_path / (name + ".png")), np.full((48, 64, 3), bgr, np.uint8))
    (tmp_path / "notes.txt").write_text("no picture")
    return tmp_path


@pytest.fixture
def video(tmp_path):
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 15.0, (64, 48))
    assert writer.isOpened()
    for bgr in COLOURS.values():
        writer.write(np.full((48, 64, 3), bgr, np.uint8))
    writer.release()
    return path


def test_pictures_of_a_folder_come_in_order_and_again(folder):
    source = open_source(settings_for(folder))
    assert isinstance(source, FolderSource)
    for bgr in itertools.islice(itertools.cycle(COLOURS.values()), 7):
        assert tuple(next_picture(source)[10, 10]) == bgr
    assert source.notes == []


def test_a_folder_ends_when_it_is_not_to_loop(folder):
    source = open_source(settings_for(folder, loop=False))
    for _ in COLOURS:
        source.wait()
    with pytest.raises(NoMorePicturesError, match="all 3 pictures"):
        source.wait()


def test_an_unreadable_picture_is_told_and_left_out(folder):
    (folder / "b.png").write_bytes(b"no picture")
    source = open_source(settings_for(folder))
    seen = [tuple(next_picture(source)[10, 10]) for _ in range(4)]
    assert seen == [COLOURS[name] for name in "acac"]
    (note,) = source.notes
    assert "b.png" in note


def test_folders_without_pictures_are_named(tmp_path):
    with pytest.raises(SourceError, match="%s$" % tmp_path):
        open_source(settings_for(tmp_path))
    for name in ("a.png", "b.jpg"):
        (tmp_path / name).write_bytes(b"")
    source = open_source(settings_for(tmp_path))
    with pytest.raises(SourceError, match="%s " % tmp_path):
        source.wait()


def test_a_folder_that_is_emptied_while_it_plays_is_told(folder):
    source = open_source(settings_for(folder))
    source.wait()
    for name in COLOURS:
        (folder / (name + ".png")).unlink()
    with pytest.raises(SourceError, match="%s " % folder):
        source.wait()


def test_grey_pictures_become_three_channels(tmp_path):
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((4, 5), 77, np.uint8))
    picture = next_picture(open_source(settings_for(tmp_path)))
    assert picture.shape == (4, 5, 3) and (picture == 77).all()


def test_a_folder_is_played_at_the_frame_rate(folder):
    source = open_source(settings_for(folder, frame_rate=50.0))
    source.wait()
    start_s = time.monotonic()
    for _ in range(5):
        source.wait()
    assert time.monotonic() - start_s > 0.095, "five pictures at 50 Hz; a loaded computer may take longer"


def test_a_video_is_played_in_order_and_again(video):
    source = open_source(settings_for(video))
    assert isinstance(source, VideoSource)
    for bgr in itertools.islice(itertools.cycle(COLOURS.values()), 7):
        assert next_picture(source)[10, 10].tolist() == pytest.approx(bgr, abs=12), "JPEG is not exact"
    source.close()


def test_a_picture_that_nobody_wants_still_passes(video):
    source = open_source(settings_for(video))
    source.wait()
    assert next_picture(source)[10, 10].tolist() == pytest.approx(COLOURS["b"], abs=12)
    source.close()


def test_a_video_ends_when_it_is_not_to_loop(video):
    source = open_source(settings_for(video, loop=False))
    for _ in COLOURS:
        source.wait()
    with pytest.raises(NoMorePicturesError, match="clip.avi"):
        source.wait()
    source.close()


def test_a_file_that_is_no_video_is_named(tmp_path):
    path = tmp_path / "letter.avi"
    path.write_bytes(b"Dear Sir or Madam")
    with pytest.raises(SourceError, match="letter.avi"):
        open_source(settings_for(path))


@pytest.mark.parametrize("device", ["/dev/video987", "987", "/nowhere/pictures"])
def test_a_missing_device_is_named_with_the_cure(device):
    with pytest.raises(SourceError, match="(987|pictures).* device "):
        open_source(settings_for(device))


def test_a_device_that_is_no_camera_is_named():
    with pytest.raises(SourceError, match="/dev/null .*v4l2-ctl --list-devices"):
        open_source(settings_for("/dev/null"))


class Capture:
    """Stands in for cv2.VideoCapture on a camera that has only 320 x 240 and no sharpness control."""

    made = []

    def __init__(self, path, api):
        assert api == cv2.CAP_V4L2
        self.path, self.asked, self.left, self.released = path, {}, 3, False
        Capture.made.append(self)

    def isOpened(self):
        return True

    def set(self, key, value):
        self.asked[key] = value
        return key != cv2.CAP_PROP_SHARPNESS

    def get(self, key):
        return {cv2.CAP_PROP_FRAME_WIDTH: 320.0, cv2.CAP_PROP_FRAME_HEIGHT: 240.0}[key]

    def grab(self):
        self.left -= 1
        return self.left >= 0

    def retrieve(self):
        return True, np.zeros((240, 320), np.uint8)

    def release(self):
        self.released = True


@pytest.fixture
def camera_path(tmp_path):
    path = tmp_path / "video0"
    path.write_bytes(b"")
    return path


def test_a_camera_is_asked_for_what_the_settings_say(camera_path):
    source = CameraSource(camera_path, CameraSettings(format_mode=3, frame_rate=30.0), Capture)
    asked = Capture.made[-1].asked
    assert asked == {
        cv2.CAP_PROP_FOURCC: cv2.VideoWriter_fourcc(*"MJPG"),
        cv2.CAP_PROP_FRAME_WIDTH: 640,
        cv2.CAP_PROP_FRAME_HEIGHT: 480,
        cv2.CAP_PROP_FPS: 30.0,
    }, "unchanged controls are left alone"
    (note,) = source.notes
    assert "320 x 240" in note and "640 x 480" in note
    assert next_picture(source).shape == (240, 320, 3)
    source.close()
    assert Capture.made[-1].released


def test_controls_are_set_when_they_differ_and_refusals_are_told(camera_path):
    settings = CameraSettings(width=320, height=240, exposure=3, gain=5, sharpness=7)
    source = CameraSource(camera_path, settings, Capture)
    asked = Capture.made[-1].asked
    assert (asked[cv2.CAP_PROP_AUTO_EXPOSURE], asked[cv2.CAP_PROP_GAIN]) == (3.0, 5.0)
    assert cv2.CAP_PROP_BRIGHTNESS not in asked
    assert ["sharpness = 7" in note for note in source.notes] == [True]
    source.notes.clear()
    source.set_controls({"brightness": 12})
    assert asked[cv2.CAP_PROP_BRIGHTNESS] == 12.0 and source.notes == []


def test_power_line_frequency_goes_to_the_kernel(camera_path):
    calls = []

    def ioctl(fd, request, argument):
        assert os.fstat(fd).st_ino == os.stat(str(camera_path)).st_ino
        calls.append((request, struct.unpack("=Ii", argument)))
        if calls[1:]:
            raise OSError(errno.EINVAL, "Invalid argument")

    source = CameraSource(camera_path, CameraSettings(width=320, height=240, power_line_frequency=1), Capture, ioctl)
    # VIDIOC_S_CTRL and V4L2_CID_POWER_LINE_FREQUENCY of linux/videodev2.h
    assert calls == [(0xC008561C, (0x00980900 + 24, 1))]
    assert source.notes == []
    source.set_controls({"power_line_frequency": 2})
    assert "power_line_frequency = 2" in source.notes[0]


def test_a_camera_that_is_pulled_out_is_lost(camera_path):
    source = CameraSource(camera_path, CameraSettings(width=320, height=240), Capture)
    for _ in range(3):
        next_picture(source)
    with pytest.raises(SourceError, match="video0 "):
        source.wait()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open everything")
def test_a_camera_without_permission_says_which_group(camera_path):
    camera_path.chmod(0)
    with pytest.raises(SourceError, match="group video"):
        CameraSource(camera_path, CameraSettings(), Capture)
