"""Why a line does not do what it should: the classic causes of "lost sync", told from what was seen of it. No ROS."""

import enum
import errno
import math

from rosserial_python.link import State

_ANY_BYTES = 16  # in which a packet would have begun
_PATIENCE_S = 1.0  # for a first answer
_RECENT_S = 10.0
_OFTEN_S, _OFTEN = 60.0, 3  # losses within this time that are no accident
_MANY_DAMAGED = 3  # recently


class Cause(enum.IntEnum):
    """As in risc_maap_msgs/SerialLink, the worst first."""

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
    Cause.MISSING: "there is no such port: is the cable in? `ls -l /dev/serial/by-id` shows the devices that are there",
    Cause.FORBIDDEN: "this user may not open it: sudo usermod -aG dialout $USER, and log in again",
    Cause.TAKEN: "another program has locked it: end it (serial monitor, second serial_node)",
    Cause.UNREACHABLE: "no connection: is the device on, in this network, and are address and port right?",
    Cause.PORT_FAILED: "the port fails: plug it in anew, and look at dmesg",
    Cause.VERSION: "the device speaks the protocol of ROS groovy: build its sketch with a newer ros_lib",
    Cause.SPEED: "bytes come, but no packet: set ~baud to that of the sketch; is it a rosserial device, is no other "
    "program reading the port?",
    Cause.SILENT: "not one byte comes: wrong port, wrong USB socket of the board (USE_USBCON), or no sketch in it",
    Cause.STOPPED: "the device answers no more: power, reset, or a loop() that blocks; or another reader of the port",
    Cause.TYPES: "topics are refused: build the sketch with a ros_lib that was made from this workspace's messages",
    Cause.SIZE: "messages do not fit into the device's buffer: publish shorter ones, or enlarge it in the sketch",
    Cause.BREAKS: "it is lost and comes back, again and again: power supply, loose cable, or a loop() that blocks",
    Cause.DAMAGE: "damaged packets: cable and ground, Serial.print in the sketch, another reader, or too many "
    "bytes for the line",
}
WARNINGS = frozenset((Cause.TYPES, Cause.SIZE, Cause.BREAKS, Cause.DAMAGE))  # it works, more or less; the others: no

_OF_ERRNO = {
    errno.ENOENT: Cause.MISSING,
    errno.ENODEV: Cause.MISSING,
    errno.ENXIO: Cause.MISSING,
    errno.EACCES: Cause.FORBIDDEN,
    errno.EPERM: Cause.FORBIDDEN,
    errno.EBUSY: Cause.TAKEN,
    errno.EAGAIN: Cause.TAKEN,  # of a lock
    errno.ECONNREFUSED: Cause.UNREACHABLE,
    errno.ECONNRESET: Cause.UNREACHABLE,
    errno.EPIPE: Cause.UNREACHABLE,
    errno.EHOSTUNREACH: Cause.UNREACHABLE,
    errno.ENETUNREACH: Cause.UNREACHABLE,
    errno.ETIMEDOUT: Cause.UNREACHABLE,
}


def cause_of_error(error):
    """`Cause` of an OSError that opening a port has met."""
    if isinstance(error, TimeoutError):
        return Cause.UNREACHABLE
    return _OF_ERRNO.get(error.errno, Cause.PORT_FAILED)


def cause_of(facts, now_s, error=None, refused=(), oversized_s=-math.inf):
    """`Cause` of what is wrong with a line.

    facts: link.Facts.  error: why it is not open, an OSError.  refused: topics that are.  oversized_s: when a message
    was too large last.
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
