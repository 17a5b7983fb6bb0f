"""The AR.Drone on the wire: real loopback sockets, simulated time, a client that shares no code with it.

The client speaks bytes (struct, text) and knows only the public description of the protocol, so a mistake in the codec
is not mirrored here.
"""

import contextlib
import dataclasses
import errno
import ftplib
import logging
import math
import os
import select
import socket
import struct
import threading
import time
import types

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ardrone_autonomy.protocol.navdata import ALL_TAGS, Navdata, peek
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab import Fleet, FleetVehicle, MocapEndpoint, Start, Template, load_vehicle_type
from risc_simulator.faults import FaultEvent
from risc_simulator.models.flight import FlightAction, FlightPhase, Setpoint, VehicleState
from risc_simulator.vehicles.ardrone import host as ardrone_host
from risc_simulator.vehicles.ardrone.host import ArdroneHost, Ports
from risc_simulator.vehicles.ardrone.sensors import Flow
from risc_simulator.world import World

ADDRESS = "127.93.%d.%d" % (os.getpid() // 250 % 250, 1 + os.getpid() % 250)  # tests may run side by side
FREE = Ports(0, 0, 0, 0)
STEP_S = 0.005
VEHICLE_TYPE = load_vehicle_type("ardrone")
MARKERS = np.array([[0.2, 0.2, 0.0], [0.2, -0.2, 0.0], [-0.2, 0.2, 0.0], [-0.1, -0.2, -0.08]])
LANDED, FLYING, HOVERING, TAKING_OFF, LANDING = 2, 3, 4, 6, 8

IDLE, START, SELECT = 0x11540000, 0x11540200, 0x11540100
ACK, DEMO, BOOTSTRAP, COM_LOST, BATTERY_LOW, COM_WATCHDOG, EMERGENCY = (1 << b for b in (6, 10, 11, 13, 15, 30, 31))


def bits(value):
    return struct.unpack("<i", struct.pack("<f", value))[0]


class Client:
    """A ground station, bytes only."""

    def __init__(self, host):
        self.host = host
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.bind(("127.0.0.1", 0))
        self.udp.setblocking(False)
        self.sequence = 0

    def wake_up(self, data=b"\x01\0\0\0"):
        self.udp.sendto(data, (self.host.address, self.host.ports.navdata))

    def raw(self, data):
        self.udp.sendto(data, (self.host.address, self.host.ports.at))

    def at(self, *commands):
        """Each command "NAME" or "NAME,arguments"; all in one datagram."""
        text = ""
        for command in commands:
            self.sequence += 1
            name, _, arguments = command.partition(",")
            text += "AT*%s=%d%s\r" % (name, self.sequence, "," + arguments if arguments else "")
        self.raw(text.encode())

    def config(self, key, value, ids=None):
        head = ['CONFIG_IDS,"%s","%s","%s"' % ids] if ids else []
        self.at(*head, 'CONFIG,"%s","%s"' % (key, value))

    def packets(self):
        """All packets that have arrived, checked: list of (state, sequence, {tag: payload}, bytes)."""
        result = []
        while True:
            try:
                data, sender = self.udp.recvfrom(65536)
            except BlockingIOError:
                return result
            assert sender == (self.host.address, self.host.ports.navdata)
            magic, state, sequence, _ = struct.unpack_from("<IIII", data)
            assert magic == 0x55667788
            options, at = {}, 16
            while True:
                tag, size = struct.unpack_from("<HH", data, at)
                if tag == 0xFFFF:
                    break
                options[tag] = data[at + 4 : at + size]
                at += size
            assert size == 8 and at + 8 == len(data)
            assert struct.unpack_from("<I", data, at + 4)[0] == sum(data[:at])
            result.append((state, sequence, options, data))


class Lab:
    """One vehicle, its host and a client; run() advances the clock."""

    def __init__(self, vehicle, world=None, **options):
        self.world, self.vehicle = world, vehicle
        self.now_s = 0.0
        options.setdefault("ports", FREE)
        self.host = ArdroneHost(vehicle, options.pop("address", ADDRESS), **options)
        self.client = Client(self.host)
        self.packets = []  # of the last run()
        self.steps = 0

    def serve(self):
        for _ in range(20):
            ready, _, _ = select.select(self.host.sockets(), [], [], 0)
            if not ready:
                return
            for sock in ready:
                self.host.on_readable(sock, self.now_s)
        raise AssertionError("sockets stay readable")

    def lose_link(self, duration_s):
        """From now on, for duration_s, nothing passes in either direction."""
        everywhere = self.vehicle.namespace + "/*"
        event = FaultEvent("link_blackhole", channel=everywhere, start_s=self.now_s, duration_s=duration_s)
        self.host.wires.add(event)

    def run(self, seconds, ref=None, pcmd=None, every=5):
        """ref, pcmd: sent every 25 ms; None sends nothing. Returns the packets of this time."""
        self.packets = []
        for _ in range(int(round(seconds / STEP_S))):
            self.steps += 1
            self.now_s = self.steps * STEP_S
            if self.world is not None:
                self.world.step_to(self.now_s)
            commands = []
            if self.steps % every == 0:
                commands += ["REF,%d" % ref] if ref is not None else []
                commands += ["PCMD,%d,%d,%d,%d,%d" % ((pcmd[0],) + tuple(map(bits, pcmd[1:])))] if pcmd else []
            if commands:
                self.client.at(*commands)
            self.serve()
            self.host.tick(self.now_s)
            self.packets += self.client.packets()
        return self.packets

    def connect(self, demo=False):
        self.client.wake_up()
        self.run(0.1)
        self.client.config("general:navdata_demo", "TRUE" if demo else "FALSE")
        self.run(0.05)
        self.client.at("CTRL,5,0", "COMWDG")
        self.run(0.1, ref=IDLE)

    def fly(self):
        """Connect, take off, hover. The vehicle is placed at its height, which saves the seconds of the climb."""
        self.connect()
        self.run(0.3, ref=START, pcmd=HOVER)
        assert self.vehicle.phase is FlightPhase.TAKING_OFF
        self.vehicle.fly_at((0.0, 0.0, 1.0))
        self.run(0.3, ref=START, pcmd=HOVER)
        assert self.vehicle.phase is FlightPhase.HOVERING

    def majors(self):
        """Major states in the packets of the last run, repetitions removed."""
        result = []
        for _, _, options, _ in self.packets:
            major = struct.unpack_from("<I", options[0])[0] >> 16
            if not result or result[-1] != major:
                result.append(major)
        return result

    @property
    def state(self):
        return self.host._state_bits(self.vehicle.phase)

    def close(self):
        self.client.udp.close()
        self.host.close()


HOVER = (0, 0.0, 0.0, 0.0, 0.0)


def make_world(n=1, yaw_rad=0.0):
    names = ["fluffy_II", "albatross", "Raven"][:n]
    fleet = Fleet(
        "test",
        MocapEndpoint("127.0.0.1"),
        tuple(
            FleetVehicle(
                "risc%d" % (i + 1), name, "ardrone", ADDRESS, Start((0.0, 0.8 * i, 0.0), math.degrees(yaw_rad))
            )
            for i, name in enumerate(names)
        ),
        own_networks=True,  # all vehicles share ADDRESS
    )
    templates = {name: Template(name, "vehicle", ("a", "b", "c", "d"), MARKERS) for name in names}
    return World(fleet, {"ardrone": VEHICLE_TYPE}, templates, perturbed=False)


@pytest.fixture
def lab():
    world = make_world()
    lab = Lab(world.vehicles["risc1"], world)
    yield lab
    lab.close()


class FakeVehicle:
    """Records what it is told; the test sets its state and phase."""

    def __init__(self, phase=FlightPhase.FLYING, delay_s=0.1, **state):
        self.namespace, self.name = "risc9", "fluffy_II"
        self.plant = types.SimpleNamespace(command_delay_s=delay_s)
        self.type = types.SimpleNamespace(command_rate_hz=30.0)
        self.firmware = types.SimpleNamespace(flow=Flow())
        self.phase = phase
        values = {
            "position_m": np.array([0.0, 0.0, 1.0]),
            "velocity_m_s": np.zeros(3),
            "phi": 0.0,
            "theta": 0.0,
            "psi": 0.0,
            "p": 0.0,
            "q": 0.0,
            "r": 0.0,
            "motor_pwm": (10, 20, 30, 40),
            "battery_pct": 80.0,
            "specific_force_m_s2": np.array([0.0, 0.0, -GRAVITY_M_S2]),
        }
        values.update(state)
        self.state = VehicleState(**values)
        self.told = []

    @property
    def height_m(self):
        return self.state.position_m.item(2)

    @property
    def battery_pct(self):
        return self.state.battery_pct

    def schedule(self, time_s, action):
        self.told.append((time_s, action))

    def setpoints(self):
        return [action for _, action in self.told if isinstance(action, Setpoint)]

    def change(self, **state):
        self.state = dataclasses.replace(self.state, **state)


@pytest.fixture
def fake_lab():
    labs = []

    def make(vehicle=None, **options):
        options.setdefault("sensor_noise", 0.0)
        labs.append(Lab(vehicle or FakeVehicle(), **options))
        return labs[-1]

    yield make
    for lab in labs:
        lab.close()


# ------------------------------------------------------------------ start-up


def test_switched_off_and_on_it_knows_nobody_and_is_out_of_its_emergency(lab):
    lab.fly()
    lab.vehicle.schedule(lab.now_s, FlightAction.CUT_MOTORS)
    lab.run(2.0, ref=START, pcmd=HOVER)
    assert lab.state & EMERGENCY and not lab.vehicle.firmware.lifted
    lab.vehicle.put_back()
    lab.host.power_cycle(lab.now_s)
    lab.run(1.0, ref=START, pcmd=HOVER)
    assert lab.vehicle.phase is FlightPhase.LANDED, "bit 9 has been set all the time"
    assert lab.state & BOOTSTRAP and not lab.state & EMERGENCY and not lab.packets, "no client has asked for navdata"
    lab.client.sequence = 0
    lab.fly()


def test_fresh_aircraft_sends_exactly_the_published_bootstrap_packet(lab):
    lab.run(0.5)
    lab.client.wake_up()
    state, sequence, options, data = lab.run(0.005)[0]
    assert data == bytes.fromhex("88776655100c804f0100000000000000ffff0800a6020000")
    assert [p[1] for p in lab.run(1.0)] == list(range(2, 17))  # 15 Hz, one by one
    assert all(p[0] == 0x4F800C10 and not p[2] for p in lab.packets)


@pytest.mark.parametrize(
    "wake_up, answered",
    [
        (b"\x01", True),
        (b"\x01\0\0\0", True),
        (b"\x02\0\0\0", True),
        (b"\x01" * 14, True),
        (b"", False),
        (b"\0", False),
        (b"\x03\0\0\0", False),
        (b"\x01" * 15, False),
    ],
)
def test_wake_up_datagrams(lab, wake_up, answered):
    lab.client.wake_up(wake_up)
    assert bool(lab.run(0.05)) is answered
    assert lab.host.statistics()["not_wake_ups"] == (not answered)


def test_configuration_handshake(lab):
    lab.client.wake_up()
    lab.run(0.1)
    lab.client.config("general:navdata_demo", "FALSE")
    packets = lab.run(0.1)
    assert packets[-1][0] & ACK and not packets[-1][0] & (BOOTSTRAP | DEMO)
    assert sorted(packets[-1][2]) == list(range(28)) and len(packets[-1][3]) == 2120
    assert lab.run(0.2, ref=IDLE)[-1][0] & ACK  # stays set until it is cleared
    lab.client.at("CTRL,5,0")
    packets = lab.run(0.2, ref=IDLE)
    assert not packets[-1][0] & ACK
    sequences = [p[1] for p in packets]
    assert sequences == list(range(sequences[0], sequences[0] + len(packets)))
    lab.client.at("COMWDG")
    assert lab.run(0.1, ref=IDLE)[-1][0] == 0x4F800090 & ~COM_WATCHDOG


def test_rates_of_full_and_demo_mode(lab):
    lab.connect()
    assert 199 <= len(lab.run(1.0, ref=IDLE)) <= 201
    lab.client.config("general:navdata_demo", "TRUE")
    packets = lab.run(2.0, ref=IDLE)[1:]
    assert 30 <= len(packets) <= 32
    assert all(p[0] & DEMO and sorted(p[2]) == [0, 16] for p in packets)


def test_navdata_options_add_to_demo_mode(lab):
    lab.connect(demo=True)
    lab.client.config("general:navdata_options", str(1 << 0 | 1 << 22 | 1 << 9))
    lab.run(0.2, ref=IDLE)
    assert sorted(lab.packets[-1][2]) == [0, 9, 16, 22]


def test_the_last_wake_up_gets_the_navdata(lab):
    lab.connect()
    second = Client(lab.host)
    second.wake_up()
    assert len(lab.run(0.1, ref=IDLE)) <= 1
    assert len(second.packets()) >= 19
    second.udp.close()


# ------------------------------------------------------------------ sequence numbers and malformed input


def test_sequence_rules(fake_lab):
    lab = fake_lab()

    def obeyed(sequence, gaz):
        before = len(lab.vehicle.told)
        lab.client.raw(b"AT*PCMD=%d,1,0,0,%d,0\r" % (sequence, bits(gaz)))
        lab.run(0.2)
        return len(lab.vehicle.told) > before

    assert obeyed(100, 0.1)
    assert not obeyed(100, 0.2)
    assert not obeyed(99, 0.2)
    assert obeyed(101, 0.3)
    assert obeyed(1, 0.4)
    assert obeyed(2, 0.5)
    assert obeyed(0, 0.6)
    assert lab.host.statistics()["at_stale"] == 2


def test_stale_commands_do_not_feed_the_watchdog(fake_lab):
    """A client that restarts with a low number above 1 is obeyed only after the link counts as lost."""
    lab = fake_lab()
    lab.client.sequence = 5000
    lab.run(0.1, pcmd=(1, 0.0, 0.0, 0.1, 0.0))
    lab.client.sequence = 10
    lab.run(1.5, pcmd=(1, 0.0, 0.0, 0.2, 0.0))
    assert not any(s.climb_m_s > 0.1 for s in lab.vehicle.setpoints())
    lab.run(1.0, pcmd=(1, 0.0, 0.0, 0.2, 0.0))
    assert lab.vehicle.setpoints()[-1].climb_m_s == pytest.approx(0.14)


def test_malformed_datagrams_are_counted_and_the_rest_is_obeyed(lab):
    lab.connect()
    lab.client.sequence += 10
    for junk in (b"", b"\xff" * 100, b"AT*REF=\r", b"AT*PCMD=9999,1,2143289344,0,0,0\r", b"AT*" * 500):
        lab.client.raw(junk)
    lab.client.raw(b"AT*NEW=2000,5\rAT*VICON=2001,1\nrubbish\r\nAT*REF=2002,%d\r\n" % START)
    lab.client.sequence = 2002
    lab.run(1.0, ref=START)
    statistics = lab.host.statistics()
    assert statistics["at_malformed"] == 5
    assert statistics["at_unknown"] == 1
    assert lab.vehicle.phase is FlightPhase.TAKING_OFF


def test_what_clients_do_is_said_once_and_then_counted(lab, caplog):
    caplog.set_level(logging.INFO)
    lab.connect()
    lab.run(0.5, ref=IDLE)
    sender = "127.0.0.1:%d" % lab.client.udp.getsockname()[1]
    stranger = Client(lab.host)
    reader = socket.create_connection((ADDRESS, lab.host.ports.control))
    for _ in range(3):
        stranger.raw(b"rubbish")
        stranger.wake_up(b"hello")
    lab.run(0.1, ref=IDLE)
    notices = lab.host.statistics()["notices"]
    assert notices["events"]["gets the navdata"] == {sender: 1}
    assert notices["events"]["sends commands"][sender] > 10
    assert list(notices["events"]["reads the configuration"]) == ["127.0.0.1:%d" % reader.getsockname()[1]]
    from_stranger = {"127.0.0.1:%d" % stranger.udp.getsockname()[1]: 3}
    assert notices["complaints"] == {
        "sends malformed commands": from_stranger,
        "asks for navdata wrongly": from_stranger,
    }
    said = [(record.levelname, record.getMessage().count(sender)) for record in caplog.records]
    assert said.count(("INFO", 1)) == 2 and len(said) == 5, caplog.text
    assert sum(record.levelname == "WARNING" for record in caplog.records) == 2
    assert all("risc1" in record.getMessage() for record in caplog.records)
    reader.close()
    stranger.udp.close()


def test_a_flood_of_senders_is_counted_and_not_told_one_by_one(lab, caplog):
    for _ in range(200):
        stranger = Client(lab.host)
        stranger.raw(b"rubbish")
        lab.serve()
        stranger.udp.close()
    complaints = lab.host.statistics()["notices"]["complaints"]["sends malformed commands"]
    assert sum(complaints.values()) == 200 and complaints["others"] >= 140
    assert len(caplog.records) <= 60


def test_out_of_range_sticks_are_clipped(fake_lab):
    lab = fake_lab()
    lab.run(0.3, pcmd=(1, 3.0, -7.0, 0.0, 1e30))
    setpoint = lab.vehicle.setpoints()[-1]
    assert setpoint.roll_rad == pytest.approx(0.20944) and setpoint.pitch_rad == pytest.approx(-0.20944)
    assert setpoint.yaw_rate_rad_s == pytest.approx(1.745329)


@given(
    st.lists(
        st.one_of(
            st.tuples(st.sampled_from(["at", "navdata"]), st.binary(max_size=100)),
            st.tuples(
                st.just("at"),
                st.tuples(
                    st.sampled_from(
                        ["REF", "PCMD", "PCMD_MAG", "CONFIG", "CONFIG_IDS", "CTRL", "LED", "ANIM", "COMWDG", "FTRIM"]
                    ),
                    st.integers(0, 1000),
                    st.lists(
                        st.one_of(
                            st.integers(-(2**32), 2**33),
                            st.sampled_from(
                                [
                                    '"general:navdata_options"',
                                    '"general:com_watchdog"',
                                    '"detect:detect_type"',
                                    '"video:bitrate"',
                                    '"general:navdata_demo"',
                                    '"control:euler_angle_max"',
                                    '"custom:profile_id"',
                                    '"-1"',
                                    '"1e300"',
                                    '"99999999999999999999"',
                                    '"TRUE"',
                                    '"-all"',
                                    '"abcdef01"',
                                ]
                            ),
                        ),
                        max_size=6,
                    ),
                ).map(lambda c: ("AT*%s=%d,%s\r" % (c[0], c[1], ",".join(map(str, c[2])))).encode()),
            ),
        ),
        max_size=12,
    )
)
def test_nothing_that_arrives_raises(datagrams):
    vehicle = FakeVehicle()
    lab = Lab(vehicle)
    try:
        lab.client.wake_up()
        for port, data in datagrams:
            lab.client.udp.sendto(data, (lab.host.address, getattr(lab.host.ports, port)))
        for phase in FlightPhase:
            vehicle.phase = phase
            lab.run(0.25)
        lab.client.raw(b'AT*CONFIG=1,"general:navdata_demo","FALSE"\r')
        assert lab.run(0.1) or not lab.client.wake_up()
        for action in (a for _, a in vehicle.told if isinstance(a, Setpoint)):
            assert abs(action.roll_rad) < 1.0 and abs(action.climb_m_s) <= 2.5
    finally:
        lab.close()


# ------------------------------------------------------------------ watchdogs


def test_com_watchdog_bit_after_50_ms_until_comwdg(lab):
    lab.connect()
    lab.run(0.5, ref=IDLE)
    assert not any(p[0] & COM_WATCHDOG for p in lab.packets)
    lab.run(0.04)
    assert not lab.state & COM_WATCHDOG
    lab.run(0.02)
    assert lab.packets[-1][0] & COM_WATCHDOG
    lab.run(0.2, ref=IDLE)
    assert lab.packets[-1][0] & COM_WATCHDOG  # commands alone do not clear it
    lab.client.at("COMWDG")
    lab.run(0.03, ref=IDLE)
    assert not lab.packets[-1][0] & COM_WATCHDOG


def test_lost_link_stops_navdata_hovers_and_lands(lab):
    lab.fly()
    lab.run(1.0, ref=START, pcmd=(1, 0.0, -0.2, 0.0, 0.0))
    assert lab.vehicle.phase is FlightPhase.FLYING
    assert lab.vehicle.state.velocity_m_s[0] > 0.1
    last_sequence = lab.packets[-1][1]
    lab.run(1.9)
    assert lab.packets[-1][1] > last_sequence and not lab.packets[-1][0] & COM_LOST
    lab.run(0.3)
    assert lab.vehicle.phase is FlightPhase.HOVERING
    assert lab.run(1.0) == []  # navdata has stopped
    lab.client.wake_up()
    state, sequence, options, _ = lab.run(0.1)[0]
    assert state & COM_LOST and state & BOOTSTRAP and sequence == 1 and not options
    lab.run(1.5)
    assert lab.vehicle.phase is FlightPhase.LANDING
    lab.run(4.0)
    assert lab.vehicle.phase is FlightPhase.LANDED

    # the client returns with low numbers and START still set: START must be cleared and set again
    lab.client.sequence = 3
    lab.run(1.0, ref=START)
    assert not lab.state & COM_LOST and lab.state & 1 << 5  # heard, bit 9 included
    assert lab.vehicle.phase is FlightPhase.LANDED
    lab.run(0.3, ref=IDLE)
    lab.run(0.5, ref=START)
    assert lab.vehicle.phase is FlightPhase.TAKING_OFF
    assert lab.host.statistics()["com_losses"] == 1


def test_after_a_loss_navdata_starts_again_at_one_for_a_client_that_kept_waking_it(lab):
    lab.connect()
    packets = []
    for _ in range(6):
        lab.client.wake_up()
        packets += lab.run(0.5)
    sequences = [p[1] for p in packets]
    restart = sequences.index(1)
    assert sequences[:restart] == sorted(sequences[:restart]) and restart > 300
    assert sequences[restart:] == list(range(1, len(sequences) - restart + 1))
    assert all(p[0] & BOOTSTRAP and p[0] & COM_LOST for p in packets[restart:])


def test_a_crash_is_an_emergency_without_the_users_bit(lab):
    lab.fly()
    lab.run(8.0, ref=START, pcmd=(1, 0.0, -1.0, 0.0, 0.0))
    assert lab.vehicle.phase is FlightPhase.EMERGENCY
    assert lab.state & EMERGENCY and lab.state & 1 << 22 and not lab.state & 1 << 16
    lab.run(0.3, ref=START | SELECT)
    assert lab.vehicle.phase is FlightPhase.LANDED
    lab.run(1.0, ref=START)
    assert lab.vehicle.phase is FlightPhase.LANDED


def test_a_client_that_returns_while_it_hovers_keeps_flying(lab):
    lab.fly()
    lab.run(2.5)
    assert lab.state & COM_LOST
    lab.run(3.0, ref=START, pcmd=HOVER)
    assert lab.vehicle.phase is FlightPhase.HOVERING and not lab.state & COM_LOST


# ------------------------------------------------------------------ flight


def test_take_off_fly_hover_land(lab):
    lab.connect()
    lab.run(6.0, ref=START, pcmd=HOVER)
    assert lab.majors() == [LANDED, TAKING_OFF, HOVERING]
    assert lab.packets[-1][0] & 1 and lab.packets[-1][0] & 1 << 5
    assert 800 < struct.unpack_from("<i", lab.packets[-1][2][0], 20)[0] < 1000
    lab.run(1.0, ref=START, pcmd=(1, 0.0, 0.0, 0.0, 0.0))
    lab.run(1.0, ref=START, pcmd=HOVER)
    lab.run(5.0, ref=IDLE, pcmd=HOVER)
    assert lab.majors() == [HOVERING, LANDING, LANDED]
    assert not lab.packets[-1][0] & 1
    statistics = lab.host.statistics()
    assert (statistics["take_offs"], statistics["landings"], statistics["emergencies"]) == (1, 1, 0)


def test_hover_flag_and_flying_state(lab):
    lab.fly()
    lab.run(0.5, ref=START, pcmd=(1, 0.0, 0.0, 0.0, 0.0))
    assert lab.majors() == [HOVERING, FLYING]
    lab.run(0.5, ref=START, pcmd=(0, 1.0, 1.0, 1.0, 1.0))  # hover ignores the sticks
    assert lab.majors() == [FLYING, HOVERING]


def test_take_off_without_the_padding_bits(lab):
    lab.connect()
    lab.run(1.0, ref=512)
    assert lab.vehicle.phase is FlightPhase.TAKING_OFF


@pytest.mark.parametrize(
    "pcmd, axis, sign",
    [
        ((1, 0.0, -0.3, 0.0, 0.0), 0, 1),
        ((1, 0.0, 0.3, 0.0, 0.0), 0, -1),  # nose down: forward, x
        ((1, 0.3, 0.0, 0.0, 0.0), 1, -1),
        ((1, -0.3, 0.0, 0.0, 0.0), 1, 1),  # lean right: -y (y is left)
        ((1, 0.0, 0.0, 0.3, 0.0), 2, 1),
        ((1, 0.0, 0.0, -0.3, 0.0), 2, -1),
    ],
)
def test_signs_of_flight(lab, pcmd, axis, sign):
    lab.fly()
    lab.run(1.0, ref=START, pcmd=pcmd)
    velocity = lab.vehicle.state.velocity_m_s * sign
    assert velocity[axis] > 0.1
    assert all(abs(v) < 0.08 for i, v in enumerate(velocity) if i != axis)


def test_positive_yaw_turns_clockwise(lab):
    lab.fly()
    lab.run(1.0, ref=START, pcmd=(1, 0.0, 0.0, 0.0, 0.5))
    assert 0.3 < lab.vehicle.state.psi < 1.0
    psi_mdeg = struct.unpack_from("<f", lab.packets[-1][2][0], 16)[0]
    assert math.radians(1e-3 * psi_mdeg) == pytest.approx(lab.vehicle.state.psi, abs=0.02)


def test_full_sticks_follow_the_configured_limits(fake_lab):
    lab = fake_lab()
    full = (1, 1.0, 1.0, 1.0, 1.0)

    def limits():
        lab.run(0.3, pcmd=full)
        s = lab.vehicle.setpoints()[-1]
        return [pytest.approx(v, rel=1e-5) for v in (s.roll_rad, s.pitch_rad, s.climb_m_s, s.yaw_rate_rad_s)]

    assert limits() == [0.209440, 0.209440, 0.7, 1.745329]
    lab.client.config("control:outdoor", "TRUE")
    assert limits() == [0.349066, 0.349066, 1.0, 3.490659]
    lab.client.config("control:euler_angle_max", "0.1")
    lab.client.config("control:control_vz_max", "500")
    lab.client.config("control:control_yaw", "0.349066")
    assert limits() == [0.1, 0.1, 0.5, 0.349066]
    lab.client.config("control:outdoor", "FALSE")
    assert limits() == [0.209440, 0.209440, 0.7, 1.745329]
    lab.client.config("control:outdoor", "TRUE")
    assert limits() == [0.1, 0.1, 0.5, 0.349066]  # the outdoor values were kept


def test_absolute_control_is_in_the_pilots_frame(fake_lab):
    lab = fake_lab(FakeVehicle(psi=math.pi / 2))  # aircraft looks east, pilot north (psi 0)
    lab.run(0.05)
    lab.client.at("PCMD_MAG,5,0,%d,0,0,0,0" % bits(-1.0))  # the pilot's forward is the aircraft's left
    lab.run(0.3)
    setpoint = lab.vehicle.setpoints()[-1]
    assert (setpoint.roll_rad, setpoint.pitch_rad) == (pytest.approx(-0.20944, rel=1e-5), pytest.approx(0.0, abs=1e-9))
    lab.client.at("PCMD_MAG,5,0,%d,0,0,%d,0" % (bits(-1.0), bits(0.5)))  # the pilot looks east as well
    lab.run(0.3)
    setpoint = lab.vehicle.setpoints()[-1]
    assert (setpoint.roll_rad, setpoint.pitch_rad) == (pytest.approx(0.0, abs=1e-9), pytest.approx(-0.20944, rel=1e-5))


@pytest.mark.parametrize("limit_mm", [1200, 2000])
def test_altitude_limit(lab, limit_mm):
    lab.client.config("control:altitude_max", str(limit_mm))
    lab.fly()
    heights = []
    for _ in range(80):
        lab.run(0.1, ref=START, pcmd=(1, 0.0, 0.0, 1.0, 0.0))
        heights.append(lab.vehicle.state.position_m[2] - 0.08)
    assert max(heights) < 1e-3 * limit_mm + 0.03
    assert heights[-1] > 1e-3 * limit_mm - 0.03
    lab.run(1.0, ref=START, pcmd=(1, 0.0, 0.0, -0.5, 0.0))
    assert lab.vehicle.state.position_m[2] - 0.08 < heights[-1] - 0.15


def test_altitude_minimum_keeps_it_off_the_floor(lab):
    lab.fly()
    lab.run(8.0, ref=START, pcmd=(1, 0.0, 0.0, -1.0, 0.0))
    assert lab.vehicle.phase is FlightPhase.FLYING
    assert 0.02 < lab.vehicle.state.position_m[2] - 0.08 < 0.12


# ------------------------------------------------------------------ emergency, battery


def test_emergency_is_edge_triggered_and_needs_a_new_start(lab):
    lab.fly()
    lab.run(0.3, ref=START | SELECT, pcmd=HOVER)
    assert lab.vehicle.phase is FlightPhase.EMERGENCY and lab.state & EMERGENCY
    assert lab.state & 1 << 16 and not lab.state & 1 << 22  # by the user, not by the cut-out
    lab.run(2.0, ref=START | SELECT)  # held: it does not flap
    assert lab.majors() == [0, LANDED]  # falling, then on the ground
    assert all(p[0] & EMERGENCY for p in lab.packets)
    lab.run(0.3, ref=IDLE | SELECT)
    assert lab.vehicle.phase is FlightPhase.EMERGENCY  # bit 8 has not moved
    lab.run(0.3, ref=IDLE)
    lab.run(0.3, ref=START)
    assert lab.vehicle.phase is FlightPhase.EMERGENCY  # take-off is refused
    lab.run(0.3, ref=SELECT | START)  # second edge clears
    assert lab.vehicle.phase is FlightPhase.LANDED and not lab.state & EMERGENCY
    lab.run(1.0, ref=START)
    assert lab.vehicle.phase is FlightPhase.LANDED  # start must go 0, then 1
    lab.run(0.2, ref=IDLE)
    lab.run(0.5, ref=START)
    assert lab.vehicle.phase is FlightPhase.TAKING_OFF
    assert lab.host.statistics()["emergencies"] == 1


def test_emergency_on_the_ground_and_back(lab):
    lab.connect()
    for expected in (EMERGENCY, 0):
        lab.run(0.3, ref=SELECT)
        lab.run(0.3, ref=IDLE)
        assert lab.state & EMERGENCY == expected


def test_a_short_select_between_two_radio_slots_is_not_lost(lab):
    lab.connect()
    lab.client.at("REF,%d" % SELECT, "REF,%d" % IDLE)
    lab.run(0.3)
    assert lab.state & EMERGENCY


def test_low_battery_refuses_take_off(lab):
    lab.connect()
    lab.vehicle.set_battery_pct(10.0)
    lab.run(1.0, ref=START)
    assert lab.packets[-1][0] & BATTERY_LOW
    assert lab.vehicle.phase is FlightPhase.LANDED
    assert struct.unpack_from("<I", lab.packets[-1][2][0], 4)[0] in (9, 10)
    assert lab.host.statistics()["take_offs_refused"] == 1
    lab.vehicle.set_battery_pct(90.0)
    lab.run(0.5, ref=START)
    assert lab.vehicle.phase is FlightPhase.TAKING_OFF


def test_an_empty_battery_lands_and_does_not_take_off_again(lab):
    lab.fly()
    lab.vehicle.set_battery_pct(2.0)
    lab.run(6.0, ref=START, pcmd=HOVER)
    assert lab.vehicle.phase is FlightPhase.LANDED
    lab.vehicle.set_battery_pct(90.0)
    lab.run(1.0, ref=START, pcmd=HOVER)
    assert lab.vehicle.phase is FlightPhase.LANDED


# ------------------------------------------------------------------ radio


def test_the_time_of_other_sticks_is_noted_when_they_come(fake_lab):
    lab = fake_lab()
    for sequence, gaz, is_other in ((100, 0.1, True), (101, 0.1, False), (102, 0.2, True), (101, 0.3, False)):
        began_s = lab.now_s
        lab.client.raw(b"AT*PCMD=%d,1,0,0,%d,0\r" % (sequence, bits(gaz)))
        lab.run(0.1)
        assert (began_s < lab.host.inputs_s < began_s + 0.05) is is_other, sequence


def test_commands_take_effect_on_the_30_hz_grid_one_delay_later(fake_lab):
    lab = fake_lab(FakeVehicle(delay_s=0.12))
    sent = {}
    for k in range(400):
        gaz = 0.001 * k
        if (lab.steps + 1) % 5 == 0:
            sent[float(np.float32(gaz))] = lab.now_s + STEP_S
        lab.run(STEP_S, pcmd=(1, 0.0, 0.0, gaz, 0.0))
    told = [(t, s) for t, s in lab.vehicle.told]
    times = np.array([t for t, _ in told])
    np.testing.assert_allclose(np.diff(times), 1.0 / 30.0, atol=1e-9)
    assert 52 <= len(told) <= 60
    ages = np.array(
        [
            t - sent_at
            for t, s in told
            for gaz, sent_at in sent.items()
            if s.climb_m_s == pytest.approx(0.7 * gaz, abs=1e-9)
        ]
    )
    assert len(ages) >= 52
    assert ages.min() >= 0.12 and ages.max() <= 0.12 + 1.0 / 30.0


def test_effective_time_in_the_world(lab):
    """From the first PCMD to the first change of attitude: slot wait + delay, on the grid of the world."""
    lab.fly()
    lab.run(0.5, ref=START, pcmd=(1, 0.0, 0.0, 0.0, 0.0))
    sent_s = lab.now_s
    theta = lab.vehicle.state.theta
    while abs(lab.vehicle.state.theta - theta) < 1e-4:
        lab.run(STEP_S, ref=START, pcmd=(1, 0.0, -1.0, 0.0, 0.0), every=1)
        assert lab.now_s < sent_s + 1.0
    delay_s = lab.now_s - sent_s
    assert 0.1 <= delay_s <= 0.1 + 1.0 / 30.0 + 0.025


def test_two_vehicles_have_different_radio_slots(fake_lab):
    first = fake_lab(FakeVehicle())
    other = FakeVehicle()
    other.namespace = "risc8"
    second = fake_lab(other, address=ADDRESS)
    for lab in (first, second):
        lab.run(0.5, pcmd=HOVER)
    assert first.vehicle.told[0][0] != pytest.approx(second.vehicle.told[0][0], abs=1e-6)


# ------------------------------------------------------------------ injected link loss


def test_link_loss_in_both_directions(lab):
    lab.fly()
    watcher = socket.create_connection((ADDRESS, lab.host.ports.control))
    lab.serve()
    lab.lose_link(1.0)
    watcher.sendall(b"x")
    lab.run(0.9, ref=START, pcmd=(1, 0.0, -1.0, 0.0, 0.0))
    assert lab.packets == []
    assert lab.vehicle.phase is FlightPhase.HOVERING  # nothing was heard
    counts = lab.host.wires.statistics()
    assert counts["risc1/commands"]["sent"] >= 35 and counts["risc1/navdata"]["sent"] >= 175
    assert counts["risc1/commands"]["delivered"] == counts["risc1/navdata"]["delivered"] == 0
    lab.run(0.5, ref=START, pcmd=(1, 0.0, -0.1, 0.0, 0.0))
    assert lab.packets and lab.packets[-1][0] & COM_WATCHDOG
    assert lab.vehicle.phase is FlightPhase.FLYING and not lab.state & COM_LOST
    watcher.close()


def test_the_radio_loses_navdata_too(fake_lab):
    """Each lost datagram (a fifth of them) leaves a gap in the sequence numbers; the seed decides which are lost."""
    numbers = []
    for seed in (7, 7, 8):
        lab = fake_lab(radio_loss=0.2, seed=seed)
        lab.connect()
        numbers.append([packet[1] for packet in lab.run(5.0, ref=START, pcmd=HOVER)])
        lost = numbers[-1][-1] - numbers[-1][0] + 1 - len(numbers[-1])
        assert 150 <= lost <= 250  # of 1000, four sigma
        assert lab.host.statistics()["datagrams_lost_out"] >= lost
        lab.close()
    assert numbers[0] == numbers[1] != numbers[2]


def test_faults_act_on_what_it_hears_and_says(lab):
    lab.connect()
    clean = len(lab.run(2.0, ref=IDLE))
    assert lab.host.statistics()["com_watchdogs"] == 0
    lab.host.wires.add(FaultEvent("drop", channel="risc1/navdata", severity=0.5, start_s=lab.now_s, duration_s=2.0))
    assert 0.4 * clean < len(lab.run(2.0, ref=IDLE)) < 0.6 * clean
    assert len(lab.run(2.0, ref=IDLE)) == pytest.approx(clean, abs=2), "the window is over"
    malformed = lab.host.statistics()["at_malformed"]
    lab.host.wires.add(FaultEvent("blackhole", channel="risc1/commands", start_s=lab.now_s, duration_s=0.5))
    lab.run(0.5, ref=IDLE)
    assert lab.state & COM_WATCHDOG and lab.host.statistics()["com_watchdogs"] == 1
    lab.host.wires.add(FaultEvent("corrupt", channel="risc1/commands", severity=1.0, start_s=lab.now_s, duration_s=2.0))
    lab.run(2.0, ref=IDLE)
    assert lab.host.statistics()["at_malformed"] > malformed


def test_delayed_commands_are_obeyed_later(lab):
    lab.connect()
    delays_s = []
    for delay_s in (0.0, 0.3):
        if delay_s:
            lab.host.wires.add(FaultEvent("delay", channel="risc1/commands", severity=delay_s, start_s=lab.now_s))
        sent_s, taken_off = lab.now_s, lab.host.statistics()["take_offs"]
        lab.client.at("REF,%d" % START)
        while lab.host.statistics()["take_offs"] == taken_off:
            lab.run(STEP_S)
            assert lab.now_s < sent_s + 2.0
        delays_s.append(lab.now_s - sent_s)
        lab.client.at("REF,%d" % IDLE)
        lab.run(10.0)
        lab.connect()
        assert lab.vehicle.phase is FlightPhase.LANDED
    assert delays_s[1] - delays_s[0] == pytest.approx(0.3, abs=1.0 / 30.0 + STEP_S)  # a slot of the radio


def stick(k):
    """A PCMD command, as bytes, that can be told by its number k."""
    return b"AT*PCMD=%d,1,%d,0,0,0\r" % (k, bits(k / 1000.0))


@pytest.mark.parametrize("loss_s", [0.3, 0.05])  # the delay ends within the loss, or after it
def test_what_was_sent_before_a_link_loss_arrives_once(fake_lab, loss_s):
    """In both directions, with a delay that ends during the loss or after it."""
    lab = fake_lab()
    lab.connect()
    lab.run(0.5, ref=IDLE)
    host = lab.host
    for channel in ("risc9/commands", "risc9/navdata"):
        host.wires.add(FaultEvent("delay", channel=channel, severity=0.2, start_s=lab.now_s))
    heard, (wire, deliver) = [], host._heard[host._sockets["at"]]
    take = lambda data, sender, now_s: (heard.append(data), deliver(data, sender, now_s))  # noqa: E731
    host.hear(host._sockets["at"], wire, take)
    lab.run(0.1)  # navdata on its way
    lab.client.raw(stick(901))
    lab.run(0.05)
    before = host.wires.statistics()
    lab.lose_link(loss_s)
    sent = host._sequence
    lab.client.raw(stick(902))  # lost
    packets = lab.run(loss_s)
    lab.client.raw(stick(903))
    packets += lab.run(0.5)
    assert heard == [stick(901), stick(903)]
    numbers = [packet[1] for packet in packets]
    assert len(numbers) == len(set(numbers)) and numbers == sorted(numbers)
    assert sent in numbers and sent + 1 not in numbers
    on_the_way = [number for number in numbers if number <= sent]
    assert on_the_way == list(range(on_the_way[0], sent + 1)), "all of it"
    navdata, commands = (
        counts["sent"] - counts["delivered"] - before[channel]["sent"] + before[channel]["delivered"]
        for channel, counts in host.wires.statistics().items()
        if channel in ("risc9/commands", "risc9/navdata")
    )
    assert commands == 1 and navdata == pytest.approx(loss_s * 200.0, abs=2)
    assert max(numbers) - len(on_the_way) - navdata > 0


def test_long_link_loss_lands(lab):
    lab.fly()
    lab.lose_link(20.0)
    lab.run(10.0, ref=START, pcmd=HOVER)
    assert lab.vehicle.phase is FlightPhase.LANDED
    assert lab.host.statistics()["com_losses"] == 1


# ------------------------------------------------------------------ configuration on TCP 5559, video on 5555


def read_all(lab, connection, seconds=0.1):
    lab.run(seconds, ref=IDLE)
    connection.settimeout(15.0)
    data = b""
    while not data.endswith(b"\0"):
        data += connection.recv(65536)
    return data


def test_configuration_readback(lab):
    lab.connect()
    lab.client.at("CTRL,4,0")
    lab.run(0.1, ref=IDLE)
    assert not lab.state & ACK  # no TCP client is connected: ask again
    connection = socket.create_connection((ADDRESS, lab.host.ports.control))
    lab.serve()
    lab.client.config("control:altitude_max", "2500")
    lab.client.at("CTRL,5,0", "CTRL,4,0")
    data = read_all(lab, connection)
    assert lab.state & ACK
    assert data.count(b"\0") == 1
    lines = data[:-1].decode().split("\n")
    values = dict(line.split(" = ", 1) for line in lines if line)
    assert values["general:num_version_soft"] == "2.4.8"
    assert values["general:num_version_config"] == "1"
    assert values["control:altitude_max"] == "2500"
    assert values["control:euler_angle_max"] == "0.209440"
    assert values["general:navdata_demo"] == "FALSE"
    assert len(values) > 80
    lab.client.at("CTRL,5,0")
    lab.run(0.1, ref=IDLE)
    assert not lab.state & ACK
    connection.close()
    lab.run(0.05)
    assert connection.fileno() == -1 and len(lab.host.sockets()) == 4


def test_faults_act_on_the_configurations_stream(lab):
    """The text is delayed, held up or cut; the host goes on serving other clients."""
    lab.connect()
    connection = socket.create_connection((ADDRESS, lab.host.ports.control))
    lab.serve()

    def text_comes_after(seconds):
        asked_s = lab.now_s
        lab.client.at("CTRL,5,0", "CTRL,4,0")
        while not select.select([connection], [], [], 0.0)[0]:
            lab.run(STEP_S, ref=IDLE)
            assert lab.now_s < asked_s + 5.0
        assert lab.now_s - asked_s == pytest.approx(seconds, abs=0.02)
        assert read_all(lab, connection).count(b"\0") == 1

    text_comes_after(0.0)
    lab.host.wires.add(FaultEvent("delay", channel="risc1/control", severity=0.4, start_s=lab.now_s, duration_s=1.0))
    text_comes_after(0.4)
    lab.run(1.0, ref=IDLE)
    lab.host.wires.add(
        FaultEvent("blackhole", channel="risc1/control", severity=1.0, start_s=lab.now_s, duration_s=0.7)
    )
    text_comes_after(0.7)
    lab.host.wires.add(FaultEvent("cut", channel="risc1/control", severity=1.0, start_s=lab.now_s))
    other = socket.create_connection((ADDRESS, lab.host.ports.control))
    lab.serve()
    lab.client.at("CTRL,5,0", "CTRL,4,0")
    lab.run(0.1, ref=IDLE)
    for sock in (connection, other):
        with pytest.raises(ConnectionResetError):
            sock.recv(1)
        sock.close()
    assert lab.host.wires.statistics()["risc1/control"]["cut"] == 2
    assert lab.packets and lab.state & ACK


def test_multi_configuration_on_the_wire(lab):
    lab.connect()
    connection = socket.create_connection((ADDRESS, lab.host.ports.control))
    lab.serve()
    ids = ("11223344", "cea48d22", "e182b69b")
    lab.client.config("custom:session_id", "-all")
    for key, value in zip(("session_id", "profile_id", "application_id"), ids):
        lab.client.config("custom:" + key, value, ids)
    lab.client.config("custom:profile_desc", ".ardrone_driver", ids)
    lab.client.config("control:euler_angle_max", "0.349066", ids)
    lab.client.config("control:euler_angle_max", "0.1", ("11223344", "00000001", "e182b69b"))  # not in force
    lab.run(0.1, ref=IDLE)
    assert lab.host.get("control:euler_angle_max") == 0.349066
    lab.client.at('CONFIG,"control:euler_angle_max","0.15"')  # without ids: the default profile
    lab.client.at("CTRL,6,0")
    text = read_all(lab, connection).decode()
    assert lab.host.get("control:euler_angle_max") == 0.349066
    sections = text[:-1].split("\r")
    assert (
        sections.index("[common]")
        < sections.index("[applis]")
        < sections.index("[profiles]")
        < sections.index("[sessions]")
    )
    assert "cea48d22,.ardrone_driver" in sections and any(s.startswith("11223344,") for s in sections)
    lab.client.config("custom:profile_id", "-cea48d22")
    lab.run(0.1, ref=IDLE)
    assert lab.host.get("custom:profile_id") == "00000000"
    assert lab.host.get("control:euler_angle_max") == 0.15
    connection.close()


def test_ids_count_only_for_the_config_right_behind(lab):
    lab.connect()
    ids = '"11223344","22334455","33445566"'
    lab.client.at("CONFIG_IDS," + ids, "COMWDG", 'CONFIG,"control:euler_angle_max","0.3"')
    lab.run(0.05)
    assert lab.host.get("control:euler_angle_max") == 0.3  # taken as a write without ids


def test_unknown_and_read_only_keys_are_acknowledged(lab):
    lab.connect()
    for key in ("no:such_key", "general:num_version_soft"):
        lab.client.at("CTRL,5,0")
        lab.client.config(key, "1")
        lab.run(0.05)
        assert lab.state & ACK
    assert lab.host.statistics()["config_ignored"] == 2
    assert lab.host.get("general:num_version_soft") == "2.4.8"


def test_too_many_readers_are_turned_away(lab):
    connections = []
    for _ in range(20):
        connections.append(socket.create_connection((ADDRESS, lab.host.ports.control)))
        lab.serve()
    assert lab.host.statistics()["tcp_clients_refused"] == 4
    for connection in connections:
        connection.close()


@pytest.mark.parametrize("makes_room", [True, False])
def test_who_takes_all_places_gives_one_up(lab, monkeypatch, makes_room):
    if not makes_room:  # the control arm
        monkeypatch.setattr("risc_simulator.socket_host.greediest", lambda *_: None)
    target = ADDRESS, lab.host.ports.control
    with contextlib.ExitStack() as stack:
        for _ in range(16):
            stack.enter_context(socket.create_connection(target, source_address=("127.0.0.8", 0)))
            lab.serve()
        other = stack.enter_context(socket.create_connection(target, source_address=("127.0.0.9", 0)))
        lab.serve()
        assert lab.host.statistics().get("tcp_clients_refused", 0) == (0 if makes_room else 1)
        other.settimeout(0.2)
        if makes_room:
            with pytest.raises(TimeoutError):  # open, and nothing to read
                other.recv(1)
        else:
            assert other.recv(1) == b""


def test_notes_of_what_is_not_performed(lab):
    lab.connect()
    lab.client.at("LED,3,%d,2" % bits(1.5), "ANIM,16,15", "CALIB,0", "PMODE,2", "MISC,2,20,2000,3000")
    lab.client.config("control:flight_anim", "3,20")
    lab.client.config("leds:leds_anim", "3,1073741824,2")
    lab.run(0.05)
    notes = lab.host.notes
    assert notes["LED"] == (3, 1.5, 2) and notes["ANIM"] == (16, 15) and notes["CALIB"] == (0,)
    assert notes["control:flight_anim"] == "3,20" and notes["leds:leds_anim"] == "3,1073741824,2"
    assert lab.state & ACK


# ------------------------------------------------------------------ what the sensors say


def options_of(lab):
    lab.connect()
    return Navdata(lab.run(0.1, ref=IDLE)[-1][3])


def test_exact_readings_in_aircraft_axes(fake_lab):
    """Looking east (psi 90 deg), moving 0.3 m/s north (cortex x), 0.2 m/s west (cortex y), 0.1 m/s up."""
    lab = fake_lab(
        FakeVehicle(
            velocity_m_s=np.array([0.3, 0.2, 0.1]),
            psi=math.pi / 2,
            phi=math.radians(2.0),
            theta=math.radians(-3.0),
            p=math.radians(10.0),
            q=math.radians(-20.0),
            r=math.radians(30.0),
            position_m=np.array([0.5, 0.6, 1.25]),
            specific_force_m_s2=GRAVITY_M_S2 * np.array([0.1, -0.2, -0.9]),
        )
    )
    packet = options_of(lab)
    demo = packet.option(0)
    assert demo.ctrl_state >> 16 == FLYING and demo.vbat_flying_percentage == 80
    assert (demo.theta, demo.phi, demo.psi) == (
        pytest.approx(-3000, abs=0.1),
        pytest.approx(2000, abs=0.1),
        pytest.approx(90000, abs=0.1),
    )
    assert demo.altitude in (1249, 1250)
    # forward is east = -west, right is south = -north
    assert (demo.vx, demo.vy, demo.vz) == (
        pytest.approx(-200, abs=0.1),
        pytest.approx(-300, abs=0.1),
        pytest.approx(-100, abs=0.1),
    )
    physical = packet.option(3)
    assert physical.phys_accs == pytest.approx((100, -200, -900), abs=0.01)
    assert physical.phys_gyros == pytest.approx((10, -20, 30), abs=0.001)
    assert packet.option(9)[:4] == (10, 20, 30, 40)
    altitude = packet.option(10)
    assert altitude.altitude_raw in (1249, 1250) and altitude.altitude_vz == pytest.approx(100, abs=0.1)
    magneto = packet.option(22)
    assert magneto.heading_unwrapped == pytest.approx(90.0, abs=0.01)
    assert magneto.heading_fusion_unwrapped == pytest.approx(90.0, abs=0.01), "degrees, as in a real capture"
    assert packet.option(21).Pression_meas == pytest.approx(85800 - 10.4 * 1.25, abs=1.0)
    assert packet.option(1).time >> 21 == 0


def test_what_a_real_capture_has_at_rest(fake_lab):
    """A landed AR.Drone 2.0, level to 3 degrees, its accelerometer reads (80, -33, -943) milli-g."""
    lab = fake_lab(FakeVehicle(FlightPhase.LANDED, position_m=np.array([0.0, 0.0, 0.0])))
    lab.connect()
    data = lab.run(0.1, ref=IDLE)[-1][3]
    packet = Navdata(data)
    raw_accs = packet.option(2).raw_accs
    assert raw_accs[:2] == (2048, 2048) and raw_accs[2] == pytest.approx(2528, rel=0.02), "above mid-scale"
    assert packet.option(2).alt_temp_raw == pytest.approx(243, abs=5), "nothing nearer is heard by ultrasound"
    assert packet.option(0).altitude == 0
    assert peek(data).vision_defined == 1
    assert packet.option(9)[4:8] == (255, 255, 255, 255)
    assert packet.option(0).drone_camera_trans == pytest.approx((0, 0, -243), abs=5)
    np.testing.assert_allclose(packet.option(0).drone_camera_rot, np.eye(3).ravel(), atol=1e-6)


def test_camera_rotation_as_in_a_real_capture(fake_lab):
    """Captured in flight: theta -6.514, phi -0.558 degrees, heading changed by 5.11 degrees since power-on."""
    lab = fake_lab()
    lab.connect()
    lab.vehicle.change(theta=math.radians(-6.514), phi=math.radians(-0.558), psi=math.radians(5.109))
    rotation = Navdata(lab.run(0.05, ref=IDLE)[-1][3]).option(0).drone_camera_rot
    seen = (0.98959, -0.08795, -0.11387, 0.08848, 0.99608, -0.00040, 0.11346, -0.00968, 0.99350)
    np.testing.assert_allclose(rotation, seen, atol=2e-5)


@pytest.mark.parametrize("demo", [False, True])
def test_camera_translation_is_the_way_flown_in_axes_of_the_start(fake_lab, demo):
    """Axes of the start, facing east: x east, y south. Then it faces south and flies west, a little to the south."""
    lab = fake_lab(FakeVehicle(psi=math.pi / 2))
    lab.connect(demo)
    lab.vehicle.change(psi=math.pi, velocity_m_s=np.array([0.0, 0.5, 0.0]))  # cortex y: west
    first = Navdata(lab.run(0.2, ref=IDLE)[-1][3]).option(0).drone_camera_trans
    lab.vehicle.change(velocity_m_s=np.array([-0.2, 0.5, 0.0]))  # and south
    second = Navdata(lab.run(2.0, ref=IDLE)[-1][3]).option(0).drone_camera_trans
    way_mm = np.subtract(second, first)
    np.testing.assert_allclose(way_mm, (-1000.0, 400.0, 0.0), atol=40.0)
    assert second[2] == pytest.approx(-1000.0, abs=1.0), "down"


@pytest.mark.parametrize("psi_deg", [0.0, 45.0, 90.0, 180.0, -120.0])
def test_magnetic_field_gives_the_heading(fake_lab, psi_deg):
    lab = fake_lab(FakeVehicle(psi=math.radians(psi_deg)))
    magneto = options_of(lab).option(22)
    x_mg, y_mg, z_mg = magneto.magneto_raw
    heading_deg = math.degrees(math.atan2(-y_mg, x_mg))  # level: the field points to magnetic north
    assert math.cos(math.radians(heading_deg - psi_deg)) > 0.9999
    assert z_mg > 0
    counts = np.array([magneto.my, magneto.mx, magneto.mz])
    np.testing.assert_allclose(magneto.magneto_raw, -3.5 * counts, atol=3.6)  # as in real captures: -3.4 to -3.7


def test_tilted_magnetic_field_has_the_same_strength(fake_lab):
    lab = fake_lab(FakeVehicle(psi=1.0, phi=0.3, theta=-0.2))
    assert np.linalg.norm(options_of(lab).option(22).magneto_raw) == pytest.approx(math.hypot(210, 470), abs=2.0)


def test_yaw_stays_in_range_and_the_heading_is_unwrapped(fake_lab):
    lab = fake_lab()
    lab.connect()
    headings, yaws = [], []
    for k in range(40):
        lab.vehicle.change(psi=math.remainder(0.2 * k, 2.0 * math.pi))
        packet = Navdata(lab.run(0.05, ref=IDLE)[-1][3])
        yaws.append(packet.option(0).psi)
        headings.append(packet.option(22).heading_unwrapped)
    assert all(-180000.0 < yaw <= 180000.0 for yaw in yaws)
    np.testing.assert_allclose(headings, np.degrees(0.2 * np.arange(40)), atol=0.01)


def test_noise_is_seeded_and_of_the_right_size():
    def readings(seed):
        lab = Lab(FakeVehicle(), seed=seed)
        try:
            lab.connect()
            packets = [Navdata(p[3]) for p in lab.run(2.0, ref=IDLE)]
            return np.array([p.option(3).phys_accs + (p.option(0).theta, p.option(0).vx) for p in packets])
        finally:
            lab.close()

    first = readings(1)
    np.testing.assert_array_equal(first, readings(1))
    assert not np.array_equal(first, readings(2))
    assert abs(first[:, 2].mean() + 1000.0) < 3.0
    np.testing.assert_allclose(first.std(axis=0), (8.0, 8.0, 8.0, 50.0, 30.0), rtol=0.2)


def test_flat_trim_removes_the_bias_of_the_level():
    lab = Lab(FakeVehicle(phase=FlightPhase.LANDED), seed=3)
    try:
        lab.connect()

        def level():
            packets = [Navdata(p[3]) for p in lab.run(1.0, ref=IDLE)]
            return np.mean([(p.option(0).phi, p.option(0).theta) for p in packets], axis=0)

        assert np.abs(level()).max() > 50.0
        lab.client.at("FTRIM")
        lab.run(0.05, ref=IDLE)
        assert np.abs(level()).max() < 15.0
    finally:
        lab.close()


def test_every_option_can_be_read_and_the_landed_vehicle_is_at_rest(lab):
    packet = options_of(lab)
    for tag in ALL_TAGS:
        assert packet.option(tag) is not None
    demo = packet.option(0)
    assert demo.ctrl_state == 131072
    assert (demo.altitude, demo.vx, demo.vy, demo.vz) == (0, 0, 0, 0)
    assert packet.option(3).phys_accs == pytest.approx((0, 0, -1000), abs=50.0)
    assert packet.option(9)[:4] == (0, 0, 0, 0)
    assert packet.option(16).nb_detected == 0
    assert 11000 < packet.option(2).vbat_raw < 13000


# ------------------------------------------------------------------ several aircraft, addresses


@pytest.fixture
def served(lab):
    """The lab, served by its own thread while the test uses a blocking client."""
    stop = threading.Event()

    def serve():
        while not stop.is_set():
            lab.serve()
            time.sleep(0.001)

    thread = threading.Thread(target=serve)
    thread.start()
    yield lab
    stop.set()
    thread.join()


@pytest.mark.parametrize("passive", [True, False])
def test_the_version_is_read_by_ftp(served, passive):
    """As Parrot's own library does before it starts, to tell an AR.Drone 2.0 from the first model."""
    with ftplib.FTP() as ftp:
        ftp.connect(ADDRESS, served.host.ports.ftp, timeout=15.0)
        ftp.login()  # anonymous
        ftp.set_pasv(passive)
        ftp.voidcmd("TYPE I")
        size = ftp.size("version.txt")
        text = bytearray()
        ftp.retrbinary("RETR version.txt", text.extend)
        assert len(text) == size
        assert text.decode("ascii").strip() == served.host.get("general:num_version_soft")
        assert ftp.nlst() == ["version.txt"]
        for forbidden in ("DELE version.txt", "MKD x", "STOR firmware.plf", "RETR ../scene.yaml"):
            with pytest.raises(ftplib.error_perm):
                ftp.sendcmd(forbidden)
    events = served.host.statistics()["notices"]["events"]
    assert sum(events["reads files by FTP"].values()) == 1


def test_with_the_link_down_ftp_stalls_too(lab):
    with socket.create_connection((ADDRESS, lab.host.ports.ftp), 15.0) as client:
        lab.serve()
        client.settimeout(0.0)
        lab.run(0.05)
        assert client.recv(1000).startswith(b"220")
        lab.lose_link(0.5)
        client.sendall(b"USER anonymous\r\n")
        lab.run(0.4)
        with pytest.raises(BlockingIOError):
            client.recv(1000)
        lab.run(0.2)
        assert client.recv(1000).startswith(b"331")


def test_faults_act_on_ftp(lab):
    with socket.create_connection((ADDRESS, lab.host.ports.ftp), 15.0) as client:
        lab.serve()
        client.settimeout(0.0)
        lab.run(0.05)
        assert client.recv(1000).startswith(b"220")
        lab.host.wires.add(FaultEvent("delay", channel="risc1/ftp", severity=0.3, start_s=lab.now_s, duration_s=0.2))
        client.sendall(b"USER anonymous\r\n")
        lab.run(0.29)
        with pytest.raises(BlockingIOError):
            client.recv(1000)
        lab.run(0.02)
        assert client.recv(1000).startswith(b"331")
        lab.host.wires.add(FaultEvent("cut", channel="risc1/ftp", severity=1.0, start_s=lab.now_s, duration_s=0.2))
        client.sendall(b"NOOP\r\n")
        lab.run(0.05)
        with pytest.raises(ConnectionResetError):
            client.recv(1000)
    lab.run(0.2)
    with socket.create_connection((ADDRESS, lab.host.ports.ftp), 15.0) as client:
        lab.serve()
        assert client.recv(1000).startswith(b"220"), "the next one is served"


def test_three_aircraft_on_the_standard_ports():
    world = make_world(3)
    a, b = 1 + os.getpid() // 250 % 250, 1 + os.getpid() % 250
    labs = []
    try:
        for i, vehicle in enumerate(world.vehicles.values()):
            labs.append(Lab(vehicle, world, address="127.%d.%d.%d" % (94 + i, a, b), ports=ardrone_host.STANDARD_PORTS))
        for lab in labs:
            assert lab.host.ports == (5554, 5555, 5556, 5559, 5551)
            assert "5554" in lab.host.describe() and lab.host.address in lab.host.describe()
            lab.connect()
        labs[1].run(1.0, ref=START)
        assert [v.phase for v in world.vehicles.values()] == [
            FlightPhase.LANDED,
            FlightPhase.TAKING_OFF,
            FlightPhase.LANDED,
        ]
        with pytest.raises(OSError, match=labs[0].host.address) as error:
            ArdroneHost(world.vehicles["risc1"], labs[0].host.address)
        assert error.value.errno == errno.EADDRINUSE
    finally:
        for lab in labs:
            lab.close()


def test_an_address_this_machine_does_not_have():
    with pytest.raises(OSError, match="192.0.2.77"):
        ArdroneHost(FakeVehicle(), "192.0.2.77", ports=FREE)


def test_a_failed_start_leaves_no_sockets_behind():
    blocker = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    blocker.bind((ADDRESS, 0))
    taken = blocker.getsockname()[1]
    with pytest.raises(OSError):
        ArdroneHost(FakeVehicle(), ADDRESS, ports=Ports(0, 0, taken, 0))
    blocker.close()
    host = ArdroneHost(FakeVehicle(), ADDRESS, ports=Ports(0, 0, taken, 0))
    assert host.ports.at == taken
    host.close()
    host.close()
    assert host.sockets() == []


def test_orders_go_through_the_vehicle(fake_lab):
    lab = fake_lab(FakeVehicle(phase=FlightPhase.LANDED))
    lab.run(0.2, ref=START)
    assert [a for _, a in lab.vehicle.told] == [FlightAction.TAKE_OFF]
