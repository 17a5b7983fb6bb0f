"""The throw-away network of computers that tests of several machines run in."""

import pathlib
import shutil
import subprocess
import sys
import time

import netlab
import pytest
from netlab import PATIENCE_S, PREFIX, NetLab, unsupported

from risc_lab.testing import wait_for

HOSTS = {"north": "10.77.0.1/24", "south": "10.77.0.2/24", "east": "10.77.1.3/24"}
PING = ("import socket, sys; s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.settimeout(0.3); "
        "s.sendto(b'x', (sys.argv[1], 7)); s.recv(9)")  # fmt: skip

pytestmark = pytest.mark.skipif(bool(unsupported()), reason="NO NETWORK NAMESPACES: " + unsupported())


def leftovers(lab):
    """What the network has left on this computer."""
    namespaces = subprocess.run(["ip", "netns"], stdout=subprocess.PIPE, text=True, check=True).stdout
    mounts = pathlib.Path("/proc/self/mounts").read_text()
    return [text for text in (namespaces, mounts, str(list(lab.folder.glob("*")))) if lab.name in text]


@pytest.fixture(scope="module")
def lab():
    network = NetLab(HOSTS, user="pilot", sshd_lines={"south": ["SetEnv WHERE=below"]})
    with network:
        yield network
    assert leftovers(network) == []
    with pytest.raises(RuntimeError, match="down"):  # it must not answer "nothing runs" now
        network.processes("north")


def test_a_computer_without_a_tool_says_what_to_install(monkeypatch):
    monkeypatch.setattr(netlab.shutil, "which", lambda tool, path: None if tool == "sysctl" else tool)
    reason = unsupported.__wrapped__()
    assert reason.startswith("sysctl is missing: apt-get install") and "procps" in reason


def test_a_container_whose_kernel_settings_are_read_only_says_so():
    """As docker mounts /proc/sys: the tests are skipped then, and say why."""
    ask = "mount --bind /proc/sys /proc/sys && mount -o remount,bind,ro /proc/sys && "
    ask += "exec %s -c 'import netlab; print(netlab.unsupported())'" % sys.executable
    done = subprocess.run(
        ["unshare", "--mount", "--propagation", "private", "sh", "-c", ask],
        cwd=str(pathlib.Path(__file__).parent),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    assert "--privileged" in done.stdout and "tcp_orphan_retries" in done.stdout


def test_nothing_in_it_can_reach_anything_outside(lab):
    lab.assert_isolated()
    connect = "import socket; socket.create_connection(('192.0.2.1', 80), 1)"
    answer = lab.run("north", ["/usr/bin/python3", "-c", connect], check=False)
    assert "Network is unreachable" in answer.stderr


def test_a_way_out_is_found(lab):
    """The assertion can fail: a default route, a route to elsewhere, and a cable that leads out are each found."""
    namespace = PREFIX + lab.name + "-north"
    for route in (["default"], ["203.0.113.0/24"]):
        command = ["ip", "-n", namespace, "route", "add", *route, "via", "10.77.0.2"]
        subprocess.run(command, check=True)
        with pytest.raises(AssertionError, match="route to|default route"):
            lab.assert_isolated()
        subprocess.run([*command[:4], "del", *command[5:]], check=True)
    elsewhere = namespace + "-elsewhere"
    subprocess.run(["ip", "netns", "add", elsewhere], check=True)
    try:
        cable = ["name", "out0", "type", "veth", "peer", "name", "in0", "netns", elsewhere]
        subprocess.run(["ip", "-n", namespace, "link", "add", *cable], check=True)
        with pytest.raises(AssertionError, match="elsewhere"):
            lab.assert_isolated()
        subprocess.run(["ip", "-n", namespace, "link", "del", "out0"], check=True)
    finally:
        subprocess.run(["ip", "netns", "del", elsewhere], check=True)
    lab.assert_isolated()


def test_hosts_are_computers_of_their_own_and_ssh_leads_from_each_to_each(lab):
    for here, there in (("north", "south"), ("south", "east"), ("east", "north")):
        for name in (there, lab.address(there)):
            answer = lab.run(here, ["ssh", name, "hostname; id -un; echo $HOME"]).stdout
            assert answer.split() == [there, "pilot", str(lab.home(there))]
    assert lab.run("north", ["ssh", "south", "echo $WHERE"]).stdout.strip() == "below"
    entries = lab.run("north", ["cat", "/etc/shadow"], as_root=True).stdout.splitlines()
    assert [entry.split(":")[:2] for entry in entries] == [["pilot", "*"], ["root", "*"]], "no user has a password"


def test_a_pulled_cable_and_a_deaf_switch_are_silent_and_come_back(lab):
    echo = "import socket; s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(('', 7)); "
    echo += "print(1, flush=True)\nwhile True: s.sendto(*s.recvfrom(9))"
    server = lab.popen("south", ["/usr/bin/python3", "-c", echo], as_root=True, stdout=subprocess.PIPE)
    server.stdout.readline()

    def reaches():
        return lab.run("north", ["/usr/bin/python3", "-c", PING, lab.address("south")], check=False).returncode == 0

    wait_for(reaches, "it is reached")
    for break_it, mend_it in (
        (lambda: lab.link("south", "down"), lambda: lab.link("south", "up")),
        (lambda: lab.mute("south", True), lambda: lab.mute("south", False)),
    ):
        break_it()
        assert not reaches()
        mend_it()
        wait_for(reaches, "it is back", limit_s=10.0)  # a card whose carrier has come back needs up to a second
    code = lab.interrupt(server)
    assert code != 0 and lab.interrupt(server) == code, "one that has ended needs no signal"
    assert "socket" not in " ".join(lab.processes("south").values())


def test_hosts_lose_power_and_sshd_dies(lab):
    session = lab.popen("north", ["ssh", "south", "sleep 600"])
    other = lab.popen("east", ["sleep", "600"])
    while not any("sleep 600" in command for command in lab.processes("south").values()):
        assert session.poll() is None
    lab.sshd("south", "stop")
    assert session.wait(10) == 255
    assert lab.run("north", ["ssh", "south", "true"], check=False).returncode == 255
    lab.sshd("south", "start")
    assert lab.run("north", ["ssh", "south", "echo again"]).stdout == "again\n"
    lab.power_off("east")
    assert other.wait(10) != 0
    assert lab.processes("east") == {}
    lab.power_on("east")
    assert lab.run("north", ["ssh", "east", "hostname"]).stdout == "east\n"


def test_a_fork_is_not_a_program_of_its_own(lab):
    """It shows its parent's command line, as one that is about to start another program does."""
    forked = "import os, time; os.fork(); print(os.getpid(), flush=True); time.sleep(600)"
    process = lab.popen("north", ["/usr/bin/python3", "-c", forked], stdout=subprocess.PIPE, text=True)
    pids = {int(process.stdout.readline()) for _ in range(2)}
    assert pids <= set(lab.processes("north"))
    assert len(pids & set(lab.programs("north"))) == 1
    lab.interrupt(process)


def test_a_network_that_cannot_be_made_leaves_nothing():
    broken = NetLab({"north": "10.77.0.1/24", "south": "10.77.0.300/24"})
    with pytest.raises((RuntimeError, ValueError), match="10.77.0.300"):
        broken.up()
    assert leftovers(broken) == []


def test_hosts_end_with_the_program_that_made_them():
    """Also when it is killed."""
    program = "import netlab, time; lab = netlab.NetLab({'north': '10.77.0.1/24'}).up(); "
    program += "print(lab.name, lab.folder, flush=True); time.sleep(600)"
    folder = str(pathlib.Path(__file__).parent)
    maker = subprocess.Popen([sys.executable, "-c", program], cwd=folder, stdout=subprocess.PIPE, text=True)
    name, home = maker.stdout.readline().split()
    namespaces = ["%s%s-%s" % (PREFIX, name, host) for host in ("north", "switch")]

    def running():
        pids = ["ip", "netns", "pids", namespaces[0]]
        return subprocess.run(pids, stdout=subprocess.PIPE, text=True, check=True).stdout.split()

    try:
        assert running()
        maker.kill()
        maker.wait()
        deadline = time.monotonic() + PATIENCE_S
        while running():
            assert time.monotonic() < deadline
    finally:
        for namespace in namespaces:
            subprocess.run(["ip", "netns", "del", namespace], check=True)
        shutil.rmtree(home)
