"""The kernel's side of a joystick: device files, names, rumble. No ROS.

Anything that yields the same 8-byte records can be read, e.g. a FIFO; it has no name and no rumble.
"""

import ctypes
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
_INPUT_EVENT = struct.Struct("@llHHi")  # struct input_event: time (ignored when written), type, code, value


def device_name(fd):
    """Name of an opened joystick; "" for what is no joystick."""
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
        # The first opening announces the values of the last closing; the second one the true ones.
        os.close(fd)
        fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    return fd


def find_by_name(name, pattern="/dev/input/js*"):
    """Path of the first joystick device with this name, or None."""
    for path in sorted(glob.glob(pattern)):
        try:
            fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError:
            continue  # unplugged meanwhile, or not ours to read
        try:
            if device_name(fd) == name:
                return path
        finally:
            os.close(fd)
    return None


class _Periodic(ctypes.Structure):
    """The largest effect; it only gives the union its size and alignment."""

    _fields_ = [
        ("waveform_to_phase", ctypes.c_uint16 * 5),
        ("envelope", ctypes.c_uint16 * 4),
        ("custom_len", ctypes.c_uint32),
        ("custom_data", ctypes.c_void_p),
    ]


class _Effect(ctypes.Union):
    _fields_ = [("rumble", ctypes.c_uint16 * 2), ("periodic", _Periodic)]


class FfEffect(ctypes.Structure):
    """struct ff_effect of linux/input.h, as far as rumble needs it."""

    _fields_ = [
        ("type", ctypes.c_uint16),
        ("id", ctypes.c_int16),
        ("direction", ctypes.c_uint16),
        ("trigger", ctypes.c_uint16 * 2),
        ("replay", ctypes.c_uint16 * 2),  # length, delay [ms]
        ("effect", _Effect),
    ]


_EVIOCSFF = 0x40004580 | ctypes.sizeof(FfEffect) << 16  # _IOC(write, 'E', 0x80, size)


class Rumble:
    """The two motors of a game pad. Raises OSError when the event device cannot be opened or used."""

    def __init__(self, path, ioctl=fcntl.ioctl):
        self._ioctl = ioctl
        self._fd = os.open(path, os.O_RDWR)
        self._effect = FfEffect(type=_FF_RUMBLE, id=-1)
        self._effect.replay[0] = _RUMBLE_LENGTH_MS
        try:
            self._write(_FF_GAIN, 0xFFFF)
        except OSError:
            self.close()
            raise

    def set(self, intensities):
        """Intensity in [0, 1] by motor: {0: strong, 1: weak}; motors that are not named keep theirs."""
        for motor, intensity in intensities.items():
            self._effect.effect.rumble[motor] = int(0xFFFF * intensity)
        buffer = bytearray(bytes(self._effect))
        self._ioctl(self._fd, _EVIOCSFF, buffer, True)
        self._effect.id = FfEffect.from_buffer_copy(buffer).id  # the kernel's number, to change this effect later
        self._write(self._effect.id, 1)

    def close(self):
        os.close(self._fd)

    def _write(self, code, value):
        os.write(self._fd, _INPUT_EVENT.pack(0, 0, _EV_FF, code, value))
