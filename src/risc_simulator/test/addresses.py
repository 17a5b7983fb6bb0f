"""Addresses that no other test run of this computer uses at the same time."""

import functools
import itertools
import socket

_TURN = itertools.count()


@functools.cache
def _guard():
    """(Network number, socket that reserves it until this process ends)."""
    for number in range(100, 200):
        guard = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            guard.bind(("127.%d.254.254" % number, 47111))
            return number, guard
        except OSError:  # another run has it
            guard.close()
    raise RuntimeError("all networks from 127.100 to 127.199 are in use by tests")


def own_net():
    """First two bytes of the loopback addresses reserved for this process, e.g. "127.142"."""
    return "127.%d" % _guard()[0]


def free_port():
    """Return one of this process' 27 UDP ports, in turn. They are below 32768, where Linux's ephemeral ports begin."""
    return 30000 + 27 * (_guard()[0] - 100) + next(_TURN) % 27
