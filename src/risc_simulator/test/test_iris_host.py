"""An IRIS+ of the virtual lab on its sockets: bytes of the serial line and MAVLink in, through the real firmware."""

import contextlib
import dataclasses
import random
import socket

import pytest
from addresses import own_net
from iris_flight import make_fleet
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from serial_client import ASK_FOR_TOPICS, STATUS_TOPIC, channels_of, controls, packets

from risc_simulator.faults import parse_fault
from risc_simulator.models.flight import FlightPhase
from risc_simulator.socket_host import reset
from risc_simulator.vehicles.iris import transmitter
from risc_simulator.vehicles.iris.firmware import Mode
from risc_simulator.vehicles.iris.host import MAX_BACKLOG_BYTES, STANDARD_PORTS, system_id
from risc_simulator.virtual_lab import VirtualLab

CONTROLS_S = 0.022


class Station:
    """A lab, and clients of its first vehicle's serial line and telemetry, in the lab's own time."""

    def __init__(self, n=1, **options):
        self.lab = VirtualLab(make_fleet(n), seed=3, **options)
        self.address = self.lab.fleet.vehicles[0].address
        self.vehicle = self.lab.world.vehicles["iris1"]
        self.autopilot, self.host = self.vehicle.firmware, self.lab.vehicle_hosts["iris1"]
        self.vehicle.change_plant(roll_level_rad=0.0, pitch_level_rad=0.0)  # no pilot holds its position
        self.line, self.bytes, self._next_s = None, b"", 0.0
        self.telemetry = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.telemetry.connect((self.address, STANDARD_PORTS.telemetry))
        self.telemetry.setblocking(False)
        self._codec = mavlink.MAVLink(None, 255, 190)
        self.heard = []

    def close(self):
        self.lab.close()
        self.telemetry.close()
        if self.line is not None:
            self.line.close()

    def hang_up(self):
        self.line.close()
        self.line = None

    def connect(self):
        self.line = socket.create_connection((self.address, STANDARD_PORTS.arduino), 5.0)
        self.line.setblocking(False)
        self.bytes = b""

    def start(self):
        """Open the line, negotiate, unlock the throttle."""
        self.connect()
        self.run(0.1)
        self.line.send(ASK_FOR_TOPICS)
        self.run(0.3)
        self.run(0.4, {"throttle": -1.0})

    def run(self, duration_s, sticks=None, until=None):
        """Let the lab run, and send sticks (numbers, or functions) meanwhile. Returns whether `until` came true."""
        world = self.lab.world
        end_s = world.time_s + duration_s
        while world.time_s < end_s - 1e-9:
            if sticks is not None and world.time_s >= self._next_s:
                self._next_s = world.time_s + CONTROLS_S
                self.line.send(controls(**{name: s() if callable(s) else s for name, s in sticks.items()}))
            self.lab.step()
            self._listen()
            if until is not None and until():
                return True
        return until is None

    def _listen(self):
        with contextlib.suppress(BlockingIOError):
            self.bytes += self.line.recv(65536) if self.line is not None else b""
        with contextlib.suppress(BlockingIOError):
            while True:
                self.heard += self._codec.parse_buffer(self.telemetry.recv(2048)) or []

    def inject(self, text):
        """Inject a fault, given in the syntax of the command line."""
        self.lab.inject(parse_fault(text))

    def tell(self, message):
        self.telemetry.send(message.pack(self._codec))

    def arm(self):
        arm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
        self.tell(mavlink.MAVLink_command_long_message(system_id(self.address), 1, arm, 0, 1, 0, 0, 0, 0, 0, 0))
        self.run(0.1, {"throttle": -1.0})
        assert self.autopilot.armed

    def keep(self, height_m=1.0):
        """Throttle that holds a height, from the vehicle's true state."""
        vehicle = self.vehicle
        up_g = (4.0 * (height_m - vehicle.height_m) - 3.5 * vehicle.state.velocity_m_s[2]) / 9.8
        return self.autopilot.hover_throttle(vehicle.battery_pct) + min(0.2, max(-0.2, up_g))

    def take_off(self):
        self.start()
        self.arm()
        self.run(4.0, {"throttle": self.keep})
        assert abs(self.vehicle.height_m - 1.0) < 0.06

    def lands(self, within_s, sticks=None):
        self.run(within_s, sticks, until=lambda: self.vehicle.phase is FlightPhase.LANDED)
        return self.vehicle.phase is FlightPhase.LANDED and not self.lab.world.crashes


@pytest.fixture
def station(clock):
    station = Station()
    yield station
    station.close()


@pytest.fixture
def flyer(station):
    station.take_off()
    return station


def test_it_says_where_it_is_to_be_reached(station):
    words = station.lab.describe().splitlines()[-1].split()  # scripts take words as they are: no trailing commas
    assert "udp://%s:14550" % station.address in words and "socket://%s:11411" % station.address in words


def test_bytes_on_the_serial_line_fly_it(flyer):
    assert flyer.vehicle.phase is FlightPhase.FLYING and flyer.autopilot.mode is Mode.STABILIZE
    flyer.run(0.4, {"phi": 0.15, "throttle": flyer.keep})
    assert flyer.autopilot.channels_us[0] == 1575
    stick = (75 - 20) / 480.0
    assert flyer.vehicle.state.phi == pytest.approx(stick * flyer.vehicle.type.tilt_max_rad, abs=0.01)


def test_the_board_answers_on_its_line(station):
    station.start()
    states = [channels_of(payload) for topic, payload in packets(station.bytes) if topic == STATUS_TOPIC]
    assert states[-1] == (2, (1500, 1500, 1000, 1500))


def test_telemetry_tells_of_the_flight(flyer):
    heartbeats = [m for m in flyer.heard if m.get_type() == "HEARTBEAT"]
    assert heartbeats[0].get_srcSystem() == 1 and heartbeats[-1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert "Arming motors" in [m.text for m in flyer.heard if m.get_type() == "STATUSTEXT"]


def test_a_command_takes_effect_after_line_frame_and_radio(flyer):
    """The delay of the vehicle type, plus the wait for the next frame."""
    flyer.run(1.0, {"throttle": flyer.keep})
    began_s = flyer.lab.world.time_s
    flyer._next_s = began_s
    flyer.run(1.0, {"phi": 0.2, "throttle": flyer.keep}, until=lambda: flyer.autopilot.command[0] != 0.0)
    delay_s = flyer.lab.world.time_s - began_s
    assert 0.8 * flyer.vehicle.plant.command_delay_s < delay_s < flyer.vehicle.plant.command_delay_s + 0.035


def test_put_back_after_a_fall_it_stands_disarmed_keeps_its_parameters_and_flies_again(flyer):
    with pytest.raises(ValueError, match="iris1 .*air"):
        flyer.lab.put_back("iris1")
    flyer.autopilot.parameters.set("LAND_SPEED", 61)
    flyer.autopilot.set_mode(Mode.LAND)
    flyer.autopilot.disarm(by_force=True)
    flyer.run(2.0, {"throttle": -1.0}, until=lambda: not flyer.autopilot.lifted)
    flyer.lab.put_back("iris1")
    state = flyer.vehicle.state
    assert state.position_m.tolist() == [0.0, 0.0, 0.08] and flyer.vehicle.battery_pct == 100.0
    assert (flyer.autopilot.armed, flyer.autopilot.mode) == (False, Mode.STABILIZE)
    assert flyer.autopilot.parameters["LAND_SPEED"] == 61 and not flyer.host.mavlink.clients
    flyer.run(1.0, {"throttle": -1.0})
    flyer.arm()
    flyer.run(4.0, {"throttle": flyer.keep})
    assert flyer.vehicle.phase is FlightPhase.FLYING and abs(flyer.vehicle.height_m - 1.0) < 0.06


# ------------------------------------------------------------------ what fails


def test_a_client_that_goes_leaves_a_board_whose_failsafe_lands(flyer):
    flyer.hang_up()
    flyer.run(0.75)
    assert flyer.autopilot.mode is Mode.LAND and flyer.autopilot.channels_us[2] == 950
    assert flyer.lands(6.0)
    assert flyer.run(3.0, until=lambda: not flyer.autopilot.armed)


def test_a_client_that_is_silent_does_the_same(flyer):
    assert flyer.lands(7.0)


def test_a_board_that_is_reset_in_flight_lands_the_vehicle(flyer):
    """Opening its port again resets the board."""
    flyer.hang_up()
    flyer.run(0.02)
    flyer.connect()
    flyer.run(0.2)
    assert flyer.autopilot.mode is Mode.LAND
    flyer.line.send(ASK_FOR_TOPICS)
    assert flyer.lands(6.0, {"throttle": 0.0})


def test_a_link_that_is_lost_takes_radio_and_telemetry_away_but_not_the_cable(flyer):
    flyer.inject("link_blackhole:1,iris1")
    flyer.heard.clear()
    flyer.bytes = b""
    flyer.run(0.65, {"throttle": flyer.keep})
    assert flyer.autopilot.mode is Mode.LAND and flyer.autopilot.radio_failsafe and not flyer.heard
    assert any(topic == STATUS_TOPIC for topic, _ in packets(flyer.bytes))
    assert flyer.lands(6.0, {"throttle": 0.0})
    assert "Radio Failsafe Cleared" in [m.text for m in flyer.heard if m.get_type() == "STATUSTEXT"]


@pytest.mark.parametrize(
    "fault",
    ["blackhole:channel=iris1/radio", "blackhole:channel=iris1/arduino", "corrupt:1,channel=iris1/radio"],
)
def test_silence_on_its_wires_lands_it(flyer, fault):
    """A corrupt frame of channels, an object without bytes, is lost."""
    flyer.inject(fault)
    assert flyer.lands(7.0, {"throttle": flyer.keep})


def test_without_the_faults_it_would_fly_on(flyer):
    """Control arm of the failure tests."""
    assert not flyer.lands(7.0, {"throttle": flyer.keep})
    assert flyer.vehicle.height_m == pytest.approx(1.0, abs=0.06)


def test_a_line_that_is_cut_is_closed_and_the_vehicle_lands(flyer):
    flyer.inject("cut:channel=iris1/arduino")
    with pytest.raises(OSError):
        flyer.run(1.0, {"throttle": flyer.keep})
    assert flyer.lab.wires.statistics()["iris1/arduino"]["cut"] == 1
    flyer.hang_up()
    assert flyer.lands(7.0)


def test_it_flies_on_without_telemetry(flyer):
    flyer.inject("blackhole:channel=iris1/mavlink")
    flyer.heard.clear()
    flyer.run(2.0, {"throttle": flyer.keep})
    assert flyer.vehicle.height_m == pytest.approx(1.0, abs=0.06) and not flyer.heard
    assert flyer.autopilot.mode is Mode.STABILIZE


def test_it_flies_with_a_fifth_of_the_radio_lost(clock):
    station = Station(radio_loss=0.2)
    try:
        station.start()
        for _ in range(20):  # an order may be lost, too
            if not station.autopilot.armed:
                arm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
                system = system_id(station.address)
                station.tell(mavlink.MAVLink_command_long_message(system, 1, arm, 0, 1, 0, 0, 0, 0, 0, 0))
                station.run(0.1, {"throttle": -1.0})
        station.run(5.0, {"throttle": station.keep})
        assert station.vehicle.height_m == pytest.approx(1.0, abs=0.1)
        counts = station.host.statistics()
        share = counts["radio_frames_lost"] / counts["ppm"]["frames"]
        assert 0.1 < share < 0.3
    finally:
        station.close()


# ------------------------------------------------------------------ clients


def test_one_client_at_a_time_and_the_next_one_when_it_has_gone(station):
    station.start()
    second = socket.create_connection((station.address, STANDARD_PORTS.arduino), 5.0)
    second.settimeout(5.0)
    station.run(0.1, {"throttle": -1.0})
    assert second.recv(10) == b"", "it was turned away"
    second.close()
    states = [channels_of(payload)[0] for topic, payload in packets(station.bytes) if topic == STATUS_TOPIC]
    assert states[-1] == 2, "and the first one's board was not reset"
    station.hang_up()
    station.run(0.02)
    station.start()
    assert station.autopilot.channels_us[2] == 1000
    events = station.host.statistics()["notices"]
    assert len(events["events"]["opens the serial line"]) == 2
    assert "is turned away: the serial line is open already" in events["complaints"]


def test_a_client_that_resets_the_connection_makes_room(station):
    station.start()
    reset(station.line)
    station.hang_up()
    station.run(0.02)
    station.start()
    assert station.autopilot.channels_us[2] == 1000


def test_a_client_that_never_reads_costs_no_more_than_a_buffer(station):
    station.connect()
    station.line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    station.line.send(ASK_FOR_TOPICS)
    reader, station.line = station.line, None
    station.run(20.0)
    line = station.host._line
    assert len(line._backlog) <= MAX_BACKLOG_BYTES
    station.line = reader


def test_any_bytes_on_any_port_and_it_serves_on(station):
    rng = random.Random(5)
    station.connect()
    for _ in range(200):
        noise = rng.randbytes(rng.randrange(1, 300))
        station.telemetry.send(noise)
        station.line.send(noise)
        station.lab.step()
        station._listen()
    assert station.autopilot.channels_us[:4] == (1500, 1500, 950, 1500), "noise commands nothing"
    station.hang_up()
    station.run(0.02)
    station.take_off()


def test_two_vehicles_have_nothing_in_common(clock):
    station = Station(2)
    try:
        station.take_off()
        other = station.lab.world.vehicles["iris2"]
        assert other.phase is FlightPhase.LANDED and other.firmware.channels_us[2] == 950
        assert station.lab.vehicle_hosts["iris2"].mavlink.system_id == 2
    finally:
        station.close()


def test_an_address_in_use_and_a_firmware_that_is_not_built_are_errors_that_name_the_cure(station, monkeypatch):
    mocap = dataclasses.replace(station.lab.fleet.mocap, host=own_net() + ".0.3")
    fleet = dataclasses.replace(station.lab.fleet, mocap=mocap)
    with pytest.raises(OSError, match="iris1: .* udp .*14550: in use"):
        VirtualLab(fleet)
    monkeypatch.setattr(transmitter, "LIBRARY", "libdueppm_elsewhere.so")
    with pytest.raises(OSError, match="./maap build"):
        VirtualLab(fleet)


def test_faults_name_the_channels_that_there_are(station):
    with pytest.raises(ValueError, match="iris1/mavlink, iris1/radio, iris1/arduino"):
        station.inject("drop:channel=iris1/navdata")


@pytest.mark.parametrize(
    "address, system", [("127.77.1.1", 1), ("127.77.1.250", 250), ("10.0.0.251", 1), ("1.2.3.0", 250)]
)
def test_the_system_id_comes_from_the_address(address, system):
    assert system_id(address) == system
