"""What comes from the wire, damaged: each parser gets 1e5 inputs in the first tier and 1e7 in the second.

No input may raise, hang or fill the memory, and what the parser accepts must pass the checks that are repeated here.
Each parser has a control arm: with one of its checks removed, the same inputs must be noticed. `./maap fuzz` runs the
decoder of Cortex for longer.
"""

import itertools
import json
import math
import pathlib
import re
import shutil
import struct
import subprocess

import pytest
from fuzzing import damaged
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from ardrone_autonomy.link import DroneLink
from ardrone_autonomy.protocol import navdata, video
from ardrone_autonomy.protocol.at import SIGNATURES
from ardrone_autonomy.protocol.config import KEYS
from risc_simulator.vehicles.ardrone import profiles, wire
from risc_simulator.vehicles.ardrone.wire import NavdataEncoder, parse_datagram
from risc_simulator.video.stream_writer import StreamWriter
from roscopter.autopilot import Autopilot
from roscopter.options import Options
from roscopter.wire import FrameReader
from rosserial_python import protocol

ROOT = pathlib.Path(__file__).resolve().parents[1]
CORTEX = ROOT / "src/cortex_ros"
GOLDEN = ROOT / "src/drivers/ardrone_autonomy/test/golden"
FEW, MANY = 100_000, 10_000_000
PERIOD_S = 0.005  # between inputs, for what keeps time


def fuzz_cortex_decoder(package, runs, build):
    return subprocess.run(
        [str(package / "test/fuzz/run.sh"), str(runs), str(build)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    )


def test_cortex_decoder_survives_a_bounded_run(tmp_path, inputs):
    """C++, under the address and undefined-behaviour sanitizers, with coverage-guided inputs."""
    runs = inputs(FEW, MANY)
    done = fuzz_cortex_decoder(CORTEX, runs, tmp_path)
    assert done.returncode == 0, done.stdout[-4000:]
    finished = re.search(r"Done (\d+) runs", done.stdout)
    assert finished and int(finished.group(1)) >= runs, done.stdout[-2000:]


def test_cortex_decoder_without_its_length_check_is_noticed(tmp_path):
    """The control arm, on a changed copy: the decoder has no macro that leaves the check out."""
    package = tmp_path / "cortex_ros"
    for folder in ("include", "src", "test"):
        shutil.copytree(CORTEX / folder, package / folder)
    source = package / "src/protocol.cpp"
    sound = source.read_text(encoding="utf-8")
    assert sound.count("if (size > left_) {") == 1
    source.write_text(sound.replace("if (size > left_) {", "if (false) {"), encoding="utf-8")
    done = fuzz_cortex_decoder(package, FEW, tmp_path / "build")
    assert done.returncode != 0 and "ERROR: AddressSanitizer: heap-" in done.stdout, done.stdout[-4000:]


class NoticedError(AssertionError):
    """A parser has accepted a bad input."""


def check(condition, what, data):
    if not condition:
        raise NoticedError("%s: %r" % (what, data))


class Parser:
    """A parser and its inputs. sabotage: what monkeypatch sets for the control arm."""

    accepted = 0  # number of inputs that it took for valid: without any, nothing would be tested
    repair = None  # see fuzzing.damaged


class At(Parser):
    """Commands to an aircraft, and the configuration that they write."""

    def __init__(self):
        texts = [command["text"] for command in json.loads((GOLDEN / "at_commands.json").read_text())]
        self.packets = ["\r".join([*texts[k : k + 2], ""]).encode() for k in range(len(texts))]
        self.packets.append(b'AT*CONFIG=1,"control:euler_angle_max","0.3"\rAT*CONFIG=2,"control:outdoor","TRUE"\r')

    def take(self, data):
        commands, malformed = parse_datagram(data)
        check(len(commands) + malformed <= 1 + len(re.findall(b"[\r\n\0]", data)), "more commands than lines", data)
        self.accepted += len(commands)
        for name, sequence, arguments in commands:
            check(re.fullmatch(r"[A-Z][A-Z0-9_]*", name) and 0 <= sequence < 2**32, "a name or number", data)
            for kind, value in zip(SIGNATURES.get(name, ""), arguments, strict=name in SIGNATURES):
                check(isinstance(value, {"i": int, "f": float, "s": str}[kind]), "an argument", data)
                check(kind != "f" or math.isfinite(value), "a stick that is not a number", data)

    sabotage = (wire, "int_to_float", lambda pattern: struct.unpack("<f", struct.pack("<I", pattern & 0xFFFFFFFF))[0])


class Configuration(Parser):
    """Values that a client writes."""

    LIMITS = {"control:euler_angle_max": (0.0, 0.52), "control:control_yaw": (0.0, 6.11)}  # of flying

    def __init__(self):
        defaults = [(key, "%s" % (spec.default,)) for key, spec in KEYS.items()]
        ranges = [(key, "%g" % (2.0 * limits[1])) for key, limits in profiles.RANGES.items()]
        ids = [("custom:%s_id" % kind, text) for kind in ("session", "profile") for text in ("12345678", "-all", "-")]
        self.packets = [("%s\0%s" % item).encode() for item in defaults + 3 * ranges + 5 * ids]
        self._store, self._turn = profiles.ConfigurationStore(), itertools.count()

    def take(self, data):
        key, _, text = data.decode("latin-1").partition("\0")
        if self._store.write(key, text, None if len(data) % 2 else self._store.current_ids):
            self.accepted += 1
            key = key.strip().lower()
            value = self._store.get(key)
            check(isinstance(value, KEYS[key].kind), "a value of another kind", data)
            low, high = self.LIMITS.get(key, (-math.inf, math.inf))
            check(key not in self.LIMITS or low <= value <= high, "a limit of flying", data)
            check(not isinstance(value, float) or math.isfinite(value), "a value that is not a number", data)
        if next(self._turn) % 10_000 == 0:
            whole = self._store.text()
            check(whole.count(b"\n") == len(KEYS) and whole.count(b"\0") == 1, "a line that is none", whole)
            check(len(self._store.custom_ids_text()) < 20_000, "ids without end", data)

    sabotage = (profiles, "RANGES", {})


class Navdata(Parser):
    """Telemetry, and what the driver answers to it."""

    def __init__(self):
        texts = [re.sub("#.*", "", path.read_text()) for path in sorted(GOLDEN.glob("navdata_*.hex"))]
        self.packets = [bytes.fromhex(text) for text in texts]
        for tags in ([navdata.Tag.DEMO, navdata.Tag.TIME], navdata.ALL_TAGS[:12], navdata.ALL_TAGS[12:]):
            self.packets.append(NavdataEncoder(tags).finish(0x0F800400, 7))
        self._link = DroneLink(
            self._on_command, lambda data: None, [("general:navdata_demo", "FALSE")], "0badcafe", 0.0
        )
        self._now_s = 0.0

    @staticmethod
    def repair(data):
        if len(data) > 8:
            data[-8:] = struct.pack("<HHI", 0xFFFF, 8, sum(data[:-8]) & 0xFFFFFFFF)

    def take(self, data):
        self._now_s += PERIOD_S
        self._link.on_navdata(data, self._now_s)
        if self._now_s >= self._link.due_s:
            self._link.poll(self._now_s)
        try:
            packet = navdata.Navdata(data)
        except navdata.NavdataError:
            return
        end, at = len(data), 16
        tag, size = struct.unpack_from("<HH", data, at)
        while at + size + 4 <= end and size and not (tag == 0xFFFF and size >= 8):
            at += size
            tag, size = struct.unpack_from("<HH", data, at)
        check(data[at + 4 : at + 8] == struct.pack("<I", sum(data[:at]) & 0xFFFFFFFF), "a wrong checksum", data)
        self.accepted += 1
        for tag in (navdata.Tag.DEMO, self.accepted % len(navdata.ALL_TAGS)):
            try:
                packet.option(tag)
            except navdata.NavdataError:
                continue

    def _on_command(self, data):
        commands, malformed = parse_datagram(data)
        check(commands and not malformed, "an order that is none", data)
        for name, _, arguments in commands:
            check(name != "REF" or not arguments[0] & 0x200, "a take-off that was not ordered", data)
            check(name != "PCMD_MAG" or not any(arguments[1:]), "sticks that were not moved", data)

    class _Believing:
        size = 8

        @staticmethod
        def unpack_from(data, offset):
            return 0xFFFF, 8, sum(data[:offset]) & 0xFFFFFFFF

    sabotage = (navdata, "CHECKSUM_OPTION", _Believing)


class Pave(Parser):
    """The stream of pictures."""

    LARGEST = 1 << 20

    def __init__(self):
        writer, unit = StreamWriter(), b"\0\0\0\1\x41\x9a\x00\x7f"
        self.packets = [writer.picture(unit + bytes(50 * k), 33 * k) for k in range(8)]
        header = video.parse_header(self.packets[0])
        for k in range(3):
            part = header._replace(total_chunks=3, chunk_index=k, frame_number=99)
            self.packets.append(video.pack_header(part) + self.packets[0][header.header_bytes :])
        self._parser, self._assembler = video.StreamParser(), video.FrameAssembler()

    def take(self, data):
        for packet in self._parser.feed(data):
            self.accepted += 1
            check(len(packet.payload) == packet.header.following_bytes <= self.LARGEST, "a payload", data)
            whole = self._assembler.add(packet)
            check(whole is None or len(whole.payload) <= self.LARGEST, "a picture", data)
        check(len(self._parser._buffer) <= self.LARGEST + 256, "bytes that wait", data)

    sabotage = (video, "MAX_PAYLOAD_BYTES", 1 << 32)


class Mavlink(Parser):
    """Telemetry of an autopilot, and what the driver answers."""

    def __init__(self):
        self.packets = []
        for version, system in itertools.product((1, 2), (1, 1, 1, 7)):
            packer = mavlink.MAVLink(None, system, 1)
            for message in (
                mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3),
                mavlink.MAVLink_attitude_message(1000, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0),
                mavlink.MAVLink_statustext_message(6, b"PreArm: nothing"),
                mavlink.MAVLink_command_ack_message(400, 0),
                mavlink.MAVLink_rc_channels_raw_message(1000, 0, *[1500] * 8, 255),
                mavlink.MAVLink_param_value_message(b"SYSID_MYGCS", 255.0, 9, 300, 7),
            ):
                self.packets.append(bytes(message.pack(packer, force_mavlink1=version == 1)))
        self._autopilot = Autopilot(Options(enable_rc_control=True), self._on_written, lambda level, text: None)
        self._autopilot.opened(0.0)
        self._now_s = 0.0
        for data in self.packets[:2]:
            self.take(data)

    @staticmethod
    def _sum(frame):
        """The correct checksum of a frame; None if the message is not known."""
        head, number = (6, frame[5]) if frame[0] == 0xFE else (10, int.from_bytes(frame[7:10], "little"))
        known = mavlink.mavlink_map.get(number)
        if known is None:
            return None
        crc = 0xFFFF
        for byte in (*frame[1 : head + frame[1]], known.crc_extra):
            step = (byte ^ crc) & 0xFF
            step = (step ^ step << 4) & 0xFF
            crc = (crc >> 8) ^ (step << 8) ^ (step << 3) ^ (step >> 4)
        return crc

    @classmethod
    def repair(cls, data):
        if len(data) > 12 and data[0] in (0xFE, 0xFD):
            end = data[1] + (6 if data[0] == 0xFE else 10)
            crc = cls._sum(data) if end + 2 <= len(data) else None
            if crc is not None:
                data[end : end + 2] = crc.to_bytes(2, "little")

    def take(self, data):
        self._now_s += PERIOD_S
        for message in self._autopilot.receive(data, self._now_s):
            self.accepted += 1
            frame = bytes(message.get_msgbuf())
            end = frame[1] + (6 if frame[0] == 0xFE else 10)
            check(frame[end : end + 2] == self._sum(frame).to_bytes(2, "little"), "a wrong checksum", frame)
            check((message.get_srcSystem(), message.get_srcComponent()) == (1, 1), "another vehicle", frame)
        check(len(self._autopilot.reader._rest) <= 300, "bytes that wait", data)
        if self._now_s % 0.05 < PERIOD_S:
            self._autopilot.poll(self._now_s)

    def _on_written(self, data):
        for message in FrameReader().feed(data, 0.0):
            kind = message.get_type()
            check(kind in ("HEARTBEAT", "REQUEST_DATA_STREAM", "COMMAND_LONG"), "what was not ordered", data)
            check(kind != "COMMAND_LONG" or message.command == 511, "an order that was not given", data)

    _meets = Autopilot._meets
    sabotage = (Autopilot, "_meets", lambda self, heartbeat: Mavlink._meets(self, heartbeat) or True)


class Rosserial(Parser):
    """Packets of a board, and what they say of themselves."""

    def __init__(self):
        topic = struct.pack("<H", 125) + b"".join(
            struct.pack("<I", len(text)) + text for text in (b"ppm_status", b"std_msgs/UInt32", b"0" * 32)
        )
        self.contents = {
            protocol.Id.PUBLISHER: topic + struct.pack("<i", 280),
            protocol.Id.LOG: b"\2" + struct.pack("<I", 5) + b"hello",
            protocol.Id.PARAMETER: struct.pack("<I", 5) + b"~rate",
            protocol.Id.TIME: bytes(8),
            125: struct.pack("<I", 7),
        }
        self.packets = [protocol.encode(number, content) for number, content in self.contents.items()]
        self._decoder, self._now_s, self._recent = protocol.Decoder(), 0.0, b""

    @staticmethod
    def repair(data):
        if len(data) >= 8:
            length = len(data) - 8
            data[:4] = b"\xff\xfe" + struct.pack("<H", length)
            data[4] = 255 - sum(data[2:4]) % 256
            data[-1] = 255 - sum(data[5:-1]) % 256

    def take(self, data):
        self._now_s += PERIOD_S
        self._recent = (self._recent + data)[-8192:]
        for topic_id, payload in self._decoder.feed(data, self._now_s):
            self.accepted += 1
            body = struct.pack("<H", topic_id) + payload
            length = struct.pack("<H", len(payload))
            sums = 255 - sum(length) % 256, 255 - sum(body) % 256
            check(
                b"\xff\xfe%b%c%b%c" % (length, sums[0], body, sums[1]) in self._recent, "a packet that none sent", data
            )
            for read in (protocol.topic_of, protocol.log_of, protocol.name_of):
                try:
                    said = read(payload)
                except protocol.PayloadError:
                    continue
                check(read is not protocol.topic_of or said.topic_id >= 100 and said.buffer_bytes > 0, "a topic", data)
        check(len(self._decoder._bytes) <= 2048 + 8, "bytes that wait", data)

    sabotage = (protocol, "sum", lambda data: 255)  # every checksum fits


PARSERS = [At, Configuration, Navdata, Pave, Mavlink, Rosserial]


def fuzz(make, count):
    parser = make()
    for data in damaged(parser.packets, count, parser.repair):
        parser.take(data)
    assert parser.accepted > count // 100


@pytest.mark.parametrize("parser", PARSERS)
def test_damaged_packets_do_no_harm(parser, inputs):
    fuzz(parser, inputs(FEW, MANY))


@pytest.mark.parametrize("parser", PARSERS)
def test_without_one_check_they_are_noticed(parser, monkeypatch):
    """The control arm."""
    monkeypatch.setattr(*parser.sabotage, raising=False)
    with pytest.raises(NoticedError):
        fuzz(parser, FEW)
