"""The process that keeps vehicles hovering when their driver dies or hangs, and lands them if no new driver comes."""

import contextlib
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import time

import psutil
import pytest
from scripted_drone import free_address

from ardrone_autonomy import keeper as keeper_module
from ardrone_autonomy.keeper import HOVER_S, LAND_S, STALE_S, take_over
from ardrone_autonomy.piloting import HOVER
from ardrone_autonomy.protocol import AT_PORT, at

FLY = at.pcmd_mag(1, *HOVER) + at.ref(2, start=True)
LAND = at.pcmd_mag(1, *HOVER) + at.ref(2, start=False)
# The relevant part of a driver. Arguments: whether it keeps its vehicle in the air, for how long its notes stay valid
# [s; 0: as a real driver's], and the addresses.
DRIVER = """
import sys, time
from ardrone_autonomy.keeper import Keeper

flies, holds_s, *addresses = sys.argv[1:]
keeper = Keeper(addresses)
def note():
    for k in range(len(addresses)):
        keeper.note(k, time.monotonic() + float(holds_s), True, flies == "True")

note()
print(keeper._process.pid, flush=True)
while True:
    note()
    time.sleep(0.01)
"""
LIMIT_S = 20.0
SO_TIMESTAMPNS = 35  # Linux; `socket` does not have it
TIMESPEC = struct.Struct("@ll")  # [s], [ns]


class Vehicle:
    """Receives what is sent to an aircraft."""

    def __init__(self):
        self.address = free_address()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)  # kernel time stamps: this process may read late
        self._socket.bind((self.address, AT_PORT))

    def hears(self, wanted):
        """Wait for the datagram `wanted`. Returns its time of receipt [s, time.time()]."""
        deadline_s = time.monotonic() + LIMIT_S
        while time.monotonic() < deadline_s:
            data, time_s = self.hears_within(0.1)
            if data == wanted:
                return time_s
        raise AssertionError("%r did not come" % wanted)

    def hears_within(self, duration_s):
        """(next datagram, its time of receipt [s, time.time()]), or (None, None) after duration_s."""
        if not select.select([self._socket], (), (), duration_s)[0]:
            return None, None
        data, ((_, _, stamp),), _, _ = self._socket.recvmsg(2048, socket.CMSG_SPACE(TIMESPEC.size))
        seconds, nanoseconds = TIMESPEC.unpack(stamp)
        return data, seconds + 1e-9 * nanoseconds

    def close(self):
        self._socket.close()


@pytest.fixture
def vehicles():
    vehicles = [Vehicle(), Vehicle()]
    yield vehicles
    for vehicle in vehicles:
        vehicle.close()


@pytest.fixture
def drive(vehicles):
    """Function that starts a driver of the vehicles and returns (its process, the process of its keeper).

    Unless holds_s is 0, the keeper does not take the driver for hanging when this computer is busy.
    """
    started = []

    def start(flies=True, holds_s=600.0):
        words = [sys.executable, "-c", DRIVER, str(flies), str(holds_s), *(vehicle.address for vehicle in vehicles)]
        driver = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        process = psutil.Process(int(driver.stdout.readline()))
        started.append((driver, process))
        return driver, process

    yield start
    for driver, process in started:
        driver.kill()
        driver.wait()
        driver.stdout.close()
        if process.is_running():
            process.kill()


def test_it_speaks_as_the_driver_does():
    assert (keeper_module._FLY, keeper_module._LAND, keeper_module._AT_PORT) == (FLY, LAND, AT_PORT)


def test_it_is_silent_as_long_as_the_driver_works(vehicles, drive):
    drive()
    assert vehicles[0].hears_within(4.0 * STALE_S) == (None, None)


def test_a_driver_works_as_long_as_what_it_says_is_not_stale(vehicles):
    """In simulated time: in real time a stall of this computer would make the driver hang."""
    keeper = keeper_module.Keeper([free_address()])  # its process keeps another vehicle
    kept = keeper_module._Kept(vehicles[0].address, keeper._memory, 0)
    for k in range(10):
        keeper.note(0, k * STALE_S, True, True)
        kept.step((k + 0.99) * STALE_S, False)
    assert vehicles[0].hears_within(0.0) == (None, None)
    kept.step((k + 1.01) * STALE_S, False)
    assert vehicles[0].hears_within(0.0)[0] == FLY
    keeper.close()


def test_vehicles_of_a_driver_that_was_killed_hover_and_then_land(vehicles, drive):
    driver, process = drive()
    driver.kill()
    begin_s = [vehicle.hears(FLY) for vehicle in vehicles]
    land_s = [vehicle.hears(LAND) for vehicle in vehicles]
    assert all(land - begin > 0.9 * HOVER_S for begin, land in zip(begin_s, land_s))
    process.wait(LAND_S + LIMIT_S)  # the keeper ends, too


def test_vehicles_on_the_ground_are_not_brought_into_the_air(vehicles, drive):
    driver, process = drive(flies=False)
    driver.kill()
    vehicles[0].hears(LAND)
    process.wait(LAND_S + LIMIT_S)
    while (data := vehicles[1].hears_within(0.0)[0]) is not None:
        assert data == LAND


def test_vehicles_of_a_driver_that_hangs_hover_until_it_goes_on(vehicles, drive):
    driver, process = drive(holds_s=0.0)
    os.kill(driver.pid, signal.SIGSTOP)
    vehicles[0].hears(FLY)
    os.kill(driver.pid, signal.SIGCONT)
    deadline_s = time.monotonic() + LIMIT_S
    while vehicles[0].hears_within(4.0 * STALE_S)[0] is not None:
        assert time.monotonic() < deadline_s, "it is still speaking"
    assert process.is_running()


def test_a_new_driver_takes_its_vehicles_over(vehicles, drive):
    driver, process = drive()
    driver.kill()
    for vehicle in vehicles:
        vehicle.hears(FLY)
    deadline_s, taken_s = time.monotonic() + HOVER_S + LIMIT_S, float("inf")
    while process.is_running() and process.status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < deadline_s
        for vehicle in vehicles:
            take_over(vehicle.address)
        taken_s = min(taken_s, time.time())
        time.sleep(0.02)
    while (heard := vehicles[0].hears_within(0.0)) != (None, None):
        data, time_s = heard
        # before the take-over, which may come late, landing was right
        assert data != LAND or time_s < taken_s, "another driver flew it then"
    take_over(vehicles[0].address)  # without a keeper nothing happens


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can stop being root")
def test_another_user_does_not_send_it_away(vehicles, drive):
    driver, _ = drive()
    driver.kill()
    vehicles[0].hears(FLY)
    child = os.fork()
    if child == 0:
        with contextlib.suppress(BaseException), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as stranger:
            os.setuid(65534)
            stranger.sendto(b"\0", keeper_module._door(vehicles[0].address))
            os._exit(0)
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0, "the keeper does not listen"
    vehicles[0].hears(LAND)  # HOVER_S later, from the keeper, which is still running


def test_the_keeper_of_a_driver_that_works_is_not_sent_away(vehicles, drive):
    driver, _ = drive()
    take_over(vehicles[0].address)
    driver.kill()
    vehicles[0].hears(FLY)


def test_a_driver_that_ends_takes_it_along():
    keeper = keeper_module.Keeper([free_address()])
    assert keeper.runs
    keeper.close()
    assert not keeper.runs


def test_a_driver_ends_without_one_that_has_died():
    keeper = keeper_module.Keeper([free_address()])
    keeper._process.kill()
    keeper.close()
    assert not keeper.runs
