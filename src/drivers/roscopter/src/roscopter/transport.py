"""Devices that MAVLink comes through: serial lines, UDP, TCP. They never wait, and say what is wrong by OSError.

pymavlink's own (mavutil) wait and print, hide what cannot be sent, and a listening one sends to everybody who has ever
sent anything.
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
CONNECT_S = 1.0  # the longest that opening a TCP connection holds up everything else
_MOST_BYTES = 65536
_NETWORK = re.compile(r"(?:(udpin|udp):([^:]*):(\d+)(?::([^:]+))?|(udpout|tcp):([^:]*):(\d+))")


def check(device):
    """Raises ValueError when a text names no device."""
    network = _network(device)
    if network and not 0 < network[1][1] < 65536 or not network and re.match(r"\w+:", device):
        raise ValueError("invalid device %r: use %s" % (device, FORMS))
    if network and network[0] in ("udpin", "udp") and network[2] is None and not _is_loopback(network[1][0]):
        text = "device %r would take the first sender for the vehicle: append :VEHICLE, the address of the vehicle"
        raise ValueError(text % device)


def open_device(device, baudrate, strangers=None):
    """Open one. Raises OSError, and ValueError for a baud rate that a serial line has not.

    strangers: risc_lab.strangers.Strangers, for those who speak to a port that listens and are not the vehicle.
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
    """(kind, address to open, vehicle's host or None) of a text; None when it names no such device."""
    match = _NETWORK.fullmatch(device)
    if match is None:
        return None
    kind, host, port = match.group(1, 2, 3) if match[1] else match.group(5, 6, 7)
    return kind, (host, int(port)), match[4]


class _Stream:
    """Takes bytes one after another. A frame that it has taken the begin of is completed before the next: half of one
    would swallow those that follow.
    """

    _rest = b""

    def write(self, data):
        """Whether it takes them, at once or the end of them later. What it takes nothing of is lost."""
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
        except termios.error as error:  # which is not an OSError: it was unplugged while it was opened
            raise OSError(*error.args) from error
        self.fileno = self._port.fileno

    def read(self):
        """Bytes, and where they came from."""
        data = os.read(self._port.fileno(), _MOST_BYTES)
        if not data:
            raise OSError("it was unplugged")
        return data, None

    def _put(self, data):
        return os.write(self._port.fileno(), data)

    def answer_to(self, source):
        """The vehicle is there: where its messages come from."""

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
        except (BlockingIOError, ConnectionRefusedError):  # of UDP: nobody listens there yet
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
    """Sends to one address and hears what comes from there."""

    def __init__(self, address):
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            sock.connect(address)
        except OSError:
            sock.close()
            raise
        super().__init__(sock)

    def write(self, data):
        with contextlib.suppress(OSError):  # a network that is gone comes back, and the socket serves again
            return super().write(data)
        return False


class UdpServer(_Socket):
    """Hears the vehicle, which sends to one address, and answers it.

    A vehicle that is not named, on a loopback address, is the first that is heard, and stays it as long as the port is
    open.
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
