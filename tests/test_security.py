"""docs/security.md says what listens where: the code, and a virtual lab that runs, have nothing else. Its firewall."""

import contextlib
import os
import pathlib
import re
import shutil
import socket
import subprocess
import sys
import time
import uuid

import netlab
import psutil
import pytest
from flying import end, left_behind, start, wait_for_line

from risc_lab.lab import load_fleet

ROOT = pathlib.Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs/security.md"
RULES = ROOT / "docs/firewall.nft"
# How code here comes to hear the network: sockets that are bound, all of UDP, and servers
LISTENS = re.compile(r"\.bind\(|create_server\(|SOCK_DGRAM|ViserServer\(|\bopen_socket\(")
SOURCES = (".py", ".cpp", ".hpp", "")  # programs of nodes/ have no suffix


def tables():
    """Rows of the page's tables of what listens, as lists of cells, by the heading above."""
    found, heading = {}, ""
    for line in PAGE.read_text().splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ")
        elif line.startswith("|") and not re.fullmatch(r"[| :-]+", line):
            found.setdefault(heading, []).append([cell.strip() for cell in line.strip("|").split("|")])
    return found


def listening_files():
    """Files of the tree that can listen, tests left out."""
    for path in sorted(ROOT.glob("src/**/*")):
        parts = path.relative_to(ROOT).parts
        if not path.is_file() or path.suffix not in SOURCES or {"test", "golden", "__pycache__"} & set(parts):
            continue
        with contextlib.suppress(UnicodeDecodeError):
            if LISTENS.search(path.read_text()):
                yield str(path.relative_to(ROOT))


def test_what_listens_in_the_code_is_on_the_page():
    named = set(re.findall(r"\(\.\./(src/[^)#]+)\)", PAGE.read_text()))
    listening = set(listening_files())
    assert listening == named, "what opens ports, and what docs/security.md says of it"


def heard_by(pid):
    """[(kind, port, address)] on which a process listens: bound UDP sockets and TCP listeners."""
    kinds = {socket.SOCK_DGRAM: "UDP", socket.SOCK_STREAM: "TCP"}
    return [
        (kinds[entry.type], entry.laddr.port, entry.laddr.ip)
        for entry in psutil.Process(pid).net_connections("inet")
        if entry.laddr and (entry.type == socket.SOCK_DGRAM or entry.status == psutil.CONN_LISTEN)
    ]


@pytest.mark.parametrize("fleet", ["ardrones3.yaml", "iris1.yaml"])
def test_a_virtual_lab_hears_what_the_page_says(fleet, tmp_path):
    """On addresses of its own, so that it meets no other lab."""
    number = 128 + os.getpid() % 100
    text = (ROOT / "launch/fleets" / fleet).read_text().replace("127.77.", "127.%d." % number)
    path = tmp_path / "fleet.yaml"
    path.write_text(text)
    load_fleet(str(path))
    command = [sys.executable, "-u", "-m", "risc_simulator.virtual_lab", str(path)]
    with (tmp_path / "log").open("w+") as log:
        lab = subprocess.Popen(
            command, stdout=log, stderr=subprocess.STDOUT, env=dict(os.environ, NUMBA_NUM_THREADS="1")
        )
        try:
            told = {
                (kind, int(port))
                for cells in tables()["The virtual lab"][1:]
                for kind, port in re.findall(r"(UDP|TCP) (\d+)", cells[1])
            }
            expected = ("UDP", 5556) if fleet.startswith("ardrone") else ("TCP", 11411)
            deadline = time.monotonic() + 120.0
            heard, addresses = set(), set()
            while expected not in heard:
                assert lab.poll() is None and time.monotonic() < deadline, (tmp_path / "log").read_text()
                with contextlib.suppress(psutil.Error):
                    entries = heard_by(lab.pid)
                    heard, addresses = {entry[:2] for entry in entries}, {entry[2] for entry in entries}
        finally:
            lab.terminate()
            lab.wait()
    # the socket that sends the stream has any port: nothing is read from it
    sends_only = {item for item in heard if item[0] == "UDP" and item not in told}
    assert len(sends_only) <= 1 and heard - sends_only <= told
    assert all(address.startswith("127.") or address == "255.255.255.255" for address in addresses)


PROGRAMS = {  # {name on the page: what is in the command line}
    "stream_markers": "/stream_markers ", "ardrone_driver": "/ardrone_driver ", "roscopter": "/roscopter/",
    "serial_node.py": "/serial_node.py ", "live_view": "/live_view ",
    "./maap fly": "risc_experiments.fly |/roslaunch |/roscore ",
}  # fmt: skip
EVERYWHERE = ("0.0.0.0", "::")
OF_ROS = {"TCP": 2, "UDP": 1}  # ports of a node, at most


def not_on_the_page(folder):
    """["KIND PORT at ADDRESS: command line"] on which programs of a flight listen, but that are not on the page."""
    page, stream_port = tables(), load_fleet(folder / "fleet.yaml").mocap.stream_port
    found = []
    for pid in left_behind(folder):
        with contextlib.suppress(psutil.NoSuchProcess):
            command, entries = command_of(pid), heard_by(pid)
            rows = [row for row in page["What listens"] if any("`" + name in row[0] for name in names_in(command))]
            told = [row[1] for row in rows + (page["The virtual lab"] if "virtual_lab" in command else [])]
            # every flight has a port of its own for the stream
            ports = [(kind, 1001 if (kind, port) == ("UDP", stream_port) else port, at) for kind, port, at in entries]
            left = [entry for entry in ports if not any(is_told(*entry, cell) for cell in told)]
            most_open = 0 if "python" in command.partition(" ")[0] else 1
            is_of_ros = all(sum(entry[0] == kind for entry in left) <= most for kind, most in OF_ROS.items())
            if not is_of_ros or sum(entry[2] in EVERYWHERE for entry in left) > most_open:
                found += ["%s %d at %s: %s" % (*entry, command[:200]) for entry in left]
    return found


def command_of(pid):
    return " ".join(psutil.Process(pid).cmdline())


def names_in(command):
    """Names by which the page calls the program of a command line."""
    return [name for name, part in PROGRAMS.items() if re.search(part, command)]


def is_told(kind, port, address, cell):
    """Whether the ports cell of a row lists this port and address."""
    has_port = re.search(r"%s[^,;]* %d\b" % (kind, port), cell) or re.search("%s.*any port" % kind, cell)
    return bool(has_port) and (address not in EVERYWHERE or "`*`" in cell)


@pytest.mark.release
@pytest.mark.alone
@pytest.mark.parametrize("flight", [("--browser",), ("iris",)])
def test_a_whole_flight_hears_what_the_page_says(flight, tmp_path):
    process = start(tmp_path, *flight, "--duration", "5")
    try:
        wait_for_line(process, tmp_path, "takeoff")
        programs = {name for pid in left_behind(tmp_path) for name in names_in(command_of(pid))}
        found = not_on_the_page(tmp_path)
    finally:
        end(process, tmp_path)
    assert programs > {"stream_markers", "roscopter" if "iris" in flight else "live_view"}
    assert found == []


# --- the firewall -----------------------------------------------------------------------------------------------------
NFT = shutil.which("nft", path=os.environ["PATH"] + ":/usr/sbin:/sbin")
WHY_NOT = netlab.unsupported() or ("" if NFT else "nft is missing: apt-get install nftables")
needs_nft = pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT)
OURS, CORTEX, VEHICLE, OPERATOR, STRANGER = ("10.213.0.%d" % number for number in range(1, 6))


@needs_nft
def test_the_firewall_is_valid():
    done = subprocess.run(["unshare", "--net", NFT, "--check", "--file", str(RULES)], stderr=subprocess.PIPE, text=True)
    assert done.returncode == 0, done.stderr


@pytest.fixture
def network():
    """Names of two connected network namespaces: ours, and one for all others, with an address for each of them."""
    names = ["risc-maap-%s-%s" % (uuid.uuid4().hex[:6], whose) for whose in ("a", "b")]

    def run(*command):
        subprocess.run(command, check=True, capture_output=True)

    try:
        for name in names:
            run("ip", "netns", "add", name)
            run("ip", "-n", name, "link", "set", "lo", "up")
        run("ip", "-n", names[0], "link", "add", "eth0", "type", "veth", "peer", "name", "eth0", "netns", names[1])
        for name, addresses in zip(names, ((OURS,), (CORTEX, VEHICLE, OPERATOR, STRANGER))):
            for address in addresses:
                run("ip", "-n", name, "addr", "add", address + "/24", "dev", "eth0")
            run("ip", "-n", name, "link", "set", "eth0", "up")
        yield names
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "del", name], capture_output=True)


_HEAR = """
import select, socket, sys
socks = []
for port in map(int, sys.argv[1:]):
    socks.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    socks[-1].bind(("", port))
print("ready", flush=True)
while socks:
    for sock in select.select(socks, [], [])[0]:
        data, sender = sock.recvfrom(100)
        if data == b"the end":
            socks.remove(sock)
        else:
            print(sender[0], sock.getsockname()[1], flush=True)
"""
_SEND = """
import socket, sys, time
ours, ports, sources = sys.argv[1], list(map(int, sys.argv[2].split(","))), sys.argv[3].split(",")
for source in sources:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind((source, 0))
        for port in ports:
            sock.sendto(b"hello", (ours, port))
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
    sock.bind((sources[0], 0))
    for port in ports:
        sock.sendto(b"the end", (ours, port))
"""


def heard_through(network, rules):
    """{(address, port)} of the datagrams to the mocap and MAVLink ports that arrive in our namespace."""
    inside, outside = (["ip", "netns", "exec", name] for name in network)
    if rules:
        subprocess.run([*inside, NFT, "--file", rules], check=True, capture_output=True)
    hears = subprocess.Popen([*inside, sys.executable, "-c", _HEAR, "1001", "14550"], stdout=subprocess.PIPE, text=True)
    try:
        assert hears.stdout.readline() == "ready\n"
        sources = ",".join((CORTEX, VEHICLE, OPERATOR, STRANGER))
        subprocess.run([*outside, sys.executable, "-c", _SEND, OURS, "1001,14550", sources], check=True)
        out, _ = hears.communicate(timeout=60.0)
    finally:
        hears.kill()
    return {(address, int(port)) for address, port in map(str.split, out.splitlines())}


@needs_nft
def test_the_firewall_lets_in_who_is_named_and_nobody_else(network, tmp_path):
    everybody = {(address, port) for address in (CORTEX, VEHICLE, OPERATOR, STRANGER) for port in (1001, 14550)}
    assert heard_through(network, None) == everybody, "the control arm"
    text = RULES.read_text()
    for name, address in (("cortex", CORTEX), ("vehicles", VEHICLE), ("operators", OPERATOR)):
        text, count = re.subn(r"(define %s = .*)127\.0\.0\.1" % name, r"\g<1>" + address, text)
        assert count == 1
    rules = tmp_path / "firewall.nft"
    rules.write_text(text)
    assert heard_through(network, rules) == {(CORTEX, 1001), (CORTEX, 14550), (VEHICLE, 14550)}
