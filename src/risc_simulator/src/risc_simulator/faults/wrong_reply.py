"""With this probability the command of a datagram of Cortex (its first two bytes) is replaced by another one."""

import struct

from cortex_ros.wire import Command


def make(severity, rng):
    def act(datagram, now_s):
        if isinstance(datagram, bytes) and len(datagram) >= 2 and rng.random() < severity:
            others = [code for code in Command if code != int.from_bytes(datagram[:2], "little")]
            datagram = struct.pack("<H", others[rng.integers(len(others))]) + datagram[2:]
        return [(0.0, datagram)]

    return act
