"""A stranger in the network, on real sockets."""

import contextlib
import os
import socket

import pytest

from risc_lab import strangers
from risc_lab.strangers import MAX_NAMED, SEEN, Guests, OneSender, Strangers

# Loopback has 16 million addresses: parallel tests never collide
NET = "127.%d.%d." % (64 + os.getpid() % 128, os.getpid() // 128 % 256)
OURS, VEHICLE, STRANGER = (NET + str(number) for number in (1, 2, 3))
FILLING = 3000  # this many datagrams, of any size, fill the buffer that these tests ask for


@pytest.fixture
def sockets():
    """{address: socket bound to it}."""
    with contextlib.ExitStack() as stack:
        made = {}
        for address in (OURS, VEHICLE, STRANGER):
            made[address] = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            made[address].bind((address, 0))
        made[OURS].setblocking(False)
        made[OURS].setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 100_000)
        yield made


@pytest.fixture
def door(sockets):
    said = []
    door = OneSender(sockets[OURS], Strangers(lambda level, text: said.append(text), "telemetry"), "name it")
    door.said = said
    return door


def heard(sockets, door):
    """Waiting datagrams that come from the vehicle."""
    found = []
    with contextlib.suppress(BlockingIOError):
        while True:
            data, sender = sockets[OURS].recvfrom(65536)
            if door.is_from(sender):
                found.append(data)
    return found


def send(sockets, whose, data, times=1):
    for _ in range(times):
        sockets[whose].sendto(data, sockets[OURS].getsockname())


def test_one_sender_is_heard_and_others_are_named_once(sockets, door):
    door.hear(VEHICLE)
    for number in range(5):
        send(sockets, STRANGER, b"hello")
        send(sockets, VEHICLE, b"%d" % number)
    assert heard(sockets, door) == [b"0", b"1", b"2", b"3", b"4"]
    assert door.refused == 5 and str(door._strangers) == "%s: 5" % STRANGER
    assert len(door.said) == 1 and STRANGER in door.said[0] and "name it" in door.said[0]


def test_the_port_may_be_known_too(sockets, door):
    door.hear(VEHICLE, sockets[VEHICLE].getsockname()[1])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind((VEHICLE, 0))
        for _ in range(SEEN + 10):  # also when the kernel refuses
            other.sendto(b"from another port", sockets[OURS].getsockname())
            send(sockets, VEHICLE, b"x")
            assert heard(sockets, door) == [b"x"]


@pytest.mark.parametrize("kernel_refuses", [True, False])
def test_a_flood_takes_no_room_in_the_buffer(sockets, door, monkeypatch, kernel_refuses):
    """While the socket is not read, a stranger sends more than the buffer holds, and the vehicle a little."""
    if not kernel_refuses:  # the control arm
        monkeypatch.setattr(strangers, "SEEN", 10**9)
    door.hear(VEHICLE)
    for _ in range(SEEN):
        send(sockets, STRANGER, b"x")
        assert heard(sockets, door) == []
    send(sockets, STRANGER, b"flooding.", FILLING)
    send(sockets, VEHICLE, b"telemetry", 20)
    assert (len(heard(sockets, door)) == 20) is kernel_refuses
    assert not kernel_refuses or door.refused == SEEN + FILLING


def test_what_the_kernel_refuses_is_still_named(sockets, door, monkeypatch):
    monkeypatch.setattr(strangers, "SAMPLE", 2)
    door.hear(VEHICLE)
    for _ in range(SEEN):
        send(sockets, STRANGER, b"x")
        heard(sockets, door)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind((NET + "4", 0))
        for _ in range(64):
            other.sendto(b"later", sockets[OURS].getsockname())
            heard(sockets, door)
    assert len(door.said) == 2 and NET + "4" in door.said[1]
    assert door.refused == SEEN + 64


def test_another_sender_may_be_heard_later(sockets, door):
    door.hear(VEHICLE)
    for _ in range(SEEN + 1):
        send(sockets, STRANGER, b"x")
        heard(sockets, door)
    door.hear(STRANGER)
    send(sockets, STRANGER, b"now")
    send(sockets, VEHICLE, b"not now")
    assert heard(sockets, door) == [b"now"]


def test_many_strangers_take_no_memory_and_no_log():
    said = []
    refused = Strangers(lambda *line: said.append(line), "telemetry")
    for number in range(10_000):
        refused.refuse("10.0.%d.%d" % divmod(number, 256))
    assert len(said) == MAX_NAMED and refused.count == 10_000
    assert str(refused).endswith("others: %d" % (10_000 - MAX_NAMED)) and len(str(refused)) < 400


@pytest.mark.parametrize(
    ("address", "here", "comes"),
    [
        ("127.0.0.1", "127.0.0.1", True),
        ("::1", "::1", True),
        ("::ffff:127.0.0.1", "::ffff:127.0.0.1", True),  # IPv4 as seen by an IPv6 socket
        ("10.0.0.5", "10.0.0.5", True),  # this computer, by its network address
        ("10.0.0.6", "10.0.0.5", False),
        ("10.1.0.6", "10.0.0.5", True),
        ("::ffff:10.1.0.6", "::ffff:10.0.0.5", True),
        ("10.2.0.7", "10.0.0.5", True),
        ("fe80::7%eth0", "fe80::1%eth0", False),
    ],
)
def test_guests(address, here, comes):
    assert Guests(["10.1.0.0/16", "10.2.0.7"]).may_come(address, here) is comes


def test_guests_that_are_none_are_named():
    with pytest.raises(ValueError, match="A.B.C.0/24"):
        Guests(["10.1.0.7/16"])
