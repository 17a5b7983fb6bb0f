"""MAVLink of the virtual Pixhawk: each service once, with bytes, from a client that shares no code with it.

The client packs and unpacks with struct and the public description of the protocol; the autopilot is a stand-in that
only records what it is told, so that the messages can be tested in every state.
"""

import collections
import dataclasses
import math
import pathlib
import struct
import types

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab.yaml_reader import load_yaml, package_file
from risc_simulator.models.flight import FlightPhase, VehicleState
from risc_simulator.vehicles.iris import mavlink as mavlink_module
from risc_simulator.vehicles.iris.mavlink import CLIENT_SILENCE_S, MAX_CLIENTS, MAX_DATAGRAM_BYTES, Mavlink
from risc_simulator.vehicles.iris.parameters import Parameters
from risc_simulator.vehicles.iris.sensors import CAPACITY_AH, IrisSensors

SYSTEM, STATION, OTHER_STATION = 3, 255, 245
ME, YOU = ("127.0.0.1", 40001), ("127.0.0.1", 40002)
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
STABILIZE, ALT_HOLD, GUIDED, LAND = 0, 2, 4, 9
STEP_S = 0.005

# name: (id, CRC extra, payload format of MAVLink 1, MAVLink 2 extension fields), in wire order
DIALECT = {
    "HEARTBEAT": (0, 50, "IBBBBB", ""),
    "SYS_STATUS": (1, 124, "IIIHHhHHHHHHb", "III"),
    "SYSTEM_TIME": (2, 137, "QI", ""),
    "PING": (4, 237, "QIBB", ""),
    "SET_MODE": (11, 89, "IBB", ""),
    "PARAM_REQUEST_READ": (20, 214, "hBB16s", ""),
    "PARAM_REQUEST_LIST": (21, 159, "BB", ""),
    "PARAM_VALUE": (22, 220, "fHH16sB", ""),
    "PARAM_SET": (23, 168, "fBB16sB", ""),
    "GPS_RAW_INT": (24, 24, "QiiiHHHHBB", "iIIIIH"),
    "RAW_IMU": (27, 144, "Q9h", "Bh"),
    "SCALED_PRESSURE": (29, 115, "Iffh", "h"),
    "ATTITUDE": (30, 39, "I6f", ""),
    "ATTITUDE_QUATERNION": (31, 246, "I7f", "4f"),
    "LOCAL_POSITION_NED": (32, 185, "I6f", ""),
    "GLOBAL_POSITION_INT": (33, 104, "IiiiihhhH", ""),
    "RC_CHANNELS_RAW": (35, 244, "I8HBB", ""),
    "SERVO_OUTPUT_RAW": (36, 222, "I8HB", "8H"),
    "MISSION_ITEM": (39, 254, "7fHHBBBBB", "B"),
    "MISSION_REQUEST": (40, 230, "HBB", "B"),
    "MISSION_CURRENT": (42, 28, "H", "HBB"),
    "MISSION_REQUEST_LIST": (43, 132, "BB", "B"),
    "MISSION_COUNT": (44, 221, "HBB", "B"),
    "MISSION_CLEAR_ALL": (45, 232, "BB", "B"),
    "MISSION_ACK": (47, 153, "BBB", "B"),
    "NAV_CONTROLLER_OUTPUT": (62, 183, "fffffhhH", ""),
    "RC_CHANNELS": (65, 118, "I18HBB", ""),
    "REQUEST_DATA_STREAM": (66, 148, "HBBBB", ""),
    "MANUAL_CONTROL": (69, 243, "hhhhHB", ""),
    "RC_CHANNELS_OVERRIDE": (70, 124, "8HBB", "10H"),
    "MISSION_ITEM_INT": (73, 38, "ffffiifHHBBBBB", "B"),
    "VFR_HUD": (74, 20, "ffffhH", ""),
    "COMMAND_INT": (75, 158, "ffffiifHBBBBB", ""),
    "COMMAND_LONG": (76, 152, "7fHBBB", ""),
    "COMMAND_ACK": (77, 143, "HB", "BiBB"),
    "FILE_TRANSFER_PROTOCOL": (110, 84, "BBB251s", ""),
    "TIMESYNC": (111, 34, "qq", ""),
    "LOG_REQUEST_LIST": (117, 128, "HHBB", ""),
    "LOG_ENTRY": (118, 56, "IIHHH", ""),
    "POWER_STATUS": (125, 203, "HHH", ""),
    "BATTERY_STATUS": (147, 154, "iih10HhBBBb", "iB4HBI"),
    "AUTOPILOT_VERSION": (148, 178, "QQIIIIHH8s8s8s", "18s"),
    "MEMINFO": (152, 208, "HH", "I"),
    "FENCE_STATUS": (162, 189, "IHBB", "B"),
    "AHRS": (163, 127, "7f", ""),
    "HWSTATUS": (165, 21, "HB", ""),
    "AHRS2": (178, 47, "ffffii", ""),
    "EKF_STATUS_REPORT": (193, 71, "5fH", "f"),
    "VIBRATION": (241, 90, "QfffIII", ""),
    "HOME_POSITION": (242, 104, "iii10f", "Q"),
    "MESSAGE_INTERVAL": (244, 95, "iH", ""),
    "EXTENDED_SYS_STATE": (245, 130, "BB", ""),
    "STATUSTEXT": (253, 83, "B50s", "HB"),
    "PARAM_ERROR": (345, 209, "hBB16sB", ""),
}
NAMES = {entry[0]: name for name, entry in DIALECT.items()}
ID = {name: entry[0] for name, entry in DIALECT.items()}


def checksum(data):
    """CRC-16/MCRF4XX."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    return struct.pack("<H", crc)


def frame(name, *values, version=2, system=STATION, component=190):
    """Bytes of a message. values: in wire order; MAVLink 2 extension fields may be omitted."""
    number, extra, base, added = DIALECT[name]
    added = (
        added
        if version == 2 and len(values) > len(struct.unpack("<" + base, bytes(struct.calcsize("<" + base))))
        else ""
    )
    payload = struct.pack("<" + base + added, *values)
    if version == 1:
        head = struct.pack("<BBBBB", len(payload), 7, system, component, number)
        return b"\xfe" + head + payload + checksum(head + payload + bytes([extra]))
    payload = payload.rstrip(b"\0") or b"\0"
    head = struct.pack("<BBBBBBHB", len(payload), 0, 0, 7, system, component, number & 0xFFFF, number >> 16)
    return b"\xfd" + head + payload + checksum(head + payload + bytes([extra]))


Message = collections.namedtuple("Message", "name values version system component sequence")


def read(data):
    """The one message in a datagram, checked."""
    if data[0] == 0xFE:
        version, (length, sequence, system, component, number), at = 1, struct.unpack_from("<BBBBB", data, 1), 6
    else:
        assert data[0] == 0xFD
        length, flags, _, sequence, system, component, low, high = struct.unpack_from("<BBBBBBHB", data, 1)
        assert flags == 0
        version, number, at = 2, low | high << 16, 10
    name = NAMES[number]
    _, extra, base, added = DIALECT[name]
    payload = data[at : at + length]
    assert len(data) == at + length + 2
    assert data[-2:] == checksum(data[1:-2] + bytes([extra])), name
    form = "<" + base + (added if version == 2 else "")
    if version == 1:
        assert length == struct.calcsize(form), name
    values = struct.unpack(form, payload.ljust(struct.calcsize(form), b"\0"))
    return Message(name, values, version, system, component, sequence)


class Vehicle:
    """The vehicle state that the messages report."""

    def __init__(self):
        self.namespace, self.phase = "iris1", FlightPhase.LANDED
        self.plant = types.SimpleNamespace(roll_level_rad=0.0, pitch_level_rad=0.0)
        self.firmware = types.SimpleNamespace(
            armed=False, lifted=False, drain_pct_s=0.01, command=(0.1, -0.2, 0.0, 0.0)
        )
        rest = np.array([0.5, 0.25, 0.1]), np.zeros(3), *(0.0,) * 6
        self.state = VehicleState(*rest, np.array([0.0, 0.0, -GRAVITY_M_S2]), (0, 0, 0, 0), 80.0)

    @property
    def height_m(self):
        return self.state.position_m.item(2)

    @property
    def battery_pct(self):
        return self.state.battery_pct

    def change(self, **state):
        self.state = dataclasses.replace(self.state, **state)


class Autopilot:
    """Obeys orders and records them."""

    def __init__(self):
        self.vehicle, self.parameters = Vehicle(), Parameters()
        self.armed, self.mode, self.trouble = False, STABILIZE, ""
        self.channels_us, self.radio_failsafe = (1500, 1500, 1000, 1500), False
        self.sensors = IrisSensors(self.vehicle, np.random.default_rng(1), noise=0.0)
        self.texts, self.overrides = collections.deque(), []

    def set_mode(self, number):
        if number not in (STABILIZE, ALT_HOLD, LAND):
            return "no such mode"
        self.mode = number
        return ""

    def arm(self, by_force):
        if self.trouble and not by_force:
            self.texts.append((2, "Arm: " + self.trouble))
            return self.trouble
        self.armed = True
        return ""

    def disarm(self, by_force):
        if self.vehicle.phase is not FlightPhase.LANDED and not by_force:
            return "flying"
        self.armed = False
        return ""

    def arming_trouble(self):
        return self.trouble

    def override(self, channels, now_s):
        self.overrides.append((channels, now_s))


class Lab:
    """A Mavlink in simulated time."""

    def __init__(self):
        self.autopilot, self.now_s = Autopilot(), 0.0
        self.sent = []  # (bytes, address)
        self.mavlink = Mavlink(self.autopilot, SYSTEM, lambda data, address: self.sent.append((data, address)))

    def take(self, address=ME):
        """Return the messages sent to a client since the last call."""
        mine = [read(data) for data, to in self.sent if to == address]
        self.sent = [(data, to) for data, to in self.sent if to != address]
        return mine

    def say(self, name, *values, address=ME, **options):
        """Send a client's message; return the answers."""
        return self.say_bytes(frame(name, *values, **options), address)

    def say_bytes(self, data, address=ME):
        self.mavlink.on_datagram(data, address, self.now_s)
        return self.take(address)

    def run(self, seconds, address=ME):
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            self.mavlink.tick(self.now_s)
        return self.take(address)

    def connect(self, address=ME, **options):
        return self.say("HEARTBEAT", 0, 6, 8, 0, 4, 3, address=address, **options)

    def order(self, command, *params, **options):
        """Send a command; return (its result, other answers)."""
        self.now_s += STEP_S
        params = [*params, *[0.0] * (7 - len(params))]
        *others, ack = self.say("COMMAND_LONG", *params, command, SYSTEM, 1, 0, **options)
        assert ack.name == "COMMAND_ACK" and ack.values[0] == command
        return ack.values[1], others

    def told(self, name, **options):
        """Request a message once; return its values."""
        result, (message,) = self.order(512, ID[name], **options)
        assert result == ACCEPTED and message.name == name
        return message.values


@pytest.fixture
def lab():
    lab = Lab()
    lab.connect()
    return lab


def names(messages):
    return [message.name for message in messages]


# ------------------------------------------------------------------ frames and clients


@pytest.mark.parametrize("version", [1, 2])
def test_who_talks_is_answered_at_once_and_then_once_a_second_in_its_own_version(version):
    lab = Lab()
    assert lab.run(1.0) == []
    (first,) = lab.connect(version=version)
    assert first.values == (STABILIZE, 2, 3, 81, 3, 3) and (first.system, first.component) == (SYSTEM, 1)
    beats = lab.run(5.02)
    assert names(beats) == ["HEARTBEAT"] * 5
    assert {message.version for message in (first, *beats)} == {version}
    assert [message.sequence for message in (first, *beats)] == list(range(6))


def test_heartbeat_says_mode_and_arming(lab):
    lab.autopilot.armed, lab.autopilot.mode = True, LAND
    assert lab.run(1.0)[-1].values == (LAND, 2, 3, 209, 4, 3)


def test_a_client_that_changes_to_mavlink_2_is_answered_so():
    lab = Lab()
    assert lab.connect(version=1)[0].version == 1
    lab.connect(version=2)
    assert {message.version for message in lab.run(2.0)} == {2}


def test_clients_have_rates_of_their_own_and_are_forgotten_after_silence(lab):
    lab.connect(address=YOU, version=1)
    lab.say("REQUEST_DATA_STREAM", 10, SYSTEM, 1, 10, 1)
    counts = collections.Counter(names(lab.run(1.98)))
    assert counts == {"HEARTBEAT": 1, "ATTITUDE": 20, "AHRS2": 20}
    assert names(lab.take(YOU)) == ["HEARTBEAT"]
    for _ in range(4):
        lab.run(10.0)
        lab.connect(address=YOU)
    lab.take()
    lab.take(YOU)
    assert lab.run(5.0) == [] and set(names(lab.take(YOU))) == {"HEARTBEAT"}
    assert CLIENT_SILENCE_S < 40.0


def test_there_is_an_end_to_the_number_of_clients():
    lab = Lab()
    answers = [lab.connect(address=("127.0.0.1", 50000 + i)) for i in range(MAX_CLIENTS + 3)]
    assert [bool(answer) for answer in answers] == [True] * MAX_CLIENTS + [False] * 3
    lab.run(5.0)
    lab.connect(address=("127.0.0.1", 50001))
    assert lab.connect() and ("127.0.0.1", 50000) not in lab.mavlink.clients  # the longest silent was dropped
    assert len(lab.mavlink.clients) == MAX_CLIENTS and ("127.0.0.1", 50001) in lab.mavlink.clients


@pytest.mark.parametrize("makes_room", [True, False])
def test_who_takes_all_places_gives_one_up(monkeypatch, makes_room):
    if not makes_room:  # the control arm
        monkeypatch.setattr("risc_simulator.vehicles.iris.mavlink.greediest", lambda *_: None)
    lab = Lab()
    for port in range(MAX_CLIENTS):
        assert lab.connect(address=("127.0.0.8", 50000 + port))
    assert bool(lab.connect(address=("127.0.0.9", 50000))) is makes_room
    assert len(lab.mavlink.clients) == MAX_CLIENTS


PING = frame("PING", 5, 6, 0, 0)


@pytest.mark.parametrize(
    "before, after",
    [
        (b"", b""),
        (b"\0hello", b"\xfe"),
        (b"\xfd\xff\0", b"\xfd"),
        (b"\xfe\xff", b"\xfe\x09"),
        (PING[:-1] + b"x", PING[:9]),
    ],
)
def test_a_frame_is_found_among_other_bytes(before, after):
    lab = Lab()
    assert names(lab.say_bytes(before + PING + after + PING)) == ["HEARTBEAT", "PING", "PING"]


def test_a_datagram_of_false_starts_is_given_up():
    """Searching 64 kB of them byte by byte would hold up the lab for a second."""
    lab = Lab()
    assert names(lab.say_bytes(b"\xfe" * 20 + b"\0" * 300 + PING)) == ["HEARTBEAT", "PING"]
    assert lab.say_bytes(b"\xfe" * 60000 + PING) == []
    assert lab.mavlink.counts["foreign_bytes"] == 320 + 60000 + len(PING)


@pytest.mark.parametrize("most_bytes", [MAX_DATAGRAM_BYTES, 70_000])
def test_a_datagram_that_is_too_long_is_not_looked_at(monkeypatch, most_bytes):
    """64 kB of zeros take as long as a thousand frames. The control arm has no limit."""
    monkeypatch.setattr("risc_simulator.vehicles.iris.mavlink.MAX_DATAGRAM_BYTES", most_bytes)
    lab = Lab()
    answers = names(lab.say_bytes(PING + bytes(60_000)))
    assert answers == ([] if most_bytes == MAX_DATAGRAM_BYTES else ["HEARTBEAT", "PING"])


@pytest.mark.parametrize("place", range(len(PING)))
def test_a_damaged_frame_has_no_effect(place):
    damaged = bytearray(PING)
    damaged[place] ^= 0x10
    lab = Lab()
    assert lab.say_bytes(bytes(damaged)) == []
    assert lab.mavlink.counts["foreign_bytes"] == len(PING) and not lab.mavlink.clients


def test_what_is_for_other_systems_and_components_is_left_to_them(lab):
    for system, component, answered in [
        (SYSTEM, 1, 1),
        (0, 0, 1),
        (SYSTEM, 0, 1),
        (SYSTEM + 1, 1, 0),
        (SYSTEM, 100, 0),
    ]:
        answers = lab.say("COMMAND_LONG", *[0.0] * 7, 520, system, component, 0)
        assert len(answers) == 2 * answered, (system, component)


@given(
    st.lists(st.one_of(st.binary(max_size=40), st.sampled_from([PING, PING[:12], frame("PARAM_REQUEST_LIST", 0, 0)])))
)
def test_no_bytes_raise(parts):
    lab = Lab()
    lab.say_bytes(b"".join(parts))
    lab.run(0.02)


@given(st.sampled_from(sorted(DIALECT)), st.binary(min_size=255, max_size=255), st.sampled_from([1, 2]))
def test_no_values_raise(name, data, version):
    """Valid frames with any content: infinities, unknown numbers, invalid text."""
    number, extra, base, added = DIALECT[name]
    form = "<" + base + (added if version == 2 else "")
    payload = bytearray(data[: struct.calcsize(form)])
    if version == 1 and number > 255:
        return
    lab = Lab()
    values = list(struct.unpack(form, payload))
    fields = [c for c in base if c.isalpha()]
    if fields.count("B") >= 2 and name not in ("HEARTBEAT", "SYS_STATUS"):  # mostly target system and component
        for i, value in enumerate(values):
            if isinstance(value, int) and i >= len(values) - 14:
                values[i] = {1: SYSTEM, 2: 1}.get(value % 5, value)
    lab.say_bytes(frame(name, *values, version=version))
    lab.run(0.02)


# ------------------------------------------------------------------ identity


def test_version_and_capabilities_by_both_commands(lab):
    answers = [lab.order(520, 1.0), lab.order(512, 148.0)]
    assert answers[0] == answers[1] or [a[1][0].values for a in answers][0] == [a[1][0].values for a in answers][1]
    result, (version,) = answers[0]
    capabilities, uid, software = version.values[:3]
    assert result == ACCEPTED and uid == SYSTEM and software >> 16 == 4 << 8 | 5
    param_float, mission_int, command_int, ftp, terminate, mavlink2 = 2, 4, 8, 32, 2048, 8192
    assert capabilities == param_float | mission_int | command_int | terminate | mavlink2
    assert not capabilities & ftp


@pytest.mark.parametrize(
    "command, asked", [(512, 264), (528, 1), (512, 435), (512, 397), (512, 395), (521, 1), (519, 1), (20, 0)]
)
def test_what_there_is_not_is_refused_at_once(lab, command, asked):
    assert lab.order(command, float(asked)) == (UNSUPPORTED, [])


def test_every_command_is_acknowledged_to_its_sender(lab):
    for command in range(1, 3000):
        *_, ack = lab.say("COMMAND_LONG", *[0.0] * 7, command, SYSTEM, 1, 0, system=17, component=5)
        assert ack.name == "COMMAND_ACK" and ack.values[0] == command and ack.values[-2:] == (17, 5)
        *_, ack = lab.say("COMMAND_INT", *[0.0] * 4, 0, 0, 0.0, command, SYSTEM, 1, 0, 0, 0)
        assert ack.name == "COMMAND_ACK" and ack.values[0] == command


def test_ping_and_timesync(lab):
    lab.now_s = 12.5
    assert lab.say("PING", 77, 8, 0, 0)[0].values == (77, 8, STATION, 190)
    assert lab.say("PING", 77, 8, STATION, 190) == []  # this is an answer, not a request
    assert lab.say("TIMESYNC", 0, 4711)[0].values == (12500000000, 4711)
    assert lab.say("TIMESYNC", 5, 4711) == []


def test_files_are_refused_so_that_lists_are_used(lab):
    ask = struct.pack("<HBBBBBBI", 41, 9, 4, 16, 0, 0, 0, 0) + b"@PARAM/param.pck"
    (answer,) = lab.say("FILE_TRANSFER_PROTOCOL", 0, SYSTEM, 1, ask)
    network, system, component, payload = answer.values
    assert (network, system, component) == (0, STATION, 190)
    sequence, session, opcode, size, asked = struct.unpack_from("<HBBBB", payload)
    assert (sequence, session, opcode, size, asked, payload[12]) == (42, 9, 129, 1, 4, 10)
    (answer,) = lab.say("FILE_TRANSFER_PROTOCOL", 0, SYSTEM, 1, struct.pack("<HBBBBBBI", 65535, 9, 1, 0, 0, 0, 0, 0))
    assert struct.unpack_from("<HBBBB", answer.values[3]) == (0, 9, 128, 0, 1)


def test_there_are_no_logs(lab):
    assert lab.say("LOG_REQUEST_LIST", 0, 65535, SYSTEM, 1)[0].values == (0, 0, 0, 0, 0)


# ------------------------------------------------------------------ parameters


def text(data):
    return data.rstrip(b"\0").decode()


def test_parameters_by_list(lab):
    lab.say("PARAM_REQUEST_LIST", SYSTEM, 1)
    answers = [message.values for message in lab.run(1.0) if message.name == "PARAM_VALUE"]
    value, count, index, name, kind = zip(*answers)
    assert set(count) == {len(answers)} and list(index) == list(range(len(answers))) and len(set(name)) == len(answers)
    found = {text(n): (v, k) for n, v, k in zip(name, value, kind)}
    assert found["FS_THR_VALUE"] == (975.0, 4) and found["RC_OVERRIDE_TIME"] == (3.0, 9)
    assert found["SYSID_MYGCS"][0] == STATION and found["ARMING_CHECK"] == (1.0, 6)
    asked_for = (
        "FRAME_CLASS FLTMODE1 COMPASS_DEV_ID INS_ACCOFFS_X BATT_MONITOR RC1_MIN RC3_TRIM RCMAP_ROLL FENCE_ENABLE"
    )
    assert set(asked_for.split()) <= set(found)


def test_parameters_by_index_and_by_name(lab):
    (by_index,) = lab.say("PARAM_REQUEST_READ", 5, SYSTEM, 1, b"")
    (by_name,) = lab.say("PARAM_REQUEST_READ", -1, SYSTEM, 1, by_index.values[3])
    assert by_index.values == by_name.values and by_index.values[2] == 5
    for index, name in (-1, b"NO_SUCH"), (30000, b""):
        (answer,) = lab.say("PARAM_REQUEST_READ", index, SYSTEM, 1, name)
        assert answer.name == "PARAM_ERROR" and answer.values[-1] == 1
    assert lab.say("PARAM_REQUEST_READ", -1, SYSTEM, 1, b"NO_SUCH", version=1) == []


def test_a_parameter_that_is_set_is_told_to_all(lab):
    lab.connect(address=YOU, version=1)
    (answer,) = lab.say("PARAM_SET", 1000.0, SYSTEM, 1, b"FS_THR_VALUE", 4)
    assert answer.values[0] == 1000.0 and text(answer.values[3]) == "FS_THR_VALUE"
    assert lab.take(YOU)[0].values[0] == 1000.0
    assert lab.autopilot.parameters["FS_THR_VALUE"] == 1000


@pytest.mark.parametrize(
    "name, value, error",
    [(b"FS_THR_VALUE", 300.0, 2), (b"ANGLE_MAX", math.nan, 2), (b"ANGLE_MAX", math.inf, 2), (b"NO_SUCH", 1.0, 1)],
)
def test_a_parameter_that_cannot_be_is_refused(lab, name, value, error):
    before = dict(
        zip(lab.autopilot.parameters.names, map(lab.autopilot.parameters.__getitem__, lab.autopilot.parameters.names))
    )
    refused, *kept = lab.say("PARAM_SET", value, SYSTEM, 1, name, 9)
    assert refused.name == "PARAM_ERROR" and refused.values[-1] == error
    assert [message.values[0] for message in kept] == ([before[name.decode()]] if error == 2 else [])
    assert all(lab.autopilot.parameters[name] == value for name, value in before.items())


def test_parameters_that_have_limits_are_used():
    """The others are documented as having no effect."""
    folder = pathlib.Path(mavlink_module.__file__).parent
    source = " ".join(path.read_text(encoding="utf-8") for path in folder.glob("*.py"))
    limits = load_yaml(package_file("risc_simulator", "config/iris_parameters.yaml"))
    limited = [name for name, entry in limits.items() if len(entry) > 2]
    assert len(limited) > 20
    for name in limited:
        whole, _, part = name.partition("_")
        assert name in source or (whole in ("RC1", "RC2", "RC4") and '"%s"' % part in source), name
    for name, entry in limits.items():
        assert len(entry) > 2 or '"%s"' % name not in source or name in ("BATT_CAPACITY", "SYSID_THISMAV"), name


def test_a_vehicle_may_have_values_of_its_own():
    assert Parameters(ANGLE_MAX=3000)["ANGLE_MAX"] == 3000
    with pytest.raises(ValueError, match="ANGLE_MAX"):
        Parameters(ANGLE_MAX=-1)
    with pytest.raises(ValueError, match="NO_SUCH"):
        Parameters(NO_SUCH=1)


# ------------------------------------------------------------------ missions


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_lists_of_missions_fences_and_rally_points_are_empty(lab, kind):
    assert lab.say("MISSION_REQUEST_LIST", SYSTEM, 1, kind)[0].values == (0, STATION, 190, kind)
    assert lab.say("MISSION_COUNT", 3, SYSTEM, 1, kind)[0].values == (STATION, 190, 3, kind)
    assert lab.say("MISSION_COUNT", 0, SYSTEM, 1, kind)[0].values == (STATION, 190, 0, kind)
    assert lab.say("MISSION_CLEAR_ALL", SYSTEM, 1, kind)[0].values == (STATION, 190, 0, kind)
    assert lab.say("MISSION_REQUEST", 0, SYSTEM, 1, kind)[0].values == (STATION, 190, 13, kind)
    item = [0.0] * 4 + [0, 0, 0.0, 0, 16, SYSTEM, 1, 3, 0, 1, kind]
    assert lab.say("MISSION_ITEM_INT", *item)[0].values == (STATION, 190, 3, kind)


def test_missions_in_mavlink_1():
    lab = Lab()
    lab.connect(version=1)
    (count,) = lab.say("MISSION_REQUEST_LIST", SYSTEM, 1, version=1)
    assert count.version == 1 and count.values == (0, STATION, 190)
    (refused,) = lab.say("MISSION_ITEM", *[0.0] * 7, 0, 16, SYSTEM, 1, 3, 0, 1, version=1)
    assert refused.values == (STATION, 190, 3)


def test_a_list_of_another_kind_is_refused(lab):
    assert lab.say("MISSION_REQUEST_LIST", SYSTEM, 1, 255)[0].values == (STATION, 190, 3, 255)


# ------------------------------------------------------------------ streams

STREAMS = {
    1: {"RAW_IMU", "SCALED_PRESSURE"},
    2: {
        "SYS_STATUS",
        "POWER_STATUS",
        "MEMINFO",
        "MISSION_CURRENT",
        "GPS_RAW_INT",
        "NAV_CONTROLLER_OUTPUT",
        "FENCE_STATUS",
    },
    3: {"SERVO_OUTPUT_RAW", "RC_CHANNELS"},
    6: {"GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"},
    10: {"ATTITUDE", "AHRS2"},
    11: {"VFR_HUD"},
    12: {"AHRS", "HWSTATUS", "SYSTEM_TIME", "BATTERY_STATUS", "EKF_STATUS_REPORT", "VIBRATION"},
}
STREAMS[0] = set().union(*STREAMS.values())


@pytest.mark.parametrize("stream", sorted(STREAMS))
def test_data_streams(lab, stream):
    lab.say("REQUEST_DATA_STREAM", 4, SYSTEM, 1, stream, 1)
    counts = collections.Counter(names(lab.run(2.0)))
    del counts["HEARTBEAT"]
    assert counts == dict.fromkeys(STREAMS[stream], 8)
    lab.say("REQUEST_DATA_STREAM", 4, SYSTEM, 1, stream, 1)  # repeated, as stations do: the rate stays
    counts = collections.Counter(names(lab.run(2.0)))
    del counts["HEARTBEAT"]
    assert counts == dict.fromkeys(STREAMS[stream], 8)
    lab.say("REQUEST_DATA_STREAM", 0, SYSTEM, 1, stream, 0)
    assert set(names(lab.run(2.0))) == {"HEARTBEAT"}


def test_raw_channels_go_to_mavlink_1_too():
    lab = Lab()
    lab.connect(version=1)
    lab.say("REQUEST_DATA_STREAM", 2, SYSTEM, 1, 3, 1, version=1)
    counts = collections.Counter(names(lab.run(2.0)))
    assert counts["RC_CHANNELS_RAW"] == counts["RC_CHANNELS"] == counts["SERVO_OUTPUT_RAW"] == 4


def test_message_intervals(lab):
    attitude = ID["ATTITUDE"]
    assert lab.order(511, attitude, 20000.0) == (ACCEPTED, [])
    assert names(lab.run(1.0)).count("ATTITUDE") in (50, 51)
    result, (interval,) = lab.order(510, attitude)
    assert result == ACCEPTED and interval.values == (20000, attitude)
    assert lab.order(511, attitude, -1.0) == (ACCEPTED, [])
    assert set(names(lab.run(1.02))) == {"HEARTBEAT"}
    assert lab.order(510, attitude)[1][0].values == (-1, attitude)
    assert lab.order(511, attitude, 3e38) == (ACCEPTED, [])
    assert lab.order(510, attitude)[1][0].values == (2**31 - 1, attitude)
    assert lab.order(511, 264.0, 1e5) == (UNSUPPORTED, [])
    assert lab.order(510, 264.0)[0] == UNSUPPORTED
    assert lab.order(511, 0.0, 1e5) == (DENIED, [])  # the heartbeat's interval cannot be changed
    assert lab.order(511, attitude, 1.0) == (ACCEPTED, [])
    assert names(lab.run(1.0)).count("ATTITUDE") in (50, 51)  # the rate is limited: clients cannot overload the lab


def test_an_interval_of_0_is_the_default_that_of_its_stream(lab):
    attitude = ID["ATTITUDE"]
    assert lab.order(511, attitude, 20000.0) == (ACCEPTED, [])
    assert lab.order(511, attitude, 0.0) == (ACCEPTED, [])
    assert lab.order(510, attitude)[1][0].values == (-1, attitude), "no stream was asked for"
    lab.say("REQUEST_DATA_STREAM", 10, SYSTEM, 1, 10, 1)
    for other_us in (-1.0, 20000.0):
        lab.order(511, attitude, other_us)
        assert lab.order(511, attitude, 0.0) == (ACCEPTED, [])
        assert names(lab.run(1.0)).count("ATTITUDE") in (10, 11)


def test_what_a_late_cycle_has_missed_does_not_follow(lab):
    lab.order(511, ID["ATTITUDE"], 20000.0)
    lab.run(1.0)
    lab.now_s += 20.0
    assert names(lab.run(0.1)).count("ATTITUDE") <= 6
    assert names(lab.run(5.0)).count("HEARTBEAT") == 5


# ------------------------------------------------------------------ telemetry


def test_attitude_and_place_in_the_axes_of_mavlink(lab):
    """Cortex x is north, y is west, z is up."""
    lab.now_s = 2.5
    lab.autopilot.vehicle.change(
        position_m=np.array([1.0, 2.0, 1.1]),
        velocity_m_s=np.array([0.3, -0.4, 0.5]),
        phi=0.1,
        theta=-0.2,
        psi=-0.3,
        p=1,
        q=2,
        r=3,
    )
    assert lab.told("ATTITUDE") == pytest.approx((2505, 0.1, -0.2, -0.3, 1.0, 2.0, 3.0), rel=1e-6)
    assert lab.told("LOCAL_POSITION_NED") == pytest.approx((2510, 1.0, -2.0, -1.1, 0.3, 0.4, -0.5), rel=1e-6)
    _, latitude, longitude, altitude, relative, vx, vy, vz, heading = lab.told("GLOBAL_POSITION_INT")
    home = lab.told("HOME_POSITION")
    assert home[3:6] == pytest.approx((0.5, -0.25, -0.1))
    metres_per_degree = 1e-7 * math.pi / 180.0 * 6378137.0
    assert (latitude - home[0]) * metres_per_degree == pytest.approx(0.5, abs=0.02)
    east_m = (longitude - home[1]) * metres_per_degree * math.cos(math.radians(1e-7 * latitude))
    assert east_m == pytest.approx(-1.75, abs=0.02)
    assert (altitude - home[2], relative) == (1000, 1000) and (vx, vy, vz) == (30, 40, -50)
    assert heading == pytest.approx(36000 - math.degrees(0.3) * 100, abs=1)
    air, ground, up_m, climb, heading, _ = lab.told("VFR_HUD")
    assert (air, ground, climb) == pytest.approx((0.5, 0.5, 0.5)) and heading == 342
    assert up_m == pytest.approx(1e-3 * altitude, abs=0.01)
    w, x, y, z = lab.told("ATTITUDE_QUATERNION")[1:5]
    nose_east = 2 * (x * y + w * z)
    assert nose_east == pytest.approx(math.cos(-0.2) * math.sin(-0.3), abs=1e-6)
    assert 2 * (w * y - x * z) == pytest.approx(math.sin(-0.2), abs=1e-6) and 2 * (w * x + y * z) > 0


def test_sensors(lab):
    vehicle = lab.autopilot.vehicle
    time_us, *values = lab.told("RAW_IMU")[:10]
    assert values[:6] == [0, 0, -1000, 0, 0, 0]  # at rest: the floor pushes up
    north = values[6:]
    vehicle.change(psi=math.pi / 2, p=0.5, q=-0.25, r=0.125, specific_force_m_s2=np.array([GRAVITY_M_S2, 0.0, 0.0]))
    values = lab.told("RAW_IMU")[1:10]
    assert values[:6] == (1000, 0, 0, 500, -250, 125)
    assert values[6:] == (north[1], -north[0], north[2])  # the nose points east
    assert north[0] > 0 and north[2] > 0
    low = lab.told("SCALED_PRESSURE")[1]
    vehicle.change(position_m=np.array([0.0, 0.0, 2.1]))
    assert 0.1 < low - lab.told("SCALED_PRESSURE")[1] < 0.3
    assert lab.told("VIBRATION")[1:] == (0.0,) * 3 + (0,) * 3


def test_indoors_there_is_no_gps(lab):
    _, latitude, longitude, *_, fix, satellites = lab.told("GPS_RAW_INT")[:10]
    assert (latitude, longitude, fix, satellites) == (0, 0, 1, 0)
    flags = lab.told("EKF_STATUS_REPORT")[5]
    attitude, absolute_place, absolute_height = 1, 16, 32
    assert flags & attitude and flags & absolute_height and not flags & absolute_place


def test_motors_in_the_order_of_the_autopilot(lab):
    """Numbers 1 to 4 of an X: front right, rear left, front left, rear right."""
    assert lab.told("SERVO_OUTPUT_RAW")[1:5] == (1000,) * 4
    lab.autopilot.vehicle.firmware.armed = True
    lab.autopilot.vehicle.change(motor_pwm=(51, 102, 153, 204))  # front left, front right, rear right, rear left
    assert lab.told("SERVO_OUTPUT_RAW")[1:5] == (1400, 1800, 1200, 1600)
    assert lab.told("VFR_HUD")[5] == 4  # percent of the maximum thrust, which is proportional to pwm squared


def test_channels(lab):
    told = lab.told("RC_CHANNELS")
    assert told[1:5] == (1500, 1500, 1000, 1500) and set(told[5:19]) == {65535} and told[19:] == (4, 255)
    lab.autopilot.channels_us = ()
    assert lab.told("RC_CHANNELS")[19] == 0
    assert set(lab.told("RC_CHANNELS_RAW", version=1)[1:9]) == {65535}


RECEIVER, HEIGHT, READY, FENCE, GPS = 1 << 16, 1 << 13, 1 << 28, 1 << 20, 1 << 5


def test_health(lab):
    present, enabled, health = lab.told("SYS_STATUS")[:3]
    assert health & enabled == enabled and not enabled & HEIGHT and not present & (GPS | FENCE)
    lab.autopilot.mode = ALT_HOLD
    assert lab.told("SYS_STATUS")[1] & HEIGHT
    lab.autopilot.radio_failsafe = True
    assert not lab.told("SYS_STATUS")[2] & RECEIVER
    lab.autopilot.trouble = "Throttle too high"
    assert not lab.told("SYS_STATUS")[2] & READY
    lab.autopilot.armed = True
    assert lab.told("SYS_STATUS")[2] & READY


def test_battery(lab):
    vehicle = lab.autopilot.vehicle
    vehicle.change(battery_pct=75.4)
    vehicle.firmware.drain_pct_s = 100.0 / 900.0
    told, status = lab.told("SYS_STATUS"), lab.told("BATTERY_STATUS")
    used_mah, voltage_mv, others, current_ca, remaining = status[0], status[3], status[4:13], status[13], status[17]
    assert remaining == told[12] == 75 and set(others) == {65535}
    assert voltage_mv == told[4] and 10500 < voltage_mv < 12600
    assert used_mah == pytest.approx(246.0 * CAPACITY_AH, abs=1)
    assert current_ca == told[5] == pytest.approx(100.0 * 4.0 * CAPACITY_AH, abs=1)  # empty in a quarter of an hour
    vehicle.change(battery_pct=20.0)
    lab.now_s += 1.0
    assert lab.told("SYS_STATUS")[4] < voltage_mv
    vehicle.firmware.drain_pct_s = 10.0  # a tiny battery: the current exceeds the range of the field
    assert lab.told("SYS_STATUS")[5] == lab.told("BATTERY_STATUS")[13] == 32767


@pytest.mark.parametrize(
    "phase, landed",
    [(FlightPhase.LANDED, 1), (FlightPhase.FLYING, 2), (FlightPhase.TAKING_OFF, 3), (FlightPhase.LANDING, 4)],
)
def test_landed_state(lab, phase, landed):
    lab.autopilot.vehicle.phase = phase
    assert lab.told("EXTENDED_SYS_STATE") == (0, landed)


def test_what_it_wants_to_do(lab):
    roll_deg, pitch_deg = lab.told("NAV_CONTROLLER_OUTPUT")[:2]
    assert (roll_deg, pitch_deg) == pytest.approx((math.degrees(0.1), math.degrees(-0.2)))


def test_texts_go_to_all(lab):
    lab.connect(address=YOU, version=1)
    lab.autopilot.texts.extend([(2, "Arm: Throttle too high"), (6, "x" * 60)])
    mine = [message.values[:2] for message in lab.run(0.01)]
    assert mine == [(2, b"Arm: Throttle too high".ljust(50, b"\0")), (6, b"x" * 50)]
    assert [message.values[:2] for message in lab.take(YOU)] == mine
    assert not lab.autopilot.texts


# ------------------------------------------------------------------ orders


def test_arming_and_disarming(lab):
    autopilot = lab.autopilot
    autopilot.trouble = "Throttle too high"
    assert lab.order(400, 1.0) == (FAILED, []) and not autopilot.armed
    assert names(lab.run(0.01)) == ["STATUSTEXT"]
    assert lab.order(400, 1.0, 21196.0)[0] == FAILED and not autopilot.armed, "that is the number for disarming"
    lab.run(0.01)
    assert lab.order(400, 1.0, 2989.0) == (ACCEPTED, []) and autopilot.armed
    autopilot.vehicle.phase = FlightPhase.FLYING
    assert lab.order(400, 0.0)[0] == FAILED and autopilot.armed
    assert lab.order(400, 0.0, 2989.0)[0] == FAILED and autopilot.armed
    assert lab.order(400, 0.5)[0] == DENIED and autopilot.armed
    assert lab.order(400, 0.0, 21196.0)[0] == ACCEPTED and not autopilot.armed


def test_termination_cuts_the_motors(lab):
    lab.autopilot.armed, lab.autopilot.vehicle.phase = True, FlightPhase.FLYING
    assert lab.order(185, 0.0)[0] == DENIED and lab.autopilot.armed
    assert lab.order(185, 1.0)[0] == ACCEPTED and not lab.autopilot.armed


def test_modes_by_message_and_by_command(lab):
    autopilot = lab.autopilot
    assert lab.say("SET_MODE", ALT_HOLD, SYSTEM, 1)[0].values[:2] == (11, ACCEPTED) and autopilot.mode == ALT_HOLD
    assert lab.say("SET_MODE", LAND, SYSTEM, 0)[0].values[:2] == (11, DENIED) and autopilot.mode == ALT_HOLD
    assert lab.say("SET_MODE", GUIDED, SYSTEM, 1)[0].values[:2] == (11, FAILED) and autopilot.mode == ALT_HOLD
    assert lab.order(176, 1.0, float(STABILIZE))[0] == ACCEPTED and autopilot.mode == STABILIZE
    assert lab.order(176, 1.0, float(GUIDED))[0] == FAILED and autopilot.mode == STABILIZE
    assert lab.order(176, 0.0, float(LAND))[0] == DENIED and autopilot.mode == STABILIZE
    assert lab.order(22)[0] == FAILED  # take-off: by the throttle alone
    assert lab.order(21)[0] == ACCEPTED and autopilot.mode == LAND


def test_overrides_only_from_the_ground_station(lab):
    channels = [1600, 1400, 1300, 0, 65535, 5000, 100, 1500]
    lab.now_s = 7.0
    lab.say("RC_CHANNELS_OVERRIDE", *channels, SYSTEM, 1, system=OTHER_STATION)
    assert lab.autopilot.overrides == []
    lab.say("RC_CHANNELS_OVERRIDE", *channels, SYSTEM, 1)
    ((told, time_s),) = lab.autopilot.overrides
    assert time_s == 7.0 and told[:8] == (1600, 1400, 1300, 0, 65535, 2200, 800, 1500) and set(told[8:]) == {65535}
    lab.say("PARAM_SET", float(OTHER_STATION), SYSTEM, 1, b"SYSID_MYGCS", 4)
    lab.say("RC_CHANNELS_OVERRIDE", *channels, SYSTEM, 1, 1700, 0, 65534, *[65535] * 7, system=OTHER_STATION)
    assert lab.autopilot.overrides[1][0][8:11] == (1700, 65535, 0)
    lab.say("RC_CHANNELS_OVERRIDE", *channels, SYSTEM, 1, version=1)
    assert len(lab.autopilot.overrides) == 2


def test_manual_control(lab):
    """x: nose down, y: right, z: thrust, r: clockwise."""
    lab.say("MANUAL_CONTROL", 500, -500, 250, 1000, 0, SYSTEM)
    assert lab.autopilot.overrides[0][0][:5] == (1250, 1250, 1250, 2000, 65535)
    lab.say("MANUAL_CONTROL", 32767, 0, 32767, 32767, 0, SYSTEM)
    assert lab.autopilot.overrides[1][0][:4] == (1500, 65535, 65535, 65535)
    lab.say("MANUAL_CONTROL", 0, 0, 0, 0, 0, SYSTEM + 1)
    lab.say("MANUAL_CONTROL", 0, 0, 0, 0, 0, SYSTEM, system=OTHER_STATION)
    assert len(lab.autopilot.overrides) == 2


@pytest.mark.parametrize("switched_on", [True, False])
def test_loss_of_the_ground_station_lands_if_that_is_wanted(lab, switched_on):
    autopilot = lab.autopilot
    lab.say("PARAM_SET", float(switched_on), SYSTEM, 1, b"FS_GCS_ENABLE", 2)
    autopilot.armed = True
    lab.run(4.9)
    assert autopilot.mode == STABILIZE
    lab.connect(system=OTHER_STATION)  # not the configured station
    texts = [message for message in lab.run(0.3) if message.name == "STATUSTEXT"]
    assert (autopilot.mode == LAND) == switched_on == bool(texts)
    autopilot.mode = STABILIZE  # the pilot takes over: the failsafe does not act again
    lab.run(10.0)
    assert autopilot.mode == STABILIZE
    lab.connect()
    lab.run(6.0)
    assert (autopilot.mode == LAND) == switched_on


def test_without_a_ground_station_ever_nothing_is_lost():
    lab = Lab()
    lab.autopilot.armed = True
    assert lab.autopilot.parameters.set("FS_GCS_ENABLE", 1)
    lab.connect(system=OTHER_STATION)
    lab.run(20.0)
    assert lab.autopilot.mode == STABILIZE
