"""Diagnosis of a faulty line: finds the classic causes of "lost sync" from what was observed on it. No ROS."""

import enum
import errno
import math

from rosserial_python.link import State

_ANY_BYTES = 16  # a packet would have begun within this many bytes
_PATIENCE_S = 1.0  # for a first answer
_RECENT_S = 10.0
_OFTEN_S, _OFTEN = 60.0, 3  # this many losses within this time are no accident
_MANY_DAMAGED = 3  # within _RECENT_S


class Cause(enum.IntEnum):
    """Causes as in risc_maap_msgs/SerialLink, the worst first."""

    NONE = 0
    MISSING = 1
    FORBIDDEN = 2
    TAKEN = 3
    UNREACHABLE = 4
    PORT_FAILED = 5
    VERSION = 6
    SPEED = 7
    SILENT = 8
    STOPPED = 9
    TYPES = 10
    SIZE = 11
    BREAKS = 12
    DAMAGE = 13


TEXTS = {
    Cause.NONE: "",
    Cause.MISSING: "no such port: is the cable plugged in? `ls -l /dev/serial/by-id` lists the devices",
    Cause.FORBIDDEN: "permission denied: sudo usermod -aG dialout $USER, then log in again",
    Cause.TAKEN: "the port is in use: stop the other program (serial monitor, second serial_node)",
    Cause.UNREACHABLE: "no connection: check the device's power and network, the address and the port",
    Cause.PORT_FAILED: "the port failed: unplug and replug it, and check dmesg",
    Cause.VERSION: "the device speaks the protocol of ROS groovy: rebuild its sketch with a newer ros_lib",
    Cause.SPEED: "bytes arrive, but no packets: set ~baud to the sketch's baud rate; check that this is a rosserial "
    "device, and that no other program reads the port",
    Cause.SILENT: "no data: wrong port, wrong USB connector of the board (USE_USBCON), or no sketch loaded",
    Cause.STOPPED: "the device has stopped answering: check its power, reset it, look for a loop() that blocks, or for "
    "another program that reads the port",
    Cause.TYPES: "topics rejected: rebuild the sketch with a ros_lib generated from this workspace's messages",
    Cause.SIZE: "messages exceed the device's buffer: publish shorter ones, or enlarge the buffer in the sketch",
    Cause.BREAKS: "the link keeps dropping: check the power supply and the cable, look for a loop() that blocks",
    Cause.DAMAGE: "corrupt packets: check the cable and the ground, look for Serial.print in the sketch, another "
    "program that reads the port, or more data than the line carries",
}
WARNINGS = frozenset((Cause.TYPES, Cause.SIZE, Cause.BREAKS, Cause.DAMAGE))  # the link still works

_OF_ERRNO = {
    errno.ENOENT: Cause.MISSING,
    errno.ENODEV: Cause.MISSING,
    errno.ENXIO: Cause.MISSING,
    errno.EACCES: Cause.FORBIDDEN,
    errno.EPERM: Cause.FORBIDDEN,
    errno.EBUSY: Cause.TAKEN,
    errno.EAGAIN: Cause.TAKEN,  # the port is locked
    errno.ECONNREFUSED: Cause.UNREACHABLE,
    errno.ECONNRESET: Cause.UNREACHABLE,
    errno.EPIPE: Cause.UNREACHABLE,
    errno.EHOSTUNREACH: Cause.UNREACHABLE,
    errno.ENETUNREACH: Cause.UNREACHABLE,
    errno.ETIMEDOUT: Cause.UNREACHABLE,
}


def cause_of_error(error):
    """Return the `Cause` of an OSError raised on opening a port."""
    if isinstance(error, TimeoutError):
        return Cause.UNREACHABLE
    return _OF_ERRNO.get(error.errno, Cause.PORT_FAILED)


def cause_of(facts, now_s, error=None, refused=(), oversized_s=-math.inf):
    """Return the `Cause` of a line's fault, NONE if there is none.

    facts: link.Facts.  error: OSError because of which the line is not open.  refused: refused topics.  oversized_s:
    when a message was last too large.
    """
    if facts.state is State.CLOSED:
        return Cause.NONE if error is None else cause_of_error(error)
    if facts.state is State.WAITING:
        if facts.speaks_groovy:
            return Cause.VERSION
        if now_s - facts.waits_s >= _PATIENCE_S and facts.bytes >= _ANY_BYTES:
            return Cause.SPEED
        if math.isfinite(facts.heard_s):
            return Cause.STOPPED
        return Cause.SILENT if now_s - facts.waits_s >= _PATIENCE_S else Cause.NONE
    if refused:
        return Cause.TYPES
    if now_s - oversized_s < _RECENT_S:
        return Cause.SIZE
    if sum(now_s - at_s < _OFTEN_S for at_s in facts.lost_s) >= _OFTEN:
        return Cause.BREAKS
    if sum(now_s - at_s < _RECENT_S for at_s in facts.damaged_s) >= _MANY_DAMAGED:
        return Cause.DAMAGE
    return Cause.NONE
