"""Members from outside the package: each is one file and one YAML in the folder `members`."""

import dataclasses
import pathlib
import socket
import sys
import threading

import av
import numpy as np
import pytest
from addresses import free_port, own_net

from ardrone_autonomy.protocol.video import StreamParser
from cortex_ros import wire
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab import FleetLandmark, fleet_from_dict, load_templates, load_vehicle_type
from risc_lab.lab.fleet import AttachedBody
from risc_lab.registry import VARIABLE
from risc_simulator import bodies, vehicles
from risc_simulator.faults import FaultEvent
from risc_simulator.models.flight import FlightAction, FlightPhase, Setpoint
from risc_simulator.virtual_lab import VirtualLab
from risc_simulator.world import World

MEMBERS = pathlib.Path(__file__).parent / "members"
ARDRONE = {"namespace": "risc1", "template": "fluffy_II", "type": "ardrone", "start": {"position_m": [0.5, 0.2, 0]}}
BALLOON_TYPE = "toy_balloon"
BALLOON = {"namespace": "risc2", "template": "Raven", "type": BALLOON_TYPE, "start": {"position_m": [-1, -1, 0]}}


@pytest.fixture(autouse=True)
def members(monkeypatch):
    """Put the folder on the member path."""
    monkeypatch.setenv(VARIABLE, str(MEMBERS))
    yield
    vehicles.virtual_type.cache_clear()


SPRING = {"body": "toy_spring", "template": "ball"}
BALL_OFFSETS = {"top": [0.0, 0.0, 0.02], "side": [0.02, 0.0, 0.0]}  # of its markers
BALL = {"geometries": {"ball": BALL_OFFSETS}, "templates": {"ball": {"kind": "attached", "geometry": "ball"}}}
M_KG, K_N_M, LENGTH_M = 0.05, 4.0, 0.3  # as in toy_spring.yaml
HANGS_M = LENGTH_M + M_KG * GRAVITY_M_S2 / K_N_M


def make_fleet(*vehicles):
    net = own_net()
    content = {
        "name": "toys",
        "mocap": {"host": net + ".0.1", "stream_port": free_port()},
        "vehicles": [dict(vehicle, address="%s.1.%d" % (net, k)) for k, vehicle in enumerate(vehicles, 1)],
        "templates": BALL,
    }
    return fleet_from_dict(content)


def balloon():
    return sys.modules["risc_simulator.vehicles.toy_balloon"]


def make_world(*vehicles, drag_n_s_m=None, **options):
    fleet = make_fleet(*vehicles)
    drag = {} if drag_n_s_m is None else {"drag_n_s_m": drag_n_s_m}
    types = {v.type: dataclasses.replace(load_vehicle_type(v.type), **drag) for v in fleet.vehicles}
    return World(fleet, types, load_templates(fleet=fleet), seed=3, **options)


def fly(world):
    """Truth of a flight of a mixed fleet through all phases; the balloon rises after 1 s."""
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


def test_a_vehicle_type_says_how_its_reports_are_repeated():
    act = FaultEvent("navdata_freeze").module.make(1.0, np.random.default_rng(0))
    heard = [act(datagram, 0.0) for datagram in (b"0.300", b"up 0.4", b"0.400", b"unknown")]
    assert heard == [[(0.0, datagram)] for datagram in (b"0.300", b"up 0.4", b"0.300", b"unknown")]


def test_a_vehicle_type_has_its_own_equations_and_leaves_the_others_alone():
    mixed, alone = make_world(ARDRONE, BALLOON, gusts=True), make_world(ARDRONE, gusts=True)
    rows = fly(mixed)
    np.testing.assert_array_equal(rows[:, 0], fly(alone)[:, 0])
    height_m = rows[:, 1, 2]
    tau_s = mixed.vehicles["risc2"].plant.climb_time_constant_s
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
            address = lab.fleet.vehicles[0].address, balloon().PORT
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


def test_a_vehicle_type_has_its_own_camera():
    """Its mount, field of view and size differ from an AR.Drone's; a disc behind the balloon is in the image centre."""
    fleet = dataclasses.replace(
        make_fleet(BALLOON), landmarks=(FleetLandmark("Green_pink", (-2.4, -1.0, 0.08), facing_deg=0.0),)
    )
    lab = VirtualLab(fleet, seed=3, cameras_ahead=True)
    stop = threading.Event()
    thread = threading.Thread(target=lab.run, args=(stop,))
    thread.start()
    try:
        with socket.create_connection((fleet.vehicles[0].address, balloon().VIDEO_PORT), 60.0) as client:
            parser, packets = StreamParser(), []
            while not packets:
                packets = parser.feed(client.recv(1 << 16))
        assert packets[0].header.display_px == (320, 240)
        (frame,) = av.CodecContext.create("h264", "r").decode(av.Packet(packets[0].payload))
        blue, green, red = frame.to_ndarray(format="bgr24")[120, 160].tolist()
        assert green > 1.3 * blue and green > 1.3 * red
    finally:
        stop.set()
        thread.join()
        lab.close()


def test_a_fault_acts_on_the_datagrams_of_any_host(clock):
    faults = [
        FaultEvent("toy_every", channel="risc2/heights", severity=2.0),
        FaultEvent("delay", channel="risc2/commands", severity=0.05),
    ]
    lab = VirtualLab(make_fleet(BALLOON), seed=3, events=faults)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.settimeout(5.0)
            for _ in range(4):
                client.sendto(b"up 0.0", (lab.fleet.vehicles[0].address, balloon().PORT))
                for _ in range(20):
                    lab.step()
            assert [client.recv(64) for _ in range(4)] == [b"0.080", b"0.", b"0.080", b"0."]
        assert lab.wires.statistics()["risc2/commands"] == {"sent": 4, "delivered": 4, "later": 4}
    finally:
        lab.close()


def test_an_incomplete_type_is_refused_by_name(monkeypatch, tmp_path):
    (tmp_path / "virtual_vehicles").mkdir()
    (tmp_path / "virtual_vehicles/half.py").write_text("Host = object\n")
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    with pytest.raises(ValueError, match="half.*Firmware"):
        vehicles.virtual_type("half")


def spring_world(**options):
    world = make_world(dict(ARDRONE, attached=SPRING), drag_n_s_m=0.0, perturbed=False, **options)
    return world, world.vehicles["risc1"]


def mechanics(vehicle):
    """Energy [J] and momentum [N s; cortex axes] of vehicle and ball."""
    state, mass_kg = vehicle.state, vehicle.plant.mass_kg
    ball_m, rate_m_s = vehicle.body_state[:3] * [1, -1, 1], vehicle.body_state[3:] * [1, -1, 1]
    stretch_m = np.linalg.norm(ball_m - state.position_m) - LENGTH_M
    energy_j = (
        0.5 * mass_kg * state.velocity_m_s @ state.velocity_m_s
        + 0.5 * M_KG * rate_m_s @ rate_m_s
        + GRAVITY_M_S2 * (mass_kg * state.position_m[2] + M_KG * ball_m[2])
        + 0.5 * K_N_M * stretch_m**2
    )
    return energy_j, mass_kg * state.velocity_m_s + M_KG * rate_m_s


def test_a_body_and_its_vehicle_exchange_energy_and_momentum_and_lose_none():
    world, vehicle = spring_world(step_s=0.002)
    vehicle.fly_at((0.0, 0.0, 2.2), 0.7)
    vehicle.schedule(0.0, Setpoint(roll_rad=0.2, pitch_rad=0.25, yaw_rate_rad_s=0.3, climb_m_s=0.1))
    vehicle.schedule(0.7, FlightAction.CUT_MOTORS)
    world.step_to(0.7 + world.step_s)
    energies_j, momenta, speeds_m_s, times_s = [], [], [], []
    while vehicle.height_m > 0.3:
        energy_j, momentum = mechanics(vehicle)
        energies_j.append(energy_j)
        momenta.append(momentum)
        times_s.append(world.time_s)
        speeds_m_s.append(vehicle.state.velocity_m_s[0])
        world.step_to(world.time_s + world.step_s)
    assert len(times_s) > 200
    np.testing.assert_allclose(energies_j, energies_j[0], rtol=0, atol=1e-7)
    fallen = np.outer(np.array(times_s) - times_s[0], [0, 0, -(vehicle.plant.mass_kg + M_KG) * GRAVITY_M_S2])
    np.testing.assert_allclose(np.array(momenta) - momenta[0], fallen, rtol=0, atol=1e-7)
    assert np.ptp(speeds_m_s) > 0.01, "the ball pulls"


def test_a_body_hangs_still_while_the_vehicle_stands_and_swings_in_flight():
    world, vehicle = spring_world()
    np.testing.assert_allclose(vehicle.body_state, [0.5, -0.2, vehicle.height_m - HANGS_M, 0, 0, 0])
    vehicle.schedule(0.0, FlightAction.TAKE_OFF)
    vehicle.schedule(6.0, Setpoint(pitch_rad=-0.1))
    world.step_to(6.0)
    assert vehicle.height_m - vehicle.body_state[2] == pytest.approx(HANGS_M, abs=0.02)
    felt_n = -vehicle.plant.mass_kg * vehicle.state.specific_force_m_s2[2]
    assert felt_n == pytest.approx(vehicle.plant.mass_kg * GRAVITY_M_S2, rel=0.02)  # thrust minus the ball's weight
    world.step_to(6.5)
    assert vehicle.body_state[0] < vehicle.state.position_m[0] - 0.01, "it lags behind"
    vehicle.schedule(7.0, FlightAction.LAND)
    world.step_to(12.0)
    assert vehicle.phase is FlightPhase.LANDED
    np.testing.assert_array_equal(vehicle.body_state[3:], 0.0)


def test_who_carries_nothing_flies_as_without_the_other():
    second = dict(ARDRONE, namespace="risc2", template="Raven", start={"position_m": [-1, -1, 0]}, attached=SPRING)
    with_body, alone = make_world(ARDRONE, second, gusts=True), make_world(ARDRONE, gusts=True)
    np.testing.assert_array_equal(fly(with_body)[:, 0], fly(alone)[:, 0])
    assert with_body.layout[-1] == ("ball", 2)


def test_the_markers_of_a_body_are_in_the_mocap_frames(clock):
    lab = VirtualLab(make_fleet(dict(ARDRONE, attached=SPRING)), seed=3, exact_markers=True, live=True)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.settimeout(5.0)
            lab.step()
            client.sendto(wire.encode_packet(wire.Command.REQUEST_FRAME), lab.cortex_host.address)
            lab.step()
            frame = wire.decode_frame(wire.split_packet(client.recv(65536))[1])
            found = {body.name: np.array(body.markers_mm) for body in frame.bodies}
        expected_m = np.array([0.5, 0.2, 0.08 - HANGS_M]) + list(BALL_OFFSETS.values())
        np.testing.assert_allclose(found["ball"] / 1000.0, expected_m, atol=1e-6)
        assert list(found) == ["fluffy_II", "ball"]
    finally:
        lab.close()


def test_a_vehicle_that_is_put_back_has_its_body_hang_at_rest_again():
    lab = VirtualLab(make_fleet(dict(ARDRONE, attached=SPRING)))
    try:
        vehicle = lab.world.vehicles["risc1"]
        at_rest = vehicle.body_state
        vehicle.fly_at((0.0, 0.5, 2.0))
        lab.world.step_to(0.5)
        vehicle.schedule(lab.world.time_s, FlightAction.CUT_MOTORS)
        lab.world.step_to(3.0)
        lab.put_back()
        np.testing.assert_array_equal(vehicle.body_state, at_rest)
    finally:
        lab.close()


def test_a_fleet_with_a_body_survives_its_file_and_two_of_one_name_are_refused():
    fleet = make_fleet(dict(ARDRONE, attached=SPRING))
    assert fleet.vehicles[0].attached == AttachedBody("toy_spring", "ball")
    assert fleet_from_dict(fleet.to_dict()) == fleet
    with pytest.raises(ValueError, match="same template: fluffy_II"):
        make_fleet(dict(ARDRONE, attached={"body": "toy_spring", "template": "fluffy_II"}))


def test_a_body_with_a_number_that_is_missing_is_refused(monkeypatch, tmp_path):
    (tmp_path / "bodies").mkdir()
    (tmp_path / "bodies/half.py").write_text("SIZE, FIELDS = 1, ('length_m',)\n")
    (tmp_path / "bodies/half.yaml").write_text("width_m: 1.0\n")
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    with pytest.raises(ValueError, match="half.*length_m"):
        bodies.load_body("half")
    with pytest.raises(ValueError, match="'anvil' .*bodies"):
        make_world(dict(ARDRONE, attached={"body": "anvil", "template": "ball"}))
