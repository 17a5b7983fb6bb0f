"""dueppm on this computer: its parts and a fuzzer under sanitizers, the library of the virtual lab, messages of ROS."""

import io
import itertools
import re
import struct
import subprocess

import due
import pytest

from risc_simulator.vehicles.iris.transmitter import Board
from rosserial_python import protocol

SANITIZERS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
WARNINGS = ["-Wall", "-Wextra", "-Wconversion", "-Werror"]
HEADERS = sorted((due.FIRMWARE / "dueppm").glob("*.h"))
CONTROLS, PPM_STATUS = 100, 125
# what the protocol's description gives as examples
REQUEST_TOPICS = bytes.fromhex("fffe0000ff0000ff")
TX_STOP = bytes.fromhex("fffe0000ff0b00f4")
TIME_REQUEST = bytes.fromhex("fffe0800f70a000000000000000000f5")


def compiled(folder, name, *options, standard="gnu++11"):
    """A program of firmware/test with sanitizers. options: also further sources."""
    program = folder / name
    source = due.FIRMWARE / "test" / (name + ".cpp")
    # Not optimized, with little for a debugger: they run for seconds, and compiling would take a multiple of that.
    command = ["g++", "-std=" + standard, "-g1", "-O0", *WARNINGS[:2], "-Werror", *SANITIZERS, "-o", str(program)]
    subprocess.run([*command, str(source), *options], check=True)
    return program


@pytest.fixture(scope="module")
def fuzz(tmp_path_factory):
    program = compiled(tmp_path_factory.mktemp("fuzz"), "fuzz")

    def run(*arguments):
        done = subprocess.run([str(program), *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        print(done.stdout)
        return done

    return run


def test_the_parts_do_what_they_are_for(tmp_path):
    program = compiled(tmp_path, "test_firmware", "-lgtest", "-lgtest_main", "-pthread", standard="gnu++14")  # gtest's
    done = subprocess.run(
        [str(program), "--gtest_brief=1"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert done.returncode == 0, done.stdout[-4000:]
    assert int(re.search(r"PASSED  \] (\d+) tests", done.stdout)[1]) >= 30


def test_damaged_bytes_move_no_channel_beyond_its_bounds(fuzz):
    done = fuzz("2000000", "1")
    assert done.returncode == 0, done.stdout[-4000:]
    seen = {what: int(count) for count, what in re.findall(r"(\d+) (noisy bytes|damaged messages)", done.stdout)}
    assert seen["damaged messages"] > 100 and seen["noisy bytes"] >= 2000000, "or nothing was tried"


@pytest.mark.release
def test_a_hundred_million_damaged_bytes_move_no_channel_beyond_its_bounds(fuzz):
    done = fuzz("100000000", "2")
    assert done.returncode == 0, done.stdout[-4000:]


def test_they_would_without_the_checks(fuzz):
    """The control arm: as if each message that its checksums let pass were believed at once."""
    done = fuzz("2000000", "1", "--unprotected")
    assert done.returncode == 1 and "BROKEN: us from the command" in done.stdout, done.stdout[-4000:]


@pytest.mark.parametrize("steps", ["20000", pytest.param("500000", marks=pytest.mark.release)], ids=["small", "large"])
def test_the_library_of_the_lab_survives_any_calls(tmp_path, steps):
    program = compiled(tmp_path, "fuzz_host", str(due.FIRMWARE / "host/dueppm_host.cpp"))
    done = subprocess.run([str(program), steps, "3"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    print(done.stdout)
    assert done.returncode == 0, done.stdout[-4000:]
    seen = {what: int(count) for count, what in re.findall(r"(\d+) ([a-z ]+)", done.stdout)}
    assert min(seen["frames"], seen["commanded frames"], seen["packets"], seen["resets"]) > 50, "or nothing was tried"


@pytest.mark.parametrize("header", HEADERS, ids=lambda path: path.name)
def test_each_header_compiles_alone(header):
    flags = ["-std=gnu++11", "-fno-exceptions", "-fno-rtti", *WARNINGS, "-fsyntax-only", "-x", "c++"]
    done = subprocess.run(["g++", *flags, "-include", str(header), "/dev/null"], stderr=subprocess.PIPE, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "constants, says",
    [
        ({"kChannels": 9}, "kChannels: 4 to 8"),
        ({"kChannels": 3}, "kChannels: 4 to 8"),
        ({"kFrameUs": 19999}, "kFrameUs: 20000 to 22500"),
        ({"kFrameUs": 25000}, "kFrameUs: 20000 to 22500"),
        ({"kPulseUs": 900}, "kPulseUs: 250 to 400"),
        ({"kChannels": 8, "kLongestUs": 2150}, "the channels do not fit"),
        ({"kYawChannel": 5}, "kYawChannel: 1 to kChannels"),
        ({"kYawChannel": 3}, "two sticks on one channel"),
        ({"kFailsafeMs": 10}, "kFailsafeMs: at least four frames"),
        ({"kFailsafeThrottleUs": 800}, "kFailsafeThrottleUs: kShortestUs to kLongestUs"),
        ({"kThrottleTravelUs": -500}, "kFailsafeThrottleUs: at the throttle's lowest end"),
        ({"kThrottleTravelUs": -500, "kFailsafeThrottleUs": 1999}, "kFailsafeThrottleUs: at the throttle's lowest end"),
        ({"kFailsafeThrottleUs": 1500}, "kFailsafeThrottleUs: at the throttle's lowest end"),
        ({"kFailsafeThrottleUs": 1001}, "kFailsafeThrottleUs: at the throttle's lowest end"),
        ({"kThrottleTravelUs": 0}, "kFailsafeThrottleUs: at the throttle's lowest end"),
        ({"kJump": 0}, "kJump: above 0"),
        ({"kSlewUsPerS": 0}, "kSlewUsPerS"),
    ],
    ids=lambda value: "-".join(map(str, itertools.chain(*value.items()))) if isinstance(value, dict) else "",
)
def test_a_configuration_that_does_not_fit_does_not_compile(tmp_path, constants, says):
    done = syntax_checked(tmp_path, constants)
    assert done.returncode != 0
    assert says in done.stderr


@pytest.mark.parametrize(
    "constants",
    [
        {"kThrottleTravelUs": -500, "kFailsafeThrottleUs": 2050},
        {"kThrottleTravelUs": -500, "kFailsafeThrottleUs": 2000},
        {"kFailsafeThrottleUs": 1000},
    ],
    ids=str,
)
def test_a_failsafe_at_the_lowest_end_of_the_throttle_compiles(tmp_path, constants):
    done = syntax_checked(tmp_path, constants)
    assert done.returncode == 0, done.stderr


def syntax_checked(folder, constants):
    """CompletedProcess of the compiler for a sketch with these constants."""
    sketch = due.configured(folder, **constants)
    program = folder / "main.cpp"
    program.write_text('#include "dueppm/firmware.h"\ndueppm::Firmware<dueppm::Configuration> firmware;\n')
    command = ["g++", "-std=gnu++11", "-fsyntax-only", "-I", str(sketch.parent), str(program)]
    return subprocess.run(command, stderr=subprocess.PIPE, text=True)


# --- the library, and messages of ROS


@pytest.fixture
def board():
    board = Board()
    board.advance(0.1)
    yield board
    board.close()


def packets(data):
    found = []
    while len(data) >= protocol.OVERHEAD:
        length = struct.unpack_from("<H", data, 2)[0] + protocol.OVERHEAD
        packet, data = data[:length], data[length:]
        if len(packet) == length:
            topic_id = struct.unpack_from("<H", packet, 5)[0]
            assert packet == protocol.encode(topic_id, packet[7:-1])
            found.append((topic_id, packet[7:-1]))
    return found


def text(value):
    return struct.pack("<I", len(value)) + value.encode()


def test_golden_bytes_of_the_protocol(board):
    board.receive(REQUEST_TOPICS)
    board.advance(0.14)
    sent = board.sent()
    assert sent.startswith(TIME_REQUEST)
    messages = pytest.importorskip("risc_maap_msgs.msg"), pytest.importorskip("risc_msgs.msg")
    published = struct.pack("<H", 125) + text("ppm_status") + text("risc_maap_msgs/PpmStatus")
    published += text(messages[0].PpmStatus._md5sum) + struct.pack("<i", 512)
    subscribed = struct.pack("<H", 100) + text("controls") + text("risc_msgs/Controls")
    subscribed += text(messages[1].Controls._md5sum) + struct.pack("<i", 512)
    assert packets(sent) == [(10, bytes(8)), (1, subscribed), (0, published)]
    board.advance(1.0)
    assert PPM_STATUS in dict(packets(board.sent()))
    board.receive(TX_STOP)
    board.advance(1.1)
    board.sent()
    board.advance(3.0)
    assert board.sent() == b""


def test_messages_of_ros_move_the_channels_and_its_status_is_one(board):
    controls, status = pytest.importorskip("risc_msgs.msg"), pytest.importorskip("risc_maap_msgs.msg").PpmStatus
    board.receive(REQUEST_TOPICS)
    time_s = 0.1

    def fly(count, **sticks):
        nonlocal time_s
        for _ in range(count):
            message = controls.Controls(Obj=[controls.Control(name="IRIS", **sticks)])
            message.header.frame_id = "cortex"
            stream = io.BytesIO()
            message.serialize(stream)
            board.receive(protocol.encode(CONTROLS, stream.getvalue()))
            time_s += 0.022
            board.advance(time_s)

    fly(6, T=-1)
    fly(15, phi=0.5, theta=-0.25, psi=0.1, T=0.2)
    board.receive(protocol.encode(10, struct.pack("<II", 1_700_000_000, 500_000_000)))
    fly(6, phi=0.5, theta=-0.25, psi=0.1, T=0.2)
    (*_, payload) = (payload for topic_id, payload in packets(board.sent()) if topic_id == PPM_STATUS)
    message = status().deserialize(payload)
    assert message.state == status.FLYING
    assert list(message.channels_us) == [1750, 1375, 1600, 1550]
    assert 15 < message.accepted <= 25 and message.refused == message.damaged_packets == 0
    assert 0 <= message.age_s < 0.05
    asked_s, answered_s, told_s = 0.1014, 0.5648, 0.6  # of the board's clock; 8 bytes after 0.1 s, 16 after 0.562 s
    expected_s = 1_700_000_000.5 + (answered_s - asked_s) / 2 + told_s - answered_s
    assert message.header.stamp.to_sec() == pytest.approx(expected_s, abs=0.003)
    begins = [ticks / 42 for ticks, level in board.edges() if level == 0]
    assert [round(after - before) for before, after in itertools.pairwise(begins[-11:])].count(1750) == 2


def test_numbers_of_the_message_are_those_of_the_firmware():
    status = pytest.importorskip("risc_maap_msgs.msg").PpmStatus
    source = "".join(path.read_text(encoding="utf-8") for path in HEADERS)
    for kind, names in (
        ("State", ("WAITING", "LOCKED", "FLYING", "FAILSAFE")),
        ("Refusal", ("NOTHING", "FORMAT", "VEHICLE", "RANGE", "JUMP")),
    ):
        body = re.search(r"enum class %s : uint8_t {([^}]+)}" % kind, source)[1]
        numbers = {name.upper(): int(number) for name, number in re.findall(r"k(\w+) = (\d+)", body)}
        assert numbers == {name: getattr(status, name) for name in names}
