"""Ground stations connect to the virtual IRIS+ without a complaint, and see it fly: MAVProxy and MAVSDK as they are.

For QGroundControl, only its sequence of requests when it connects. `./maap test --all` installs the others.
"""

import collections
import contextlib
import json
import pathlib
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import types

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v10 import ardupilotmega as mavlink1
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from risc_lab.ros.launching import PortReservation

ROOT = pathlib.Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "src" / "risc_simulator" / "test"))  # serial_client.py
import serial_client  # noqa: E402

pytestmark = pytest.mark.release

PATIENCE_S = 60.0
CONNECTED_S = 3.0
COMPLAINT = re.compile(
    r"warn|error|fail(?!safe cleared)|no link|link \S+ down|breach|lost|time ?out|unable|\bbad\b|refused|denied|"
    r"unsupported|exception|traceback|prearm",
    re.IGNORECASE,
)


class Program:
    """A running program; its output lines are kept with the times at which they came."""

    def __init__(self, *command, **options):
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            bufsize=1,
            **options,
        )
        self.lines = []  # (text, time [s])
        self._changed = threading.Condition()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self.process.stdout:
            with self._changed:
                self.lines.append((line.rstrip("\n"), time.monotonic()))
                self._changed.notify_all()

    @property
    def output(self):
        return "\n".join(text for text, _ in self.lines)

    def say(self, line):
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def wait(self, pattern, after=0, limit_s=PATIENCE_S):
        """(match, time) of the first line from number `after` on in which the pattern is found."""

        def found():
            hits = ((re.search(pattern, text), time_s) for text, time_s in self.lines[after:])
            return next((hit for hit in hits if hit[0]), None)

        with self._changed:
            hit = self._changed.wait_for(found, limit_s)
        assert hit, "nothing like %r in:\n%s" % (pattern, self.output)
        return hit

    def ask(self, line, pattern):
        """Send a line. Returns the match of the pattern in the output that follows."""
        after = len(self.lines)
        self.say(line)
        return self.wait(pattern, after)[0]

    def poll(self, line, pattern):
        """As `ask`, repeated: MAVProxy prints nothing about a message that has not come yet."""
        after, end_s = len(self.lines), time.monotonic() + PATIENCE_S
        while True:
            self.say(line)
            try:
                return self.wait(pattern, after, limit_s=1.0)[0]
            except AssertionError:
                if time.monotonic() > end_s:
                    raise

    def end(self):
        self.process.stdin.close()
        try:
            self.process.wait(PATIENCE_S)
        finally:
            self.process.kill()


class Transmitter:
    """The pilot: a vehicle's Arduino at its serial line, which gets sticks all the time."""

    def __init__(self, address, port):
        self.throttle = -1.0
        self._stop = threading.Event()
        self._line = socket.create_connection((address, port), timeout=PATIENCE_S)
        self._line.sendall(serial_client.ASK_FOR_TOPICS)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        while not self._stop.wait(0.02):
            self._line.sendall(serial_client.controls(throttle=self.throttle, name=b"IRIS"))

    def close(self):
        self._stop.set()
        self._thread.join()
        self._line.close()


class Lab:
    """The virtual lab with one IRIS+, as a program."""

    def __init__(self, subnet):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("", 0))
            port = str(probe.getsockname()[1])
        fleet = str(ROOT / "launch" / "fleets" / "iris1.yaml")
        options = ["--subnet", subnet, "--stream-port", port]
        self.program = Program(sys.executable, "-m", "risc_simulator.virtual_lab", fleet, *options)
        told = self.program.wait(r"udp://([\d.]+):(\d+)\b.*socket://([\d.]+):(\d+)")[0]
        self.address, self.port = told[1], int(told[2])
        self.line = told[3], int(told[4])


@pytest.fixture
def lab():
    with contextlib.closing(PortReservation()) as reservation:
        lab = Lab(reservation.subnet)
        yield lab
        lab.program.process.terminate()
        lab.program.end()
    assert lab.program.process.returncode == 0, lab.program.output
    assert "Traceback" not in lab.program.output


@pytest.fixture
def transmitter(lab):
    with contextlib.closing(Transmitter(*lab.line)) as transmitter:
        yield transmitter


def complaints(text):
    return [line for line in text.splitlines() if COMPLAINT.search(line)]


@contextlib.contextmanager
def mavproxy(lab, folder):
    program = pathlib.Path(sys.executable).parent / "mavproxy.py"
    assert program.exists(), "MAVProxy is missing: ./maap test --all installs it"
    master = "udpout:%s:%d" % (lab.address, lab.port)
    station = Program(sys.executable, "-u", str(program), "--master", master, "--state-basedir", str(folder))
    try:
        yield station
    finally:
        station.end()


def test_mavproxy(lab, transmitter, tmp_path):
    with mavproxy(lab, tmp_path) as station:
        _, tried_s = station.wait("Waiting for heartbeat")
        _, online_s = station.wait("online system 1")
        assert online_s - tried_s < CONNECTED_S
        count = int(station.wait(r"Received (\d+) parameters")[0][1])
        assert station.ask("status PARAM_VALUE", r"param_count : (\d+)")[1] == str(count)
        for kind, what in (("wp", "waypoints"), ("fence", "fence items"), ("rally", "rally items")):
            station.ask("%s list" % kind, "Requesting 0 %s" % what)

        def height_mm():
            return int(station.poll("status GLOBAL_POSITION_INT", r"GLOBAL_POSITION_INT .*relative_alt : (-?\d+)")[1])

        height_mm()  # if its first request for streams came too early, MAVProxy sends the next one after 15 s
        station.ask("mode ALT_HOLD", "Mode ALT_HOLD")
        station.ask("arm throttle", r"\bARMED")
        transmitter.throttle = 0.6
        end_s = time.monotonic() + PATIENCE_S
        while height_mm() < 600:
            assert time.monotonic() < end_s
        transmitter.throttle = 0.0
        after = len(station.lines)
        station.say("mode LAND")
        station.wait("Mode LAND", after)
        station.wait("DISARMED", after)
    assert not complaints(station.output), station.output

    seen = mavutil.mavlink_connection(str(tmp_path / "mav.tlog"))
    modes, armed = [], []
    while (message := seen.recv_match(type="HEARTBEAT")) is not None:
        if message.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA:
            assert message.get_srcComponent() == 1
            modes.append(message.custom_mode)
            armed.append(bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED))
    # the end may be missing: it is not in its log yet when MAVProxy ends
    assert list(dict.fromkeys(modes)) == [0, 2, 9] and not armed[0] and any(armed)


def test_a_complaint_of_mavproxy_is_found_and_it_finds_the_vehicle_again(lab, tmp_path):
    with mavproxy(lab, tmp_path) as station:
        station.wait("online system 1")
        lab.program.process.send_signal(signal.SIGSTOP)
        try:
            station.wait("link 1 down")
        finally:
            lab.program.process.send_signal(signal.SIGCONT)
        station.wait("link 1 OK")
    assert complaints(station.output)


def test_mavsdk(lab):
    """It flies with its own sticks: no transmitter is on."""
    program = str(ROOT / "tests" / "mavsdk_station.py")
    command = [sys.executable, program, "udpout://%s:%d" % (lab.address, lab.port)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=4 * PATIENCE_S)
    assert done.returncode == 0, done.stdout + done.stderr
    seen = json.loads(done.stdout.splitlines()[-1])
    assert seen["connected_s"] < CONNECTED_S
    assert seen["complaints"] == []
    assert seen["version"] == [4, 5] and seen["sysid_mygcs"] == 255 and seen["parameters"] > 50
    assert seen["mission_items"] == [0, 0, 0] and seen["fix"] == 1 and 0.0 < seen["battery_pct"] <= 100.0
    assert seen["most_m"] > 0.6 and abs(seen["end_m"]) < 0.05
    assert any("Arming" in text for text in seen["texts"]) and any("Disarming" in text for text in seen["texts"])


class QGroundControl:
    """Asks what QGroundControl asks, one thing after the other, each until it is answered."""

    def __init__(self, address, port, version):
        self._dialect = {1: mavlink1, 2: mavlink}[version]
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect((address, port))
        self.mav = self._dialect.MAVLink(types.SimpleNamespace(write=self._socket.send), 255, 190)
        self.texts, self.target, self.version = [], (0, 0), version
        self._waiting = collections.deque()

    def _next(self, patience_s):
        """The next message; None if there is none within patience_s."""
        if not self._waiting:
            self._socket.settimeout(patience_s)
            with contextlib.suppress(TimeoutError):
                self._waiting.extend(self.mav.parse_buffer(self._socket.recv(65536)))
        return self._waiting.popleft() if self._waiting else None

    def close(self):
        self._socket.close()

    def beat(self):
        self.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE)

    def wait(self, name, is_it=lambda message: True, patience_s=CONNECTED_S):
        """The next message of this name for which is_it is true."""
        end_s = time.monotonic() + patience_s
        while (left_s := end_s - time.monotonic()) > 0.0:
            message = self._next(left_s)
            if message is None:
                break
            if message.get_type() == "STATUSTEXT":
                self.texts.append((message.severity, message.text))
            if message.get_type() == name and is_it(message):
                return message
        raise AssertionError("no %s" % name)

    def order(self, command, *params):
        """Send a command. Returns its result."""
        params = [*params, *[0.0] * (7 - len(params))]
        self.mav.command_long_send(*self.target, command, 0, *params)
        return self.wait("COMMAND_ACK", lambda ack: ack.command == command).result

    def request(self, message_id):
        return self.order(mavlink.MAV_CMD_REQUEST_MESSAGE, message_id)

    def connect(self):
        """InitialConnectStateMachine. Returns (version, parameters by name)."""
        self.beat()
        first = self.wait("HEARTBEAT")
        self.target = first.get_srcSystem(), first.get_srcComponent()
        mav = self.mav
        mav.command_long_send(*self.target, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)
        version = self.wait("AUTOPILOT_VERSION")
        assert self.wait("COMMAND_ACK").result == mavlink.MAV_RESULT_ACCEPTED
        protocol_version, standard_modes, component_metadata, component_information = 300, 435, 397, 395
        for message_id in (protocol_version, standard_modes, component_metadata, component_information):
            assert self.request(message_id) == mavlink.MAV_RESULT_UNSUPPORTED
        for stream, rate_hz in ((1, 2), (2, 2), (3, 2), (6, 3), (10, 10), (11, 10), (12, 3)):
            mav.request_data_stream_send(*self.target, stream, rate_hz, 1)
        assert not version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_FTP  # else it would get a file first
        parameters = self.load_parameters()
        kinds = mavlink.MAV_MISSION_TYPE_MISSION, mavlink.MAV_MISSION_TYPE_FENCE, mavlink.MAV_MISSION_TYPE_RALLY
        for kind in kinds if self.version == 2 else kinds[:1]:  # MAVLink 1 knows no others
            said = [kind] if self.version == 2 else []
            mav.mission_request_list_send(*self.target, *said)
            count = self.wait("MISSION_COUNT")
            assert count.count == 0 and getattr(count, "mission_type", 0) == kind
            mav.mission_ack_send(*self.target, mavlink.MAV_MISSION_ACCEPTED, *said)
        return version, parameters

    def load_parameters(self):
        self.mav.param_request_list_send(*self.target)
        found, count = {}, 1
        while len(found) < count:
            value = self.wait("PARAM_VALUE")
            found[value.param_id], count = value.param_value, value.param_count
        return found

    def steer(self, throttle):
        """Send sticks as QGroundControl's joystick does: forward, right, up, clockwise."""
        self.mav.manual_control_send(self.target[0], 0, 0, throttle, 0, 0)


@pytest.mark.parametrize("version", [1, 2])
def test_the_connecting_sequence_of_qgroundcontrol_and_a_flight_by_its_joystick(lab, version):
    with contextlib.closing(QGroundControl(lab.address, lab.port, version)) as station:
        fly_by_joystick(station)


def fly_by_joystick(station):
    start_s = time.monotonic()
    told, parameters = station.connect()
    assert time.monotonic() - start_s < CONNECTED_S
    assert told.flight_sw_version >> 24 == 4
    wanted = "FRAME_CLASS FRAME_TYPE FLTMODE1 COMPASS_DEV_ID INS_ACCOFFS_X BATT_MONITOR FS_GCS_ENABLE RC1_MIN RTL_ALT"
    assert set(wanted.split()) <= set(parameters)
    for command in (mavlink.MAV_CMD_REQUEST_CAMERA_INFORMATION, mavlink.MAV_CMD_REQUEST_STORAGE_INFORMATION, 528):
        assert station.order(command, 1) == mavlink.MAV_RESULT_UNSUPPORTED
    health = station.wait("SYS_STATUS")
    missing = health.onboard_control_sensors_enabled & ~health.onboard_control_sensors_health
    waits_for_sticks = mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER | mavlink.MAV_SYS_STATUS_PREARM_CHECK
    assert not missing & ~waits_for_sticks

    def until(what, name, is_it, throttle):
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            station.beat()
            station.steer(throttle)
            with contextlib.suppress(AssertionError):
                return station.wait(name, is_it, 0.05)
        raise AssertionError("%s; it has said: %r" % (what, station.texts))

    healthy = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    until("ready", "SYS_STATUS", lambda m: m.onboard_control_sensors_health & healthy, 0)
    assert station.order(mavlink.MAV_CMD_DO_SET_MODE, 1, 2) == mavlink.MAV_RESULT_ACCEPTED
    assert station.order(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mavlink.MAV_RESULT_ACCEPTED
    until("armed", "HEARTBEAT", lambda m: m.base_mode == 209 and m.custom_mode == 2, 0)
    until("take-off", "GLOBAL_POSITION_INT", lambda m: m.relative_alt > 600, 800)
    assert station.order(mavlink.MAV_CMD_DO_SET_MODE, 1, 9) == mavlink.MAV_RESULT_ACCEPTED
    until("landed", "HEARTBEAT", lambda m: m.base_mode == 81 and m.custom_mode == 9, 500)
    severities = [severity for severity, _ in station.texts]
    assert severities and all(severity > mavlink.MAV_SEVERITY_WARNING for severity in severities), station.texts
