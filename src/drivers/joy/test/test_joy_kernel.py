"""The device layer on a joystick of the kernel, made with uinput; skipped with a reason where that is impossible."""

import fcntl
import os
import pathlib
import select
import struct
import time

import pytest

from joy.device import device_name, find_by_name, open_device
from joy.device_records import JoySettings, JoyState, RecordReader

NAME = "risc maap test pad"
EV_KEY, EV_ABS, BTN_SOUTH, ABS_X = 0x01, 0x03, 0x130, 0x00
UI_SET_EVBIT, UI_SET_KEYBIT, UI_SET_ABSBIT, UI_DEV_CREATE = 0x40045564, 0x40045565, 0x40045567, 0x5501


@pytest.fixture
def pad():
    """File descriptor that feeds a kernel joystick with one axis and one button."""
    try:
        fd = os.open("/dev/uinput", os.O_WRONLY | os.O_NONBLOCK)
    except OSError as error:
        pytest.skip("no uinput here (/dev/uinput: %s): joy was tested on FIFOs only" % error.strerror)
    before = set(pathlib.Path("/dev/input").glob("js*"))
    for request, value in (
        (UI_SET_EVBIT, EV_KEY),
        (UI_SET_KEYBIT, BTN_SOUTH),
        (UI_SET_EVBIT, EV_ABS),
        (UI_SET_ABSBIT, ABS_X),
    ):
        fcntl.ioctl(fd, request, value)
    limits = [[0] * 64 for _ in range(4)]  # absmax, absmin, absfuzz, absflat
    limits[0][ABS_X], limits[1][ABS_X] = 32767, -32767
    identity = struct.pack("@80sHHHHI", NAME.encode(), 3, 1, 1, 1, 0)
    os.write(fd, identity + b"".join(struct.pack("@64i", *row) for row in limits))
    fcntl.ioctl(fd, UI_DEV_CREATE)
    deadline = time.monotonic() + 5.0
    while set(pathlib.Path("/dev/input").glob("js*")) == before:
        if time.monotonic() > deadline:
            os.close(fd)
            pytest.skip("uinput makes no /dev/input/js* here (no joydev module, or no udev)")
        time.sleep(0.05)
    yield fd
    os.close(fd)


def test_kernel_joystick(pad):
    path = find_by_name(NAME)
    assert path is not None
    device = open_device(path)
    reader, state = RecordReader(), JoyState(JoySettings())
    try:
        assert device_name(device) == NAME
        for kind, code, value in ((EV_KEY, BTN_SOUTH, 1), (EV_ABS, ABS_X, -32767)):
            os.write(pad, struct.pack("@llHHi", 0, 0, kind, code, value) + struct.pack("@llHHi", 0, 0, 0, 0, 0))
        deadline = time.monotonic() + 15.0
        while (state.buttons, state.axes) != ([1], [1.0]):
            assert time.monotonic() < deadline, (state.buttons, state.axes)
            if select.select([device], [], [], 0.1)[0]:
                for event in reader.feed(os.read(device, 512)):
                    state.apply(event)
    finally:
        os.close(device)
