"""Real lines: pseudo-terminals and TCP; error messages for a wrong port."""

import contextlib
import errno
import os
import socket
import tty

import pytest

from risc_lab.strangers import Guests, Strangers
from rosserial_python.ports import ListeningPort, SerialPort, SocketPort, make_port
from rosserial_python.settings import SerialParams


@pytest.fixture
def terminal(tmp_path):
    """(board's end, port at the other end, path)."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    os.set_blocking(ours, False)
    path = tmp_path / "ttyACM0"
    path.symlink_to(os.ttyname(theirs))
    yield ours, SerialPort(str(path), 57600, 10.0), path
    for end in (ours, theirs):
        with contextlib.suppress(OSError):
            os.close(end)


def test_a_terminal_with_nothing_to_read_is_not_at_its_end(terminal):
    ours, port, _ = terminal
    line = port.open()
    assert line.read() == b"" and line.queued() == 0
    assert line.write(b"hello") == 5 and os.read(ours, 10) == b"hello"
    os.write(ours, b"\x00\xff\x11\x13\r\n")
    assert line.read() == b"\x00\xff\x11\x13\r\n", "nothing is translated"
    os.close(ours)
    with pytest.raises(OSError):
        line.read()
    line.close()


@pytest.mark.parametrize("for_test", [False, True])
def test_what_arrived_before_is_dropped(terminal, for_test):
    ours, _, path = terminal
    os.write(ours, b"old")
    line = SerialPort(str(path), 57600, 10.0, for_test).open()
    assert line.read() == b""
    os.write(ours, b"new")
    assert line.read() == b"new"
    line.close()


def test_one_program_has_a_terminal(terminal):
    _, port, _ = terminal
    line = port.open()
    with pytest.raises(OSError) as info:
        port.open()
    assert info.value.errno == errno.EAGAIN
    line.close()
    port.open().close()


def test_a_path_that_leads_elsewhere_is_opened_again(terminal):
    ours, port, path = terminal
    line = port.open()
    assert not port.should_reopen(line, 5.0)
    assert port.should_reopen(line, 11.0), "a device that hangs"
    path.unlink()
    assert port.should_reopen(line, 0.5)
    path.symlink_to("/dev/null")
    assert port.should_reopen(line, 0.5)
    line.close()


def test_a_full_line_takes_what_it_has_room_for(terminal):
    _, port, _ = terminal
    line = port.open()
    taken = line.write(bytes(2**20))
    assert 0 < taken < 2**20
    while line.write(bytes(4096)):  # ends: write does not wait for room
        pass
    line.close()


@pytest.mark.parametrize(("baud", "byte_s"), [(None, 0.0), (57600, 10 / 57600)])
def test_connections(baud, byte_s):
    server = ListeningPort(0, baud)
    with pytest.raises(OSError):
        server.open()
    number = server.name.split(":")[1]
    port = SocketPort("socket://127.0.0.1:%s" % number, baud)
    first, second = port.open(), port.open()
    line = server.open()
    assert line.byte_s == second.byte_s == byte_s
    assert line.read() == b""
    second.write(b"x")
    while not (data := line.read()):
        pass
    assert data == b"x", "who has connected last"
    with pytest.raises(OSError):
        while not first.read():
            pass
    second.close()
    with pytest.raises(OSError):
        while not line.read():
            pass
    line.close()
    first.close()
    server.close()
    with pytest.raises(ConnectionRefusedError):
        port.open()


def test_bytes_that_nobody_reads_are_counted():
    with socket.create_server(("127.0.0.1", 0)) as server:
        line = SocketPort("socket://127.0.0.1:%d" % server.getsockname()[1]).open()
        while line.write(bytes(2**16)):
            pass
        assert line.queued() > 2**10
        line.close()


@pytest.mark.parametrize(
    "url",
    ["socket://127.0.0.1", "socket://127.0.0.1:0", "socket://127.0.0.1:70000", "rfc2217://127.0.0.1:1", "foo://x"],
)
def test_what_is_no_port_is_one_error(url):
    with pytest.raises(ValueError, match="port|protocol"):
        make_port(SerialParams(port=url))


def test_a_search_that_finds_no_device_is_no_port_for_now():
    port = make_port(SerialParams(port="hwgrep://no device is called so"))
    with pytest.raises(OSError) as found:
        port.open()
    assert found.value.errno == errno.ENODEV


def strange_connection(**options):
    """(Port, connection to it from another address, reports)."""
    net = "127.%d.%d." % (64 + os.getpid() % 128, os.getpid() // 128 % 256)
    said = []
    port = ListeningPort(0, strangers=Strangers(lambda level, text: said.append(text), "tcp"), **options)
    number = int(port.name.split(":")[1])
    client = socket.create_connection((net + "1", number), 5.0, source_address=(net + "2", 0))
    return port, client, said


@pytest.fixture
def loopback_is_foreign(monkeypatch):
    """Treat loopback addresses like those of other computers."""
    monkeypatch.setattr(Guests, "_is_loopback", lambda self, address: False)


@pytest.mark.parametrize("networks", [[], ["127.0.0.0/8"]])
def test_who_connects_from_elsewhere_is_refused(loopback_is_foreign, networks):
    """The control arm is that its network is allowed."""
    port, client, said = strange_connection(guests=Guests(networks))
    with contextlib.closing(port), client:
        assert port.should_reopen(None, 1.0) is bool(networks)
        if networks:
            port.open().close()
            return
        with pytest.raises(ConnectionRefusedError):
            port.open()
        assert client.recv(1) == b""  # hung up
        address = client.getsockname()[0]
        assert str(port.strangers) == "%s: 1" % address and "~tcp_from" in said[0] and address in said[0]


def test_this_computer_may_connect(loopback_is_foreign):
    port = ListeningPort(0)
    with contextlib.closing(port), socket.create_connection(("127.0.0.1", int(port.name.split(":")[1]))):
        line, _ = port.accept()
        line.close()


def test_networks_of_devices():
    guests = SerialParams(tcp_from=("192.168.1.0/24", "10.0.0.7", "fd00::/8")).guests()
    here = "192.168.5.1"
    for address in ("192.168.1.9", "10.0.0.7", "fd00::7", "127.0.0.1", here):
        assert guests.may_come(address, here)
    for address in ("192.168.2.9", "10.0.0.8", "fe80::7"):
        assert not guests.may_come(address, here)
    with pytest.raises(ValueError, match="tcp_from"):
        SerialParams(tcp_from=("192.168.1.7/24",))


def test_ports_of_parameters():
    assert make_port(SerialParams(port="/dev/ttyUSB0")).baud == 57600
    assert make_port(SerialParams(port="/dev/ttyUSB0", baud=115200)).baud == 115200
    assert make_port(SerialParams(port="socket://[::1]:11411")).baud is None
    with pytest.raises(ValueError, match="baud"):
        SerialParams(baud=10)
    with contextlib.closing(ListeningPort(0)) as taken, pytest.raises(OSError):
        make_port(SerialParams(port="tcp", tcp_port=int(taken.name.split(":")[1])))
