"""Kernel interface of a joystick: device files, names, rumble. No ROS.

Anything that yields the same 8-byte records can be read, e.g. a FIFO; it has no name and no rumble.
"""

import fcntl
import glob
import os
import stat
import struct

_NAME_BYTES = 128
_JSIOCGNAME = 0x80006A13 | _NAME_BYTES << 16  # _IOC(read, 'j', 0x13, length)
_EV_FF = 0x15
_FF_RUMBLE = 0x50
_FF_GAIN = 0x60
_RUMBLE_LENGTH_MS = 1000
# struct ff_effect of 64-bit kernels: type, id, direction, trigger (2), length and delay [ms], then for a rumble the
# strong and the weak motor; the rest is for other effects.
_FF_EFFECT = struct.Struct("=HhHHHHH2xHH28x")
_EVIOCSFF = 0x40004580 | _FF_EFFECT.size << 16  # _IOC(write, 'E', 0x80, size)
_INPUT_EVENT = struct.Struct("@llHHi")  # struct input_event: time (ignored when written), type, code, value


def device_name(fd):
    """Name of an opened joystick; "" for any other file."""
    buffer = bytearray(_NAME_BYTES)
    try:
        fcntl.ioctl(fd, _JSIOCGNAME, buffer, True)
    except OSError:
        return ""
    return buffer.split(b"\0", 1)[0].decode("utf-8", "replace")


def open_device(path):
    """Open a joystick for reading without blocking; returns the file descriptor. Raises OSError."""
    fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    if stat.S_ISCHR(os.fstat(fd).st_mode):
        # The first opening announces the values of the last closing; the second one announces the current values.
        os.close(fd)
        fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    return fd


def find_by_name(name, pattern="/dev/input/js*"):
    """Path of the first joystick device with this name, or None."""
    for path in sorted(glob.glob(pattern)):
        try:
            fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError:
            continue  # unplugged meanwhile, or no permission to read
        try:
            if device_name(fd) == name:
                return path
        finally:
            os.close(fd)
    return None


class Rumble:
    """The two motors of a game pad. Raises OSError when the event device cannot be opened or used."""

    def __init__(self, path, ioctl=fcntl.ioctl):
        self._ioctl = ioctl
        self._fd = os.open(path, os.O_RDWR)
        self._effect = -1  # the kernel's id of our effect; -1 asks for a new one
        self._motors = [0, 0]
        try:
            self._write(_FF_GAIN, 0xFFFF)
        except OSError:
            self.close()
            raise

    def set(self, intensities):
        """Set the intensity in [0, 1] by motor: {0: strong, 1: weak}; other motors keep theirs."""
        for motor, intensity in intensities.items():
            self._motors[motor] = int(0xFFFF * intensity)
        buffer = bytearray(_FF_EFFECT.pack(_FF_RUMBLE, self._effect, 0, 0, 0, _RUMBLE_LENGTH_MS, 0, *self._motors))
        self._ioctl(self._fd, _EVIOCSFF, buffer, True)
        self._effect = _FF_EFFECT.unpack(buffer)[1]
        self._write(self._effect, 1)

    def close(self):
        os.close(self._fd)

    def _write(self, code, value):
        os.write(self._fd, _INPUT_EVENT.pack(0, 0, _EV_FF, code, value))
