"""Link and thread against the virtual lab's aircraft: physics, radio delay, the vehicle's own rules."""

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

pytest.importorskip("risc_simulator.virtual_lab", reason="the virtual lab is not in this workspace")

from scripted_drone import fly_until, free_address

from ardrone_autonomy.aircraft_configuration import APPLICATION_ID, USER_ID, setup_writes, wanted_texts
from ardrone_autonomy.link import Phase
from ardrone_autonomy.piloting import sticks_from_velocity
from ardrone_autonomy.udp import UdpThread
from risc_lab.lab import load_fleet
from risc_lab.testing import wait_for
from risc_simulator.faults import parse_fault
from risc_simulator.models.flight import FlightPhase
from risc_simulator.socket_host import Told
from risc_simulator.virtual_lab import VirtualLab
from risc_simulator.world import REST_HEIGHT_M

SESSION = "0badcafe"
FLEET = """
name: one
mocap: {host: %s, command_port: 26000, stream_group: 225.1.1.77, stream_port: 26001, interface: 127.0.0.1}
vehicles:
  - {namespace: risc1, template: fluffy_II, type: ardrone, address: %s, start: {position_m: [0, 0, 0], yaw_deg: 0}}
"""


@pytest.fixture
def lab(tmp_path):
    address = free_address()
    (tmp_path / "fleet.yaml").write_text(FLEET % (address, address))
    lab = VirtualLab(load_fleet(tmp_path / "fleet.yaml"), seed=1)
    stop = threading.Event()
    runner = threading.Thread(target=lab.run, args=(stop,), daemon=True)
    runner.start()
    yield lab
    stop.set()
    runner.join()
    lab.close()


def make_thread(lab, parameters):
    return UdpThread(
        lab.fleet.vehicles[0].address,
        lambda *_: None,
        lambda _packet: None,
        lambda _error: None,
        setup_writes=setup_writes(wanted_texts(parameters), SESSION),
        session_id=SESSION,
        settle_s=0.1,
    )


@pytest.fixture
def ignored(lab):
    """Set of configuration writes (key, text) that the vehicle ignores; request this fixture before `thread`."""
    configuration, ignored = lab.vehicle_hosts["risc1"].configuration, set()
    obey = configuration.write

    def write(key, text, ids=None):
        obeyed = obey(key, text, ids)
        if not obeyed:
            ignored.add((key, text))
        return obeyed

    configuration.write = write
    return ignored


@pytest.fixture
def thread(lab):
    thread = make_thread(lab, {"outdoor": 1, "euler_angle_max": 0.3, "enemy_colors": 3})
    thread.start()
    yield thread
    thread.stop()


HOVER, FORWARD_LEFT, COUNTER_CLOCKWISE = (
    sticks_from_velocity(linear, angular)
    for linear, angular in (((0, 0, 0), (0, 0, 0)), ((0.2, 0.2, 0), (0, 0, 0)), ((0, 0, 0), (0, 0, 0.2)))
)


def test_what_another_client_left_in_the_vehicle_is_overwritten(lab):
    host = lab.vehicle_hosts["risc1"]
    for key, text in (("control:outdoor", "TRUE"), ("control:altitude_max", "100000")):
        assert host.configuration.write(key, text)
    assert host.get("control:control_vz_max") == 1000.0
    thread = make_thread(lab, {"outdoor": 0, "altitude_max": 3000, "euler_angle_max": 0.35})
    thread.start()
    try:
        wait_for(lambda: thread.link.phase is Phase.READY)
    finally:
        thread.stop()
    assert host.get("control:outdoor") is False
    assert host.get("control:altitude_max") == 3000
    assert host.get("control:control_vz_max") == 700.0  # came with outdoor
    assert host.get("control:euler_angle_max") == pytest.approx(0.35)  # outdoor came first and did not undo it


def test_flight_emergency_and_lost_link(lab, ignored, thread):
    vehicle, host = lab.world.vehicles["risc1"], lab.vehicle_hosts["risc1"]
    wait_for(lambda: thread.link.phase is Phase.READY)
    assert host.get("control:euler_angle_max") == pytest.approx(0.3)
    assert host.get("control:control_vz_max") == pytest.approx(1000.0)  # came with outdoor
    assert host.get("detect:enemy_colors") == 3
    assert host.configuration.current_ids == (SESSION, "cea48d22", "e182b69b")
    assert host.get("general:com_watchdog") == thread.link.lost_s == 1
    # They delete profiles that do not exist. A set, because a driver that stalled writes them again.
    assert ignored == {("custom:profile_id", "-" + USER_ID), ("custom:application_id", "-" + APPLICATION_ID)}

    def hovers():
        return vehicle.phase is FlightPhase.HOVERING

    fly_until(thread, HOVER, hovers)
    # +x and +y of the room for a vehicle that looks along x
    x_m, y_m, _ = vehicle.state.position_m
    fly_until(thread, FORWARD_LEFT, lambda: min(vehicle.state.position_m[:2] - (x_m, y_m)) > 0.1)
    # a counter-clockwise turn decreases psi
    psi = vehicle.state.psi
    fly_until(thread, COUNTER_CLOCKWISE, lambda: vehicle.state.psi < psi - 0.2)
    fly_until(thread, HOVER, hovers)

    # a lost link: the vehicle lands by itself, and is ready for another flight afterwards
    lab.inject(parse_fault("link_blackhole:3,risc1"))
    wait_for(lambda: thread.link.phase is Phase.SEARCHING)
    wait_for(lambda: thread.link.phase is Phase.READY)
    wait_for(lambda: vehicle.phase is FlightPhase.LANDED)
    assert host.get("control:euler_angle_max") == pytest.approx(0.3)
    fly_until(thread, HOVER, hovers)

    # reset in the air stops the motors, on the ground it clears the emergency
    thread.post(thread.link.reset)
    wait_for(lambda: thread.link.emergency)
    wait_for(lambda: vehicle.state.position_m[2] < REST_HEIGHT_M + 0.01)  # it falls
    time.sleep(0.5)  # and lies
    thread.post(thread.link.reset)
    wait_for(lambda: not thread.link.emergency)
    wait_for(lambda: vehicle.phase is FlightPhase.LANDED)
    fly_until(thread, HOVER, hovers)
    thread.post(thread.link.land)
    wait_for(lambda: vehicle.phase is FlightPhase.LANDED)
    assert host.statistics()["at_malformed"] == host.statistics()["at_unknown"] == 0


# A driver that obeys orders on its standard input; "steer" never ends. Arguments: address, whether it has a keeper
PILOT = """
import sys, threading, time
from ardrone_autonomy.keeper import Keeper
from ardrone_autonomy.piloting import Sticks
from ardrone_autonomy.aircraft_configuration import setup_writes, wanted_texts
from ardrone_autonomy.udp import UdpThread

address, kept = sys.argv[1:]
keeper = Keeper([address]) if kept == "True" else None

def note(now_s, link):
    if keeper is not None:
        keeper.note(0, now_s, link.connections > 0, link.keeps_flying)

writes = setup_writes(wanted_texts({"outdoor": 1, "euler_angle_max": 0.3, "enemy_colors": 3}), "0badcafe")
ends = lambda *_: None
thread = UdpThread(address, ends, ends, ends, note, setup_writes=writes, session_id="0badcafe", settle_s=0.0)
thread.start()
for line in sys.stdin:
    if line.strip() == "take off":
        thread.post(thread.link.take_off)
    while line.strip() == "steer":
        if not thread.link.keeps_flying:  # it lands by itself when the lab or the computer stood still
            thread.post(thread.link.take_off)
        thread.post(thread.link.steer, Sticks(1, 0.0, -0.15, 0.0, 0.0))
        time.sleep(0.03)
"""


@pytest.fixture
def pilot(lab):
    """Function that starts a driver and returns its process once the vehicle exceeds 0.4 m/s, still accelerating.

    A driver orders to land, too, when the computer stood still: so a speed without the order to fly does not count.
    """
    started = []

    def start(kept=True):
        words = [sys.executable, "-c", PILOT, lab.fleet.vehicles[0].address, str(kept)]
        process = subprocess.Popen(words, stdin=subprocess.PIPE, text=True)
        started.append(process)
        vehicle, host = lab.world.vehicles["risc1"], lab.vehicle_hosts["risc1"]

        def take_off():
            process.stdin.write("take off\n")
            process.stdin.flush()
            return vehicle.phase is FlightPhase.HOVERING or time.sleep(0.2)

        wait_for(take_off)
        process.stdin.write("steer\n")
        process.stdin.flush()
        wait_for(lambda: speed_m_s(lab) > 0.4 and host.told is Told.FLY)
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stdin.close()


def speed_m_s(lab):
    return float(np.linalg.norm(lab.world.vehicles["risc1"].state.velocity_m_s[:2]))


def speed_after(lab, duration_s):
    """Speed of the vehicle [m/s] after duration_s of the lab's own time."""
    until_s = lab.world.time_s + duration_s
    wait_for(lambda: lab.world.time_s >= until_s)
    return speed_m_s(lab)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_the_vehicle_of_a_driver_that_dies_or_hangs_stops_and_lands(lab, pilot, number):
    process, vehicle = pilot(), lab.world.vehicles["risc1"]
    os.kill(process.pid, number)
    wait_for(lambda: lab.vehicle_hosts["risc1"].told is Told.HOVER)
    assert speed_after(lab, 1.8) < 0.3
    wait_for(lambda: vehicle.phase is FlightPhase.LANDED)


def test_without_a_keeper_it_flies_on_with_its_last_tilt(lab, pilot):
    os.kill(pilot(kept=False).pid, signal.SIGKILL)
    assert speed_after(lab, 0.9) > 0.4 and lab.vehicle_hosts["risc1"].told is Told.FLY


def test_a_new_driver_keeps_a_vehicle_in_the_air(lab, pilot):
    """Its old driver, without a keeper, was killed; it then hovers longer than it would without a driver."""
    os.kill(pilot(kept=False).pid, signal.SIGKILL)
    host, vehicle = lab.vehicle_hosts["risc1"], lab.world.vehicles["risc1"]
    thread = make_thread(lab, {"outdoor": 1, "euler_angle_max": 0.3, "enemy_colors": 3})
    thread.start()
    try:
        wait_for(lambda: thread.link.phase is Phase.READY)
        assert thread.link.keeps_flying and host.told is Told.HOVER
        assert speed_after(lab, 3.0) < 0.3 and vehicle.phase in (FlightPhase.HOVERING, FlightPhase.FLYING)
    finally:
        thread.stop()
    wait_for(lambda: vehicle.phase is FlightPhase.LANDED)
