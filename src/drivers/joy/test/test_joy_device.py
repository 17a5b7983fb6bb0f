"""joy.device: devices other than joysticks are tolerated; rumble structures have the kernel's layout."""

import os
import struct

import pytest

from joy.device import _EVIOCSFF, _FF_EFFECT, Rumble, device_name, find_by_name, open_device


def test_a_fifo_opens_at_once_and_has_no_name(tmp_path):
    path = str(tmp_path / "stick")
    os.mkfifo(path)
    fd = open_device(path)
    try:
        assert device_name(fd) == ""
    finally:
        os.close(fd)
    assert find_by_name("pad", str(tmp_path / "*")) is None


def test_missing_device_raises_oserror(tmp_path):
    with pytest.raises(FileNotFoundError):
        open_device(str(tmp_path / "js0"))
    with pytest.raises(FileNotFoundError):
        Rumble(str(tmp_path / "event0"))


def test_rumble_uploads_once_and_then_changes_the_same_effect(tmp_path):
    path = tmp_path / "event0"
    path.write_bytes(b"")
    uploads = []

    def ioctl(fd, request, buffer, mutate):
        assert request == _EVIOCSFF
        uploads.append(_FF_EFFECT.unpack(buffer))
        struct.pack_into("=h", buffer, 2, 7)  # the kernel fills in its number for a new effect

    rumble = Rumble(str(path), ioctl)
    rumble.set({0: 1.0})
    rumble.set({1: 0.5})
    rumble.close()
    assert [upload[:2] for upload in uploads] == [(0x50, -1), (0x50, 7)]
    assert uploads[1][5:] == (1000, 0, 0xFFFF, 0x7FFF), "the other motor keeps its intensity"
    # gain, then one play command per upload
    events = list(struct.iter_unpack("@llHHi", path.read_bytes()))
    assert [event[2:] for event in events] == [(0x15, 0x60, 0xFFFF), (0x15, 7, 1), (0x15, 7, 1)]


def test_effect_has_the_size_of_the_kernels_structure():
    assert _FF_EFFECT.size == 48 and _EVIOCSFF == 0x40304580
