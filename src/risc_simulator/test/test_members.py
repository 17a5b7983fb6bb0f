"""Members from elsewhere: each is one file and one YAML in the folder `members`."""

import pathlib
import random
import socket
import sys

import numpy as np
import pytest

from risc_lab.lab import fleet_from_dict, load_templates, load_vehicle_type
from risc_lab.registry import VARIABLE
from risc_simulator import vehicles
from risc_simulator.virtual_lab import VirtualLab
from risc_simulator.world import FlightAction, FlightPhase, Setpoint, World

MEMBERS = pathlib.Path(__file__).parent / "members"
ARDRONE = {"namespace": "risc1", "template": "fluffy_II", "type": "ardrone", "start": {"position_m": [0.5, 0.2, 0]}}
BALLOON_TYPE = str(MEMBERS / "vehicle_types/toy_balloon.yaml")
BALLOON = {"namespace": "risc2", "template": "Raven", "type": BALLOON_TYPE, "start": {"position_m": [-1, -1, 0]}}


@pytest.fixture(autouse=True)
def members(monkeypatch):
    """The folder takes part."""
    monkeypatch.setenv(VARIABLE, str(MEMBERS))
    yield
    vehicles.virtual_type.cache_clear()


def make_fleet(*vehicles):
    net = "127.%d" % random.SystemRandom().randint(140, 169)
    content = {
        "name": "toys",
        "mocap": {"host": net + ".0.1", "stream_port": 12001},
        "vehicles": [dict(vehicle, address="%s.1.%d" % (net, k)) for k, vehicle in enumerate(vehicles, 1)],
    }
    return fleet_from_dict(content)


def make_world(*vehicles, **options):
    fleet = make_fleet(*vehicles)
    types = {vehicle.type: load_vehicle_type(vehicle.type) for vehicle in fleet.vehicles}
    return World(fleet, types, load_templates(fleet=fleet), seed=3, **options)


def fly(world):
    """Truth of a flight with everything that a mixed fleet does; the balloon rises after a second."""
    ardrone = world.vehicles["risc1"]
    ardrone.schedule(0.1, FlightAction.TAKE_OFF)
    for k in range(60):
        ardrone.schedule(5.0 + k / 30.0, Setpoint(0.05 * (-1) ** (k // 20), 0.02, 0.1, 0.3))
    if "risc2" in world.vehicles:
        world.vehicles["risc2"].schedule(1.0, Setpoint(climb_m_s=0.4))
        world.vehicles["risc2"].schedule(3.0, Setpoint())
    rows = []
    for k in range(1, 81):
        world.step_to(0.1 * k)
        rows.append(world.truth())
    return np.array(rows)


def test_a_vehicle_type_has_its_own_equations_and_leaves_the_others_alone():
    mixed, alone = make_world(ARDRONE, BALLOON, gusts=True), make_world(ARDRONE, gusts=True)
    rows = fly(mixed)
    np.testing.assert_array_equal(rows[:, 0], fly(alone)[:, 0])
    height_m = rows[:, 1, 2]
    tau_s = load_vehicle_type(BALLOON_TYPE).climb_time_constant_s
    risen_s = 1.0 - tau_s * (1.0 - np.exp(-1.0 / tau_s))  # from 1 s to 2 s
    assert height_m[19] - height_m[9] == pytest.approx(0.4 * risen_s, rel=0.02)
    assert height_m[-1] == pytest.approx(height_m[0] + 0.4 * 2.0, rel=0.02)
    assert mixed.vehicles["risc1"].phase is FlightPhase.FLYING and not mixed.crashes


def test_vehicles_of_two_types_meet():
    world = make_world(ARDRONE, BALLOON)
    world.vehicles["risc1"].fly_at((-1.0, -1.0, 1.2))
    world.vehicles["risc2"].schedule(0.0, Setpoint(climb_m_s=0.5))
    world.step_to(6.0)
    assert {crash.reason for crash in world.crashes} == {"collided with risc1", "collided with risc2"}
    assert world.least_separation_m < 0.5


def test_the_lab_speaks_its_wire(clock):
    lab = VirtualLab(make_fleet(BALLOON), seed=3)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.settimeout(5.0)
            address = lab.fleet.vehicles[0].address, sys.modules["risc_simulator.vehicles.toy_balloon"].PORT
            client.sendto(b"up 0.4", address)
            for _ in range(200):
                lab.step()
            assert client.recv(64) == b"0.080"
            client.sendto(b"up 0.0", address)
            lab.step()
            assert float(client.recv(64)) > 0.2
        assert "risc2: a balloon" in lab.describe()
        assert lab.statistics()["vehicles"]["risc2"]["video"]["pictures"] == 0
        assert not lab.cameras_ready
    finally:
        lab.close()


def test_an_incomplete_type_is_refused_by_name(monkeypatch, tmp_path):
    (tmp_path / "virtual_vehicles").mkdir()
    (tmp_path / "virtual_vehicles/half.py").write_text("Host = object\n")
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    with pytest.raises(ValueError, match="half.*Firmware"):
        vehicles.virtual_type("half")
