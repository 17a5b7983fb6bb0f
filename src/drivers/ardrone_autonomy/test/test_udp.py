"""The thread on real sockets, against the scripted aircraft on loopback."""

import socket
import threading
import time

import pytest
from scripted_drone import ScriptedDrone, fly_until

from ardrone_autonomy.aircraft_configuration import setup_writes, wanted_texts
from ardrone_autonomy.link import Phase
from ardrone_autonomy.piloting import HOVER, Sticks
from ardrone_autonomy.protocol.navdata import ControlState
from ardrone_autonomy.udp import UdpThread, resolve
from risc_lab.testing import wait_for

SESSION = "0badcafe"
FORWARD = Sticks(1, 0.0, -0.5, 0.0, 0.0)


def make_thread(address, **arguments):
    reports, packets, failures = [], [], []
    callbacks = {"on_packet": packets.append, "on_failure": failures.append, **arguments}
    thread = UdpThread(
        address,
        lambda *item: reports.append(item),
        **callbacks,
        setup_writes=setup_writes(wanted_texts({}), SESSION),
        session_id=SESSION,
        settle_s=0.0,
    )
    thread.reports, thread.packets = reports, packets
    return thread


@pytest.fixture
def drone():
    with ScriptedDrone() as drone:
        yield drone


@pytest.fixture
def thread(drone):
    thread = make_thread(drone.address)
    thread.start()
    yield thread
    thread.stop()


def fly(drone, thread):
    wait_for(lambda: thread.link.phase is Phase.READY)
    fly_until(thread, HOVER, lambda: drone.phase is ControlState.HOVERING)
    fly_until(thread, FORWARD, lambda: drone.phase is ControlState.FLYING)


def test_flight(drone, thread):
    fly(drone, thread)
    assert drone.sticks() == tuple(FORWARD)
    wait_for(lambda: thread.link.in_flight)
    thread.post(thread.link.land)
    wait_for(lambda: drone.phase is ControlState.LANDED)
    count = len(thread.packets)
    wait_for(lambda: len(thread.packets) > count)
    assert 0.0 <= time.monotonic() - thread.packets[-1].received_s < 15.0


def test_stop_hovers_lands_and_frees_the_sockets(drone):
    before = set(threading.enumerate())
    thread = make_thread(drone.address)
    thread.start()
    fly(drone, thread)
    wait_for(lambda: thread.link.in_flight)
    thread.stop()
    wait_for(lambda: drone.phase in (ControlState.LANDING, ControlState.LANDED))
    wait_for(lambda: drone.sticks() == tuple(HOVER))
    assert set(threading.enumerate()) <= before  # threads of earlier tests may end meanwhile
    thread.post(thread.link.take_off)  # too late, and harmless
    thread.stop()


def test_strangers_are_not_heard(drone, thread):
    wait_for(lambda: thread.link.phase is Phase.READY)
    port = thread._navdata.getsockname()[1]
    refused = thread.link.refused
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for _ in range(10):
            stranger.sendto(b"noise", ("127.0.0.1", port))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:  # the right address, another port
        stranger.bind((drone.address, 0))
        stranger.sendto(b"noise", ("127.0.0.1", port))
    wait_for(lambda: thread.foreign == 11)
    assert str(thread.strangers) == "127.0.0.1: 10, %s: 1" % drone.address
    assert sum("refused" in text for level, text in thread.reports) == 2
    assert thread.link.refused == refused
    drone._sockets[0].sendto(b"noise", ("127.0.0.1", port))  # this one comes from the vehicle
    wait_for(lambda: thread.link.refused == refused + 1)


def test_the_kernel_refuses_a_flood_of_strangers(drone, thread):
    wait_for(lambda: thread.link.phase is Phase.READY)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for number in range(1, 501):
            stranger.sendto(b"noise", ("127.0.0.1", thread._navdata.getsockname()[1]))
            wait_for(lambda number=number: thread.foreign >= number)
    assert thread.strangers.count < 100  # the rest was never read; a few are read, to name their senders
    accepted = thread.link.accepted
    wait_for(lambda: thread.link.accepted > accepted + 5)


def test_every_packet_is_handed_on(drone):
    packets = []
    thread = make_thread(drone.address, on_packet=packets.append)
    thread.start()
    wait_for(lambda: len(packets) > 100)
    thread.stop()
    assert len({packet.data[8:12] for packet in packets[-50:]}) == 50  # all sequence numbers differ


def test_an_unreachable_vehicle_is_reported_once():
    thread = make_thread("255.255.255.255")  # refused by the kernel without SO_BROADCAST
    thread.start()
    wait_for(lambda: thread.send_errors >= 3)
    thread.stop()
    assert len([text for level, text in thread.reports if "cannot send" in text]) == 1


def test_a_defect_ends_the_thread_with_a_call(drone):
    failures = []
    thread = make_thread(drone.address, on_failure=failures.append)
    thread.start()
    thread.post(lambda now_s: 1 // 0)
    wait_for(lambda: failures)
    assert isinstance(failures[0], ZeroDivisionError)
    thread.stop()


def test_a_defect_in_flight_lands_the_vehicle(drone):
    failures, broken = [], threading.Event()

    def on_packet(_packet):
        if broken.is_set():
            raise KeyError("defect")

    thread = make_thread(drone.address, on_packet=on_packet, on_failure=failures.append)
    thread.start()
    fly(drone, thread)
    broken.set()
    wait_for(lambda: failures)
    wait_for(lambda: drone.phase is ControlState.LANDED)
    assert isinstance(failures[0], KeyError)
    wait_for(lambda: drone.sticks() == tuple(HOVER))
    thread.stop()


def test_a_failure_of_the_last_orders_does_not_hide_its_cause(drone):
    failures = []
    thread = make_thread(drone.address, on_failure=failures.append)
    thread.link.send_last_orders = lambda: {}["too"]
    thread.start()
    thread.post(lambda now_s: 1 // 0)
    wait_for(lambda: failures)
    assert isinstance(failures[0], ZeroDivisionError)
    assert any("last orders" in text for level, text in thread.reports if level == "error")
    thread.stop()


def test_resolve():
    assert resolve("127.0.0.1") == "127.0.0.1"
    with pytest.raises(ValueError, match="-ip"):
        resolve("no such host.invalid")
