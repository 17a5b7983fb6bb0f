"""Devices for MAVLink: serial lines, UDP, TCP. They do not block, and raise OSError on failure.

Those of pymavlink (mavutil) block and print, hide failures to send, and a listening one sends to every address that has
ever sent anything.
"""

import contextlib
import ipaddress
import os
import re
import socket
import termios

import serial

from risc_lab.strangers import OneSender

FORMS = "a serial device such as /dev/ttyUSB0, or udpin:HOST:PORT:VEHICLE, udpout:HOST:PORT, tcp:HOST:PORT"
CONNECT_S = 1.0  # the longest time that opening a TCP connection may block the thread
_MOST_BYTES = 65536
_NETWORK = re.compile(r"(?:(udpin|udp):([^:]*):(\d+)(?::([^:]+))?|(udpout|tcp):([^:]*):(\d+))")


def check(device):
    """Raise ValueError if a text is not a valid device."""
    network = _network(device)
    if network and not 0 < network[1][1] < 65536 or not network and re.match(r"\w+:", device):
        raise ValueError("invalid device %r: use %s" % (device, FORMS))
    if network and network[0] in ("udpin", "udp") and network[2] is None and not _is_loopback(network[1][0]):
        text = "device %r would take the first sender for the vehicle: append :VEHICLE, the address of the vehicle"
        raise ValueError(text % device)


def open_device(device, baudrate, strangers=None):
    """Open a device. Raises OSError, and ValueError for a baud rate that serial lines do not support.

    strangers: risc_lab.strangers.Strangers, for senders to a listening port that are not the vehicle.
    """
    network = _network(device)
    if network is None:
        return Serial(device, baudrate)
    kind, address, vehicle = network
    if kind == "tcp":
        return Tcp(address)
    return UdpClient(address) if kind == "udpout" else UdpServer(address, vehicle, strangers)


def _is_loopback(host):
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _network(device):
    """Return (kind, address to open, vehicle's host or None) of a network device; None for other texts."""
    match = _NETWORK.fullmatch(device)
    if match is None:
        return None
    kind, host, port = match.group(1, 2, 3) if match[1] else match.group(5, 6, 7)
    return kind, (host, int(port)), match[4]


class _Stream:
    """A byte stream. A partly written frame is completed before the next one: an incomplete frame would corrupt those
    that follow.
    """

    _rest = b""

    def write(self, data):
        """Write bytes; return False if nothing was accepted (they are lost). The end may be written later."""
        try:
            if self._rest:
                self._rest = self._rest[self._put(self._rest) :]
            if self._rest:
                return False
            self._rest = data[self._put(data) :]
        except BlockingIOError:
            return False
        return True


class Serial(_Stream):
    """A serial line, or a pseudo terminal."""

    def __init__(self, path, baudrate):
        try:
            self._port = serial.Serial(path, baudrate, timeout=0, exclusive=True)
        except termios.error as error:  # not an OSError: it was unplugged while it was being opened
            raise OSError(*error.args) from error
        self.fileno = self._port.fileno

    def read(self):
        """Return (bytes, source address or None)."""
        data = os.read(self._port.fileno(), _MOST_BYTES)
        if not data:
            raise OSError("it was unplugged")
        return data, None

    def _put(self, data):
        return os.write(self._port.fileno(), data)

    def answer_to(self, source):
        """Send to this source from now on: the vehicle's messages come from there."""

    def close(self):
        with contextlib.suppress(OSError):
            self._port.close()


class _Socket:
    def __init__(self, sock):
        self._socket = sock
        sock.setblocking(False)
        self.fileno = sock.fileno

    def read(self):
        try:
            return self._socket.recv(_MOST_BYTES), None
        except (BlockingIOError, ConnectionRefusedError):  # the latter from UDP: no program listens there yet
            return b"", None

    def write(self, data):
        try:
            return self._socket.send(data) == len(data)
        except (BlockingIOError, ConnectionRefusedError):
            return False

    def answer_to(self, source):
        pass

    def close(self):
        self._socket.close()


class UdpClient(_Socket):
    """Sends to one address and receives from there only."""

    def __init__(self, address):
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            sock.connect(address)
        except OSError:
            sock.close()
            raise
        super().__init__(sock)

    def write(self, data):
        with contextlib.suppress(OSError):  # when the network is back, the socket works again
            return super().write(data)
        return False


class UdpServer(_Socket):
    """Listens on one address to the vehicle, and answers it.

    If no vehicle is named (allowed on a loopback address), the first one heard is taken, and kept as long as the port
    is open.
    """

    def __init__(self, address, vehicle, strangers):
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            sock.bind(address)
            vehicle = vehicle and socket.gethostbyname(vehicle)
        except OSError:
            sock.close()
            raise
        super().__init__(sock)
        self._peer, self._vehicle = None, None
        cure = "the vehicle is at %s. To hear another one start again with a device udpin:HOST:PORT:VEHICLE"
        self._cure, self._strangers = cure, strangers
        if vehicle:
            self._hear(vehicle)

    def _hear(self, vehicle):
        self._vehicle = OneSender(self._socket, self._strangers, self._cure % vehicle)
        self._vehicle.hear(vehicle)

    def read(self):
        try:
            data, source = self._socket.recvfrom(_MOST_BYTES)
        except (BlockingIOError, ConnectionRefusedError):
            return b"", None
        if self._vehicle is not None and not self._vehicle.is_from(source):
            return b"", None
        return data, source

    def write(self, data):
        if self._peer is None:
            return False
        with contextlib.suppress(OSError):
            return self._socket.sendto(data, self._peer) == len(data)
        return False

    def answer_to(self, source):
        self._peer = source
        if self._vehicle is None:
            self._hear(source[0])


class Tcp(_Stream, _Socket):
    """A connection to a server."""

    def __init__(self, address):
        sock = socket.create_connection(address, CONNECT_S)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        super().__init__(sock)
        self._put = sock.send

    def read(self):
        try:
            data = self._socket.recv(_MOST_BYTES)
        except BlockingIOError:
            return b"", None
        if not data:
            raise OSError("the other side has closed it")
        return data, None
