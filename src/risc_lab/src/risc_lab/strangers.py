"""Senders that are not allowed at one of our ports: refused, counted, and named once. No ROS.

Senders are told apart by their addresses. A forged address is taken for its owner's: see docs/security.md.
"""

import contextlib
import ctypes
import ipaddress
import socket
import struct
from collections import Counter

MAX_NAMED = 16  # addresses per port; a flood may have any number of senders
SEEN = 64  # datagrams of strangers that the program looks at before the kernel refuses them
SAMPLE = 1024  # one in this many of those that the kernel refuses gets through, so that its sender can be named

_SO_ATTACH_FILTER, _SO_DETACH_FILTER, _SO_MEMINFO = 26, 27, 55  # asm-generic/socket.h; Python has no names for them
_MEMINFO = struct.Struct("=9I")  # the last is the number of datagrams dropped
# A program of classic BPF, see linux/filter.h: code, jump if true, jump if false, operand
_INSTRUCTION = struct.Struct("=HBBI")
_LOAD_WORD, _LOAD_HALF, _IF_EQUAL, _IF_ANY_BIT, _RETURN = 0x20, 0x28, 0x15, 0x45, 0x06
_SOURCE_ADDRESS, _SOURCE_PORT, _RANDOM = 0xFFF00000 + 12, 0, 0xFFFFF000 + 56
_ALL_BYTES = 0x40000


class Strangers:
    """Senders that one port has refused. To be used by one thread; others may read."""

    def __init__(self, report, port):
        """report: function (level, text).  port: its name, for people."""
        self._report, self._port = report, port
        self.count = 0  # how often a sender was refused
        self._times = Counter()  # by address; None: those beyond MAX_NAMED

    def refuse(self, address, cure=""):
        """Count a refused sender. cure: what to do if it should be allowed; reported with its address, once."""
        if address not in self._times:
            if len(self._times) >= MAX_NAMED:
                address = None
            else:
                text = "%s: %s is refused (said once, then counted in the diagnostics)" % (self._port, address)
                self._report("warn", "%s: %s" % (text, cure) if cure else text)
        self._times[address] += 1
        self.count += 1

    def __str__(self):
        """Addresses, and how often each was refused."""
        times = self._times.copy()
        others = times.pop(None, 0)
        named = ["%s: %d" % item for item in times.most_common()] + ["others: %d" % others] * bool(others)
        return ", ".join(named) or "none"


class Guests:
    """Hosts that may connect to a listening port: this computer, and the addresses given."""

    def __init__(self, texts=()):
        """texts: addresses, and networks such as A.B.C.0/24. Raises ValueError."""
        try:
            self._networks = [ipaddress.ip_network(text) for text in texts]
        except ValueError as error:
            raise ValueError("%s: give addresses, or networks such as A.B.C.0/24" % error) from None

    def may_come(self, address, local_address):
        """Whether a connection is let in. address: of the other end.  local_address: of this one."""
        address, here = map(_plain, (address, local_address))
        return self._is_loopback(address) or address == here or any(address in network for network in self._networks)

    @staticmethod
    def _is_loopback(address):
        return address.is_loopback


def _plain(text):
    """An address; IPv4 as such, also where an IPv6 socket reports it as a mapped one."""
    address = ipaddress.ip_address(text)
    return getattr(address, "ipv4_mapped", None) or address


class OneSender:
    """Lets a datagram socket hear one sender only.

    When others send many datagrams, the kernel drops them before they take room in the socket's buffer and CPU time.
    """

    def __init__(self, sock, strangers, cure=""):
        """cure: see Strangers.refuse."""
        self._socket, self._strangers, self._cure = sock, strangers, cure
        self._address = self._port = None
        self._seen, self._closed_at = 0, None  # _closed_at: datagrams dropped before the kernel was told to refuse

    def hear(self, address, port=None):
        """From now on hear only this IPv4 address, from any port or from the one given."""
        self._address, self._port, self._seen = address, port, 0
        if self._closed_at is not None:
            self._closed_at = None
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_DETACH_FILTER, 0)

    def is_from(self, sender):
        """Whether (address, port) is the sender to hear; others are refused."""
        if sender[0] == self._address and self._port in (None, sender[1]):
            return True
        self._strangers.refuse(sender[0], self._cure)
        self._seen += 1
        if self._seen == SEEN:
            self._let_the_kernel_refuse()
        return False

    @property
    def refused(self):
        """Number of datagrams refused, including those dropped because the socket's buffer was full."""
        by_kernel = 0
        if self._closed_at is not None:
            with contextlib.suppress(OSError):  # closed
                by_kernel = (self._dropped() - self._closed_at) & 0xFFFFFFFF
        return self._strangers.count + by_kernel

    def _dropped(self):
        return _MEMINFO.unpack(self._socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size))[-1]

    def _let_the_kernel_refuse(self):
        (address,) = struct.unpack("!I", socket.inet_aton(self._address))
        conditions = [(_LOAD_WORD, 0, 0, _SOURCE_ADDRESS), (_IF_EQUAL, 0, 1 if self._port is None else 3, address)]
        if self._port is not None:
            conditions += [(_LOAD_HALF, 0, 0, _SOURCE_PORT), (_IF_EQUAL, 0, 1, self._port)]
        take, sample = (_RETURN, 0, 0, _ALL_BYTES), [(_LOAD_WORD, 0, 0, _RANDOM), (_IF_ANY_BIT, 0, 1, SAMPLE - 1)]
        program = [*conditions, take, *sample, (_RETURN, 0, 0, 0), take]
        code = ctypes.create_string_buffer(b"".join(_INSTRUCTION.pack(*step) for step in program))
        with contextlib.suppress(OSError):  # a kernel without it: refused here, as before
            dropped = self._dropped()
            setting = struct.pack("@HP", len(program), ctypes.addressof(code))
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, setting)
            self._closed_at = dropped
