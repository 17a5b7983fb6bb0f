"""Lines to a device: serial ports and pseudo-terminals by pyserial, TCP connections to a device and from one. No ROS.

A port opens lines. A `Line` never blocks: use `select` to learn when there is something to read.
"""

import contextlib
import errno
import fcntl
import os
import re
import select
import socket
import struct
import termios

import serial

from risc_lab.strangers import Guests, Strangers
from rosserial_python.settings import LISTEN, USUAL_BAUD

_BITS = 10  # per byte on a serial line: start, 8, stop
_READ_BYTES = 4096
_ACCEPTED_AT_ONCE = 16  # connections, before other work goes on
_CONNECT_S = 1.0  # until an address counts as unreachable
_LINGER_NONE = struct.pack("ii", 1, 0)  # discard unsent bytes when the connection is closed
_SOCKET = re.compile(r"socket://(?:\[([^\]]+)\]|([^:/\[\]]+)):(\d+)/?")


class Line:
    """An open line, see `link`."""

    def __init__(self, file, byte_s=0.0, node=None):
        """file: has fileno() and close(), does not block.  node: identity of the device file that was opened."""
        self._file, self.byte_s, self.node = file, byte_s, node
        self._is_terminal = os.isatty(file.fileno())

    def fileno(self):
        """For select."""
        return self._file.fileno()

    def read(self):
        """Return the received bytes, b"" when there are none. Raises OSError when the line is gone."""
        with contextlib.suppress(BlockingIOError):
            data = os.read(self._file.fileno(), _READ_BYTES)
            # b"" from a terminal may mean no data or the end; it is the end if select still reports it as readable
            if not data and self._is_terminal and self._is_readable():
                data = os.read(self._file.fileno(), _READ_BYTES)
            if data or (self._is_terminal and not self._is_readable()):
                return data
            number = errno.ENODEV if self._is_terminal else errno.ECONNRESET
            raise OSError(number, "the other end has closed the connection, or the device is gone")
        return b""

    def _is_readable(self):
        return bool(select.select([self._file], [], [], 0.0)[0])

    def write(self, data):
        """Write bytes; return how many the line accepted. Raises OSError when it is gone."""
        try:
            return os.write(self._file.fileno(), data)
        except BlockingIOError:
            return 0

    def queued(self):
        """Number of bytes in the kernel or not acknowledged; 0 for a pseudo-terminal."""
        return struct.unpack("i", fcntl.ioctl(self._file.fileno(), termios.TIOCOUTQ, b"\0\0\0\0"))[0]

    def discard(self):
        """Discard unsent bytes of a terminal; those of a connection are discarded only on closing."""
        if self._is_terminal:
            with contextlib.suppress(termios.error):
                termios.tcflush(self._file.fileno(), termios.TCOFLUSH)

    def close(self):
        """Close the line; waiting bytes are not sent."""
        with contextlib.suppress(OSError):
            self.discard()
            if isinstance(self._file, socket.socket):
                self._file.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER_NONE)
            self._file.close()


def _of_connection(connection, baud):
    """Make a Line of a connection. baud: of the serial line at its other end, None if there is none."""
    connection.setblocking(False)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return Line(connection, _BITS / baud if baud else 0.0)


class SerialPort:
    """A device file or pseudo-terminal, or another URL of pyserial that has a file, e.g. hwgrep://."""

    def __init__(self, url, baud, reopen_s, for_test=False):
        """reopen_s: silence after which the port is reopened [s], 0: never. Raises ValueError for an invalid port."""
        self.name, self.baud, self._reopen_s, self._for_test = url, baud, reopen_s, for_test
        with contextlib.suppress(serial.SerialException):  # hwgrep:// finds no device yet
            if isinstance(self._closed(), serial.Serial):
                return
            raise ValueError("port %s: must be a device file, a pseudo-terminal, socket://HOST:PORT or tcp" % url)

    def _closed(self):
        options = {"rtscts": True, "dsrdtr": True} if self._for_test else {}
        return serial.serial_for_url(
            self.name, baudrate=self.baud, timeout=0, exclusive=True, do_not_open=True, **options
        )

    def open(self):
        """A Line. Raises OSError."""
        try:
            device = self._closed()
        except serial.SerialException as error:
            raise OSError(errno.ENODEV, str(error)) from None
        try:
            device.open()  # discards bytes that arrived earlier
            node = _identity(os.fstat(device.fileno()))
        except (OSError, termios.error) as error:
            device.close()
            raise OSError(_number(error), str(error)) from None
        return Line(device, _BITS / self.baud, node)

    def should_reopen(self, line, silent_s):
        """Whether to reopen a silent line: after reopen_s, or if its device has gone or is a different one now."""
        if self._reopen_s and silent_s > self._reopen_s:
            return True
        if not self.name.startswith("/"):
            return False
        try:
            return _identity(os.stat(self.name)) != line.node
        except OSError:
            return True

    def close(self):
        """Nothing is left to close."""


def _identity(status):
    return status.st_dev, status.st_ino, status.st_rdev


def _number(error):
    """Return the errno of an error raised by pyserial, which wraps some errors."""
    cause = error.__context__
    if error.errno is None and isinstance(cause, OSError):
        return cause.errno
    return error.errno if isinstance(error, OSError) and error.errno is not None else errno.EIO


class SocketPort:
    """A device that listens: socket://HOST:PORT."""

    reopen_s = 1.0

    def __init__(self, url, baud=None):
        """baud: see `_of_connection`. Raises ValueError."""
        match = _SOCKET.fullmatch(url)
        if match is None or not 0 < int(match[3]) < 65536:
            raise ValueError("port %s: must be socket://HOST:PORT, e.g. socket://127.0.0.1:11411" % url)
        self.name, self._address, self.baud = url, (match[1] or match[2], int(match[3])), baud

    def open(self):
        """A Line. Raises OSError."""
        try:
            return _of_connection(socket.create_connection(self._address, _CONNECT_S), self.baud)
        except socket.gaierror as error:
            raise OSError(errno.EHOSTUNREACH, "%s: %s" % (self._address[0], error.strerror)) from None

    def should_reopen(self, _line, silent_s):
        """Whether to reopen a silent line."""
        return silent_s > self.reopen_s

    def close(self):
        """Nothing is left to close."""


class ListeningPort:
    """Devices connect to this computer: only from itself and from `guests`, since a device may publish any topic."""

    def __init__(self, number, baud=None, guests=None, strangers=None):
        """baud: see `_of_connection`.  guests, strangers: see risc_lab.strangers. Raises OSError."""
        self.baud, self._guests = baud, guests or Guests()
        self._server = socket.create_server(("", number), backlog=4)
        self._server.setblocking(False)
        self.name = "tcp:%d" % self._server.getsockname()[1]
        self.strangers = strangers or Strangers(lambda level, text: None, self.name)
        self._next = None  # accepted connection that waits for `open`

    def fileno(self):
        """For select: a device has connected."""
        return self._server.fileno()

    def open(self):
        """Return the Line of the device that connected last. Raises OSError when there is none."""
        newest, self._next = self._next, None
        while (accepted := self._accept()) is not None:
            if newest is not None:
                newest.close()
            newest, _ = accepted
        if newest is None:
            raise OSError(errno.ECONNREFUSED, "no device has connected to %s" % self.name)
        return _of_connection(newest, self.baud)

    def accept(self):
        """Return (Line, its peer) of one device that has connected, None when there is none."""
        accepted = self._accept()
        if accepted is None:
            return None
        connection, peer = accepted
        return _of_connection(connection, self.baud), "%s:%d" % peer[:2]

    def refuse(self, line, peer, why):
        """Close the connection of a device. peer: see accept."""
        line.close()
        self.strangers.refuse(peer.rpartition(":")[0], why)

    def _accept(self):
        """Return (connection, its peer) of the next permitted one, None when there is none yet."""
        for _ in range(_ACCEPTED_AT_ONCE):
            try:
                connection, peer = self._server.accept()
            except (BlockingIOError, ConnectionError):  # no connection, or closed again
                return None
            if self._guests.may_come(peer[0], connection.getsockname()[0]):
                return connection, peer
            connection.close()
            self.strangers.refuse(peer[0], "if it is a device, add its address to ~tcp_from")
        return None

    def should_reopen(self, _line, _silent_s):
        """Whether a new permitted connection waits. A refused one does not end the current line."""
        if self._next is None:
            self._next, _ = self._accept() or (None, None)
        return self._next is not None

    def close(self):
        """Stop listening."""
        self._server.close()
        if self._next is not None:
            self._next.close()


class AcceptedPort:
    """One connection of a ListeningPort with several devices; it cannot be reopened."""

    def __init__(self, line, name, baud):
        self.name, self.baud, self._line = name, baud, line

    def open(self):
        """Return the Line at the first call; raise OSError at later ones."""
        line, self._line = self._line, None
        if line is None:
            raise OSError(errno.ENODEV, "the device has closed its connection")
        return line

    def should_reopen(self, _line, silent_s):
        """Whether to give up a silent line: such a device connects anew."""
        return silent_s > SocketPort.reopen_s

    def close(self):
        """Close the line if it was never opened."""
        if self._line is not None:
            self._line.close()


def make_port(params, report=lambda level, text: None):
    """Make the port for settings.SerialParams. Raises ValueError, and OSError when it cannot listen.

    report: function (level, text), for refused connections.
    """
    if params.port == LISTEN:
        strangers = Strangers(report, "tcp:%d" % params.tcp_port)
        return ListeningPort(params.tcp_port, params.baud, params.guests(), strangers)
    if params.port.startswith("socket:"):
        return SocketPort(params.port, params.baud)
    return SerialPort(params.port, params.baud or USUAL_BAUD, params.reopen_after, params.fix_pyserial_for_test)
