"""cortex_dump as a program: files, faults, exit codes. Needs the built workspace, no ROS master."""

import contextlib
import io
import json
import os
import pathlib
import runpy
import socket
import struct
import subprocess
import sys
import threading
from collections import namedtuple

import numpy as np
import pytest

from cortex_ros import connection, wire
from cortex_ros.wire import Command

GOLDEN = pathlib.Path(__file__).parent / "golden"


def find_program():
    for prefix in os.environ.get("CMAKE_PREFIX_PATH", "").split(":"):
        program = pathlib.Path(prefix) / "lib" / "cortex_ros" / "cortex_dump"
        if prefix and program.exists():
            return str(program)
    return None


PROGRAM = find_program()


NODE = runpy.run_path(str(pathlib.Path(__file__).parents[1] / "nodes" / "cortex_dump"))


def dump(*arguments, stdin=b""):
    """Run main() in this process. Returns (exit code, JSON objects of the output lines, text of standard error)."""
    out, error = io.TextIOWrapper(io.BytesIO(), encoding="utf-8"), io.StringIO()
    with pytest.MonkeyPatch.context() as call:
        call.setattr(sys, "argv", ["cortex_dump", *arguments])
        call.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin)))
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
            try:
                code = NODE["main"]()
            except SystemExit as ended:
                code = ended.code
    return code, [json.loads(line) for line in out.buffer.getvalue().splitlines()], error.getvalue()


def dump_process(*arguments, stdin=b""):
    """As dump(), but in a process of its own, without a ROS master."""
    assert PROGRAM, "cortex_dump is not built: run ./maap test, which builds and finds it"
    environment = {key: value for key, value in os.environ.items() if not key.startswith("ROS_MASTER")}
    done = subprocess.run([PROGRAM] + list(arguments), input=stdin, capture_output=True, env=environment, timeout=60)
    return done.returncode, [json.loads(line) for line in done.stdout.splitlines()], done.stderr.decode()


@pytest.mark.parametrize("path", sorted(GOLDEN.glob("*.bin")), ids=lambda path: path.stem)
def test_golden_packets(path):
    code, packets, _ = dump("--file", str(path))
    expected = json.loads(path.with_suffix(".json").read_text())
    assert code == 0
    assert len(packets) == 1
    packet = packets[0]
    if "frame_of_data" in expected:
        check_frame(packet, expected["frame_of_data"], base_layout="base_layout" in path.stem)
    elif "bodydefs" in expected:
        assert packet["type"] == "bodydefs"
        assert packet["bodies"] == expected["bodydefs"]["bodies"]
        assert packet["analog_channels"] == expected["bodydefs"]["analogChannels"]
        assert packet["force_plates"] == expected["bodydefs"]["nForcePlates"]
    elif "version" in expected:
        assert packet["type"] == {0: "hello_world", 2: "here_i_am"}[expected["command"]]
        assert (packet["name"], packet["version"]) == (expected["name"], expected["version"])
    elif "string" in expected:
        assert packet["type"] == {3: "comment", 14: "general_request"}[expected["command"]]
        assert packet["text"] == expected["string"]
    else:
        assert (
            packet["type"]
            == {10: "request_bodydefs", 12: "request_frame", 15: "general_reply", 16: "unrecognized_request"}[
                expected["command"]
            ]
        )
        assert packet.get("as_float") == expected.get("as_float")


def check_frame(packet, expected, base_layout):
    assert packet["type"] == "frame"
    assert packet["frame"] == expected["frame"]
    assert packet["delay_s"] == (None if base_layout else expected["delay"])
    assert packet["unidentified"] == expected["unidentified"]
    assert len(packet["bodies"]) == expected["nBodies"]
    for body, wanted in zip(packet["bodies"], expected["bodies"]):
        markers = [None if i in wanted["missing_markers"] else xyz for i, xyz in enumerate(wanted["markers"])]
        assert body == {
            "name": wanted["name"],
            "markers": markers,
            "segments": wanted["segments"],
            "dofs": wanted["dofs"],
        }
    assert packet["analog"]["data"] == expected["analog"]["samples"]
    assert packet["forces"]["data"] == expected["forces"]["data"]
    assert packet["faults"] == []


def test_several_packets_in_one_file():
    paths = sorted(GOLDEN.glob("*.bin"))
    code, packets, _ = dump_process("--file", "-", stdin=b"".join(path.read_bytes() for path in paths))
    assert code == 0
    assert len(packets) == len(paths)


def test_a_malformed_packet_is_reported_and_the_next_one_read():
    bad = struct.pack("<HHii", 13, 8, 7, -1)
    good = (GOLDEN / "comment.bin").read_bytes()
    code, packets, _ = dump_process("--file", "-", stdin=bad + good)
    assert code == 1
    assert "-1 bodies" in packets[0]["error"]
    assert packets[1] == {"type": "comment", "text": "hello from the host"}


@pytest.mark.parametrize("content", [b"", b"\x0d", b"\x0d\x00\xff\xff\x00", b"\x0d\x00\x00\x00"])
def test_faulty_files(content):
    code, packets, _ = dump("--file", "-", stdin=content)
    assert code == 1
    assert len(packets) == 1
    assert list(packets[0]) == ["error"]


def test_missing_file(tmp_path):
    for path in (tmp_path / "nothing.bin", tmp_path):
        code, packets, _ = dump("--file", str(path))
        assert code == 1
        assert str(path) in packets[0]["error"]


def test_names_that_are_not_utf8():
    code, packets, _ = dump_process("--file", "-", stdin=struct.pack("<HH", 3, 3) + b'\xe9"\0')
    assert code == 0
    assert packets == [{"type": "comment", "text": '\u00e9"'}]


def test_wrong_use():
    wrong = (["--frobnicate"], ["--mode", "steam"], ["--command-port", "0"], ["--count"], ["--count", "x"])
    for arguments in (*wrong, [], ["--bodies"]):  # the last two name no host
        code, packets, error = dump(*arguments)
        assert code == 2
        assert packets == []
        assert "usage" in error


def test_help():
    done = subprocess.run([PROGRAM, "--help"], stdout=subprocess.PIPE, timeout=60)
    assert done.returncode == 0
    assert b"--file" in done.stdout


def test_a_reader_that_leaves_is_no_trouble_with_a_host(tmp_path):
    packets = tmp_path / "packets.bin"
    packets.write_bytes(2000 * next(GOLDEN.glob("*.bin")).read_bytes())
    with subprocess.Popen([PROGRAM, "--file", str(packets)], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as program:
        assert program.stdout.readline()
        program.stdout.close()
        assert program.stderr.read() == b""
    assert program.returncode == 1


def test_a_host_that_goes_away_while_it_is_polled_is_waited_for_and_then_told():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(("127.0.0.1", 0))
        port = host.getsockname()[1]

        def serve():
            identity = wire.encode_identity(Command.HERE_I_AM, wire.Identity("Cortex", (1, 5, 3, 1)))
            packet, _ = wire.FrameEncoder([("body", 1)]).encode(7, np.ones((1, 3)))
            polled = False
            while not polled:
                request, client = host.recvfrom(1000)
                polled = request[0] == Command.REQUEST_FRAME
                host.sendto(packet if polled else identity, client)
            host.close()  # later packets are refused by its computer

        thread = threading.Thread(target=serve)
        thread.start()
        code, packets, error = dump_process(
            "--host", "127.0.0.1", "--command-port", str(port), "--mode", "poll", "--timeout", "3"
        )
        thread.join()
    assert code == 1
    assert [packet["frame"] for packet in packets] == [7]
    assert "127.0.0.1:%d for 3 s" % port in error


def test_every_network_is_asked(monkeypatch):
    card = namedtuple("Card", "family address broadcast")
    cards = {
        "lo": [card(socket.AF_INET, "127.0.0.1", None)],
        "eth0": [card(socket.AF_INET, "10.0.0.2", "10.0.0.255"), card(socket.AF_PACKET, "02:00", "ff:ff:ff:ff:ff:ff")],
        "eth1": [card(socket.AF_INET, "192.0.2.2", "192.0.2.127")],
    }
    monkeypatch.setattr(connection.psutil, "net_if_addrs", lambda: cards)
    assert connection.broadcast_addresses() == ["255.255.255.255", "10.0.0.255", "192.0.2.127"]
    assert connection.broadcast_addresses("192.0.2.2") == ["255.255.255.255", "192.0.2.127"]
    assert connection.broadcast_addresses("127.0.0.1") == ["255.255.255.255", "127.255.255.255"]


def test_a_host_is_found_by_broadcast():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(("", 0))
        port = host.getsockname()[1]

        def serve():
            _, client = host.recvfrom(1000)
            for name, program in (("Other", 7), ("Cortex", 1)):
                identity = wire.Identity(name, (program, 5, 3, 1))
                host.sendto(wire.encode_identity(Command.HERE_I_AM, identity), client)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        identity = wire.Identity("test", (4, 1, 0, 0))
        connected = connection.CortexConnection(identity, connection.BROADCAST, port, "127.0.0.1")
        with contextlib.closing(connected) as found:
            assert found.hello().name == "Cortex"
            assert found.address == ("127.0.0.1", port)
        thread.join()


def test_a_host_that_does_not_answer():
    code, packets, error = dump(
        "--host", "127.0.0.1", "--command-port", "9", "--stream-port", "50321", "--timeout", "0.3"
    )
    assert code == 1
    assert packets == []
    assert "127.0.0.1:9 " in error


def test_a_flood_does_not_keep_it_from_going_on(monkeypatch):
    """It discards waiting datagrams while more come than it can read. Control arm: without a limit it never ends."""
    talk, read = connection.CortexConnection(wire.Identity("test", (4, 1, 0, 0)), "127.0.0.1", 1510), []

    class StillAtItError(Exception):
        pass

    def receive(sock):
        read.append(sock)
        if len(read) > 100_000:
            raise StillAtItError

    monkeypatch.setattr(talk, "_receive", receive)
    monkeypatch.setattr(connection.select, "select", lambda *_: ([True], [], []))
    with contextlib.closing(talk):
        talk._drain(None)
        assert len(read) == connection._MOST_DRAINED
        monkeypatch.setattr(connection, "_MOST_DRAINED", 10**9)
        with pytest.raises(StillAtItError):
            talk._drain(None)
