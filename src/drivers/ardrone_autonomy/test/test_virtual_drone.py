"""Link and thread against the virtual lab's aircraft: physics, radio delay, the vehicle's own rules."""

import threading
import time

import pytest

pytest.importorskip("risc_simulator.virtual_lab", reason="the virtual lab is not in this workspace")

from scripted_drone import free_address

from ardrone_autonomy.link import Phase
from ardrone_autonomy.piloting import sticks_from_velocity
from ardrone_autonomy.settings import setup_writes, wanted_texts
from ardrone_autonomy.udp import UdpThread
from risc_lab.lab import load_fleet
from risc_simulator.faults import parse_fault
from risc_simulator.models.flight import FlightPhase
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
def thread(lab):
    thread = make_thread(lab, {"outdoor": 1, "euler_angle_max": 0.3, "enemy_colors": 3})
    thread.start()
    yield thread
    thread.stop()


def wait_for(condition, limit_s=20.0):
    deadline_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline_s, "waited %g s" % limit_s
        time.sleep(0.01)


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


def test_flight_emergency_and_lost_link(lab, thread):
    vehicle, host = lab.world.vehicles["risc1"], lab.vehicle_hosts["risc1"]
    wait_for(lambda: thread.link.phase is Phase.READY)
    assert host.get("control:euler_angle_max") == pytest.approx(0.3)
    assert host.get("control:control_vz_max") == pytest.approx(1000.0)  # came with outdoor
    assert host.get("detect:enemy_colors") == 3
    assert host.configuration.current_ids == (SESSION, "cea48d22", "e182b69b")
    assert host.statistics()["config_ignored"] == 2  # to delete profiles that there are not

    thread.post(thread.link.take_off)
    wait_for(lambda: vehicle.phase is FlightPhase.HOVERING)

    # forward, and to the left: +x and +y of the room for a vehicle that looks along x
    start_m = vehicle.state.position_m
    thread.post(thread.link.steer, sticks_from_velocity((0.2, 0.2, 0.0), (0.0, 0.0, 0.0)))
    wait_for(lambda: vehicle.state.position_m[0] > start_m[0] + 0.1 and vehicle.state.position_m[1] > start_m[1] + 0.1)
    # a counter-clockwise turn decreases psi
    psi = vehicle.state.psi
    thread.post(thread.link.steer, sticks_from_velocity((0.0, 0.0, 0.0), (0.0, 0.0, 0.2)))
    wait_for(lambda: vehicle.state.psi < psi - 0.2)
    thread.post(thread.link.steer, sticks_from_velocity((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    wait_for(lambda: vehicle.phase is FlightPhase.HOVERING)

    # a lost link: the vehicle lands by itself, and is ready for another flight afterwards
    lab.inject(parse_fault("link_blackhole:3,risc1"))
    wait_for(lambda: thread.link.phase is Phase.SEARCHING)
    wait_for(lambda: thread.link.phase is Phase.READY)
    wait_for(lambda: vehicle.phase is FlightPhase.LANDED)
    assert host.get("control:euler_angle_max") == pytest.approx(0.3)
    thread.post(thread.link.take_off)
    wait_for(lambda: vehicle.phase is FlightPhase.HOVERING)

    # reset in the air stops the motors, on the ground it clears the emergency
    thread.post(thread.link.reset)
    wait_for(lambda: thread.link.emergency)
    wait_for(lambda: vehicle.state.position_m[2] < REST_HEIGHT_M + 0.01)  # it falls
    time.sleep(0.5)  # and lies
    thread.post(thread.link.reset)
    wait_for(lambda: not thread.link.emergency)
    wait_for(lambda: vehicle.phase is FlightPhase.LANDED)
    thread.post(thread.link.take_off)
    wait_for(lambda: vehicle.phase is FlightPhase.HOVERING)
    thread.post(thread.link.land)
    wait_for(lambda: vehicle.phase is FlightPhase.LANDED)
    assert host.statistics()["at_malformed"] == host.statistics()["at_unknown"] == 0
