"""The thesis' laboratory on one computer: a base station and three laptops with Appendix C's addresses, real ssh
between them, and the virtual lab as a fifth computer: Cortex on their network, each AR.Drone by a radio of its own.
"""

import collections
import contextlib
import io
import json
import math
import os
import pathlib
import re
import shutil
import subprocess
import sys
import time

import pytest
import roslaunch
import yaml
from flying import judged
from netlab import PATH, PREFIX, NetLab, has_netem
from wire_log import go_first

from ardrone_autonomy.protocol import at

ROOT = pathlib.Path(__file__).resolve().parents[1]
LAUNCH_FILE = ROOT / "launch/Multi_Machine_Experiment.launch"
ADDRESSES = {
    "risc1": "129.123.5.240/24",
    "risc2": "129.123.5.200/24",
    "risc3": "129.123.5.59/24",
    "risc4": "129.123.85.143/24",
    "cortex": "129.123.5.10/24",
}
VEHICLE_OF = {"risc2": "risc1", "risc3": "risc2", "risc4": "risc3"}  # {laptop: vehicle}, Appendix C
COMPUTERS = ("risc1", *VEHICLE_OF)
NAMED = tuple("%s_address:=%s" % (computer, ADDRESSES[computer].partition("/")[0]) for computer in COMPUTERS)
MASTER = "http://129.123.5.240:11311"
USER = None  # root: only root may raise the priority of nodes that fly, and here four computers share two cores
LOSS = 0.02  # fraction of radio packets
PATIENCE_S = 120.0  # ten times what an idle computer needs
CUTS = 3  # attempts to cut a link for a time that is short enough
SETTLE_S = 1.5  # after a cut, until everything that was sent during it has arrived
RESULT = "operator: result"
NETWORKS = ("129.123.5.0/24", "129.123.85.0/24")
# TCP sends lost packets again after 40 ms, instead of the default 200, 600, ... ms. As in docs/many_machines.md, for
# routes with and without a metric.
RESEND = "ip route change $(ip -4 route show exact %s) rto_min 40ms"
KEEP_ALIVE = ("ClientAliveInterval 2", "ClientAliveCountMax 3")  # as docs/many_machines.md says
COLOURS = re.compile(r"\x1b\[[0-9;]*m|\x1b\]2;[^\x07]*\x07")
NODE_NAME = re.compile(r" __name:=(\S+)")
# Two cores do what five computers would: half the frames, few pictures, and everything starts before the take-off.
RATE_HZ = 100.0
ARENA = {"half_x_m": 4.0, "half_y_m": 4.0}  # so wide that nothing that drifts for two seconds reaches the net
LIGHT = ("rviz:=false", "operator:=true", "video_fps:=3", "record_hz:=0", "ready:=4")

Command = collections.namedtuple("Command", "time_s vehicle name arguments")


class FaultError(Exception):
    """A fault that a busy computer does not explain, such as nodes that are left running."""


class FourHosts:
    """The laboratory, a context manager. Afterwards `folder` has the bag, the logs and the virtual lab's statistics.

    ahead_s: {computer: by how much the clock of everything that ssh starts there is ahead [s]}.
    forgetful: computers whose sshd never notices that a client is gone, as without KEEP_ALIVE.
    """

    def __init__(self, folder, ahead_s=None, forgetful=()):
        self.folder = pathlib.Path(folder)
        self.folder.mkdir(parents=True)
        lines = {computer: [] if computer in forgetful else list(KEEP_ALIVE) for computer in COMPUTERS}
        for computer, seconds in (ahead_s or {}).items():
            lines[computer].append("SetEnv LD_PRELOAD=%s CLOCK_AHEAD_S=%g" % (self._clock_library(), seconds))
        self.net = NetLab(ADDRESSES, USER, lines)
        self._launched_s = 0.0
        self._launch = None
        self._programs = contextlib.ExitStack()

    def __enter__(self):
        self.net.up()
        try:
            self._connect_radios()
            self.net.assert_isolated()
            self._start_virtual_lab()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        try:
            for host in COMPUTERS:
                logs = self.net.home(host) / ".ros/log"
                if logs.exists():
                    shutil.copytree(str(logs), str(self.folder / "ros_log" / host), symlinks=True)
        finally:
            self._programs.close()
            self.net.down()

    # --- the laboratory ---------------------------------------------------------------------------------------------

    def _clock_library(self):
        path = self.folder / "clock_ahead.so"
        source = str(ROOT / "tests/clock_ahead.c")
        subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", str(path), source, "-ldl"], check=True)
        return path

    def _connect_radios(self):
        """Each laptop has joined the network of its vehicle, which loses some of what is sent.

        In the lab all vehicles have the factory address; here one computer has to be all of them, so theirs differ.
        """
        self.lossy_kernel = has_netem()  # else the virtual lab has to lose it
        for number, laptop in enumerate(VEHICLE_OF, 1):
            address = "192.168.%d.%%d/24" % number
            self.net.cable(laptop, "wlan0", address % 2, "cortex", "wlan%d" % number, address % 1)
            if self.lossy_kernel:
                self.net.netem(laptop, "delay 2ms loss %g%%" % (100.0 * LOSS), "wlan0")
        metric = "ip route del {0} && ip route add {0} dev eth0 proto kernel scope link src {1} metric 100"
        command = metric.format(NETWORKS[0], self.net.address("risc2"))  # as NetworkManager does it
        self.net.run("risc2", ["sh", "-c", command], as_root=True)
        for computer in COMPUTERS:
            for network in NETWORKS:
                self.net.run(computer, ["sh", "-c", RESEND % network], as_root=True)

    def _start_virtual_lab(self):
        self.fleet = self.net.folder / "fleet.yaml"
        fleet = yaml.safe_load((ROOT / "launch/fleets/lab3.yaml").read_text())
        fleet["mocap"].update(host=self.net.address("cortex"), rate_hz=RATE_HZ)
        fleet["arena"] = ARENA
        for number, vehicle in enumerate(fleet["vehicles"], 1):
            vehicle["address"] = "192.168.%d.1" % number
        self.fleet.write_text(yaml.safe_dump(fleet))
        self._statistics = self.folder / "virtual_lab.json"
        loss = 0.0 if self.lossy_kernel else LOSS
        options = ["--seed", "1", "--radio-loss", loss, "--stats", self._statistics]
        self._lab = self._program("virtual_lab", ["-m", "risc_simulator.virtual_lab", self.fleet, *options])
        cards = ["%s=wlan%d" % (vehicle, number) for number, vehicle in enumerate(VEHICLE_OF.values(), 1)]
        self._wire = self._program("wire_log", [ROOT / "tests/wire_log.py", *cards])
        self._wait(lambda: "AT commands" in self.log("virtual_lab") and "ready" in self.log("wire_log"), self._lab_log)

    def _lab_log(self):
        return self.log("virtual_lab") + self.log("wire_log")

    def _program(self, name, arguments):
        """Start a Python program on the virtual lab's computer, ended with the laboratory at the latest."""
        out = self._programs.enter_context((self.folder / (name + ".txt")).open("w"))
        environment = {"PYTHONPATH": os.environ["PYTHONPATH"], "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, *arguments]
        return self.net.popen("cortex", command, environment, as_root=True, stdout=out, stderr=subprocess.STDOUT)

    def log(self, name):
        """What a program has printed so far: a launch by its name, "virtual_lab", "wire_log"."""
        path = self.folder / (name + ".txt")
        return COLOURS.sub("", path.read_text(errors="replace")) if path.exists() else ""

    # --- a flight ---------------------------------------------------------------------------------------------------

    def launch(self, *arguments, name="flight"):
        """The one command, on the base station. name: of its bag and of its log."""
        self._name, self._launched_s = name, time.monotonic()
        self._launch = self._roslaunch(name, arguments)

    def launch_beside(self, name):
        """The same command once more, while the first launch is alive. Returns its exit code; it is to be refused."""
        process = self._roslaunch(name, ())
        try:
            return process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            raise FaultError("a launch beside another one was not refused:\n" + self.log(name)) from None

    def _roslaunch(self, name, arguments):
        bag = self.net.home("risc1") / (name + ".bag")
        command = [ROOT / "devel/coop.sh", "roslaunch", LAUNCH_FILE]
        command += ["fleet:=%s" % self.fleet, "bag:=%s" % bag, *NAMED, *LIGHT, *arguments]
        environment = {"ROS_MASTER_URI": MASTER, "ROS_IP": self.net.address("risc1"), "PYTHONUNBUFFERED": "1"}
        out = self._programs.enter_context((self.folder / (name + ".txt")).open("w"))
        return self.net.popen("risc1", command, environment, stdout=out, stderr=subprocess.STDOUT)

    def wait_for(self, text):
        """Wait until the launch has printed the text; fail if it aborts. Returns the time [s] since its start."""

        def is_there():
            log = self.log(self._name)
            assert text in log or text == RESULT or "phase aborted" not in log, log
            return text in log

        self._wait(is_there, lambda: "'%s' never came:\n%s" % (text, self.log(self._name)))
        return time.monotonic() - self._launched_s

    def _wait(self, condition, log):
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            if self._lab.poll() is not None:
                raise FaultError("the virtual lab has ended:\n" + self._lab_log())
            if self._launch is not None and self._launch.poll() is not None:
                raise FaultError("the launch has ended:\n" + log())
            assert time.monotonic() < deadline, log()
            time.sleep(0.05)

    def logged_s(self, text):
        """The time stamp [s] before the text in the output of the launch."""
        return float(re.search(r"\[([0-9.]+)\]: " + re.escape(text), self.log(self._name)).group(1))

    def cut(self, laptop, duration_s, longest_s=math.inf):
        """Cut the link of a laptop for duration_s. Returns the times [s] between which it was certainly cut.

        A cut that may have lasted longer than longest_s, because this computer stood still, proves nothing: it is
        repeated, unless the vehicle has landed.
        """
        for _ in range(CUTS):
            off_s, begin_s, end_s, on_s = self._cut(laptop, duration_s)
            if on_s - off_s <= longest_s:
                return begin_s, end_s
            time.sleep(SETTLE_S)
            if any(c.time_s > off_s and orders_landing(c) for c in self.commands(VEHICLE_OF[laptop])):
                break
        pytest.skip("this computer is too busy to cut a link for %g s, that took %.2f s" % (duration_s, on_s - off_s))

    def _cut(self, computer, duration_s):
        """As NetLab.mute, but with one high-priority program: no other has to be started to restore the link.

        Returns the times [s] before and after the link is cut, and before and after it is restored.
        """
        times_s = []
        port = "p-" + computer
        batch = ["bridge", "-netns", "%s%s-switch" % (PREFIX, self.net.name), "-batch", "-"]
        pipe = subprocess.PIPE
        go_first()
        try:
            with subprocess.Popen(batch, stdin=pipe, stdout=pipe, text=True, env={"PATH": PATH}) as bridge:
                for number, name in ((3, "forwarding"), (0, "disabled"), (3, "forwarding")):  # it has started; off; on
                    times_s.append(time.time())
                    bridge.stdin.write("link set dev %s state %d\nlink show dev %s\n" % (port, number, port))
                    bridge.stdin.flush()
                    answer = bridge.stdout.readline()
                    times_s.append(time.time())
                    if " state %s " % name not in answer:
                        raise FaultError("the bridge did not set %s to %s: %s" % (port, name, answer))
                    time.sleep(duration_s if name == "disabled" else 0.0)
        finally:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        return times_s[2:]

    def end(self, patience_s):
        """Send Ctrl-C to the launch.

        Sets ended_s, how long it took to end [s], and left, what still runs on any computer patience_s later.
        """
        begin_s = time.monotonic()
        self.net.interrupt(self._launch, timeout=PATIENCE_S)
        self.ended_s = time.monotonic() - begin_s
        deadline = time.monotonic() + patience_s
        self.left = self.left_on(*COMPUTERS)
        while self.left and time.monotonic() < deadline:
            time.sleep(0.1)
            self.left = self.left_on(*COMPUTERS)

    def left_on(self, *computers):
        """{computer: command lines} of what runs there and is not the computer's own; {} when nothing is left."""
        found = {}
        for computer in computers:
            commands = self.net.processes(computer).values()
            foreign = [text for text in commands if text and "netlab.py" not in text and "[listener]" not in text]
            if foreign:
                found[computer] = foreign
        return found

    def nodes_on(self, computer):
        """Sorted names of the nodes that run there, without their namespaces."""
        names = [NODE_NAME.search(command) for command in self.net.programs(computer).values()]
        return sorted(name.group(1) for name in names if name)

    def node_pids(self, computer):
        """Process ids of the nodes that run there."""
        return {pid for pid, command in self.net.programs(computer).items() if NODE_NAME.search(command)}

    def finish(self):
        """End the virtual lab; keep its statistics and the recorded bags. Returns the statistics.

        Sets lost, {vehicle: fraction of its radio packets that was lost}. Raises FaultError if the lab had died.
        """
        if self.lossy_kernel:
            self.lost = {vehicle: self.net.lost(laptop, "wlan0") for laptop, vehicle in VEHICLE_OF.items()}
        code = self.net.interrupt(self._lab)
        self.net.interrupt(self._wire)
        self._stills_s = [json.loads(line)["still_s"] for line in self._wire_lines() if line.startswith("{")]
        if not self._statistics.exists():
            raise FaultError("the virtual lab left no statistics (exit code %d):\n%s" % (code, self._lab_log()))
        self.statistics = json.loads(self._statistics.read_text())
        if not self.lossy_kernel:
            self.lost = {}
            for vehicle, figures in self.statistics["vehicles"].items():
                counts = figures["host"]
                slots = counts["at_datagrams"] - counts["sticks_superseded"]  # that were used
                self.lost[vehicle] = counts["radio_slots_lost"] / max(slots, 1)
        for path in self.net.home("risc1").glob("*.bag*"):
            shutil.copy(str(path), str(self.folder))
        return self.statistics

    def commands(self, vehicle=None):
        """[Command, ...] that reached the vehicles, or the one, in order."""
        commands = [Command(*json.loads(line)) for line in self._wire_lines() if line.startswith("[")]
        return [command for command in commands if vehicle in (None, command.vehicle)]

    def _wire_lines(self):
        return (self.folder / "wire_log.txt").read_text().rpartition("\n")[0].splitlines()

    def still_s(self, begin_s, end_s):
        """How long [s] this whole computer stood still between these times; call it after `finish`."""
        return sum(max(0.0, min(to_s, end_s) - max(from_s, begin_s)) for from_s, to_s in self._stills_s)


def planned_nodes(*arguments):
    """{computer: sorted names of the nodes that the launch file puts there}."""
    config = roslaunch.config.ROSLaunchConfig()
    argv = ["bag:=flight.bag", "fleet:=%s" % (ROOT / "launch/fleets/ardrones3.yaml"), *NAMED, *LIGHT, *arguments]
    roslaunch.xmlloader.XmlLoader().load(str(LAUNCH_FILE), config, argv=argv, verbose=False)
    config.assign_machines()
    found = {computer: [] for computer in COMPUTERS}
    for node in config.nodes:
        found[node.machine.name].append(node.name)
    found["risc1"].append("rosout")  # comes with the master
    return {computer: sorted(names) for computer, names in found.items()}


def orders_landing(command):
    """A REF whose start bit is 0: land, or stay on the ground."""
    return command.name == "REF" and not command.arguments[0] & at.Ref.START


def moves(command):
    """Sticks that are not "level, hold altitude"."""
    flags, *sticks = command.arguments
    return command.name != "REF" and bool(flags & at.PcmdFlag.PROGRESSIVE) and any(sticks[:4])


def wait_until(condition, what):
    """Wait until the condition holds; return the seconds that took. Raises FaultError if it never does."""
    begin_s = time.monotonic()
    while not condition():
        if time.monotonic() - begin_s > PATIENCE_S:
            raise FaultError("%s: never" % what)
        time.sleep(0.1)
    return time.monotonic() - begin_s


def fly(folder, scenario, checks, **options):
    """Carry out scenario(hosts) in a new laboratory, end the virtual lab, check the records. Returns the FourHosts.

    checks: function (hosts), the checks that a busy computer may cause to fail.
    If the scenario or a check fails (AssertionError), `flying.judged` decides whether this computer had time for the
    virtual lab; not after a FaultError. If it had time, the scenario's error is raised; a check's error is left to the
    test that makes the same check on the same records.
    """
    problem = None
    with FourHosts(folder / "hosts", **options) as hosts:
        try:
            scenario(hosts)
        except AssertionError as error:
            problem = error
        try:
            lab = {"lab_late_ms": hosts.finish()["late_ms"]}
        except (FaultError, subprocess.TimeoutExpired) as error:
            raise (problem or error) from None
    is_flown = problem is None
    if is_flown:
        try:
            with contextlib.redirect_stdout(io.StringIO()):  # the tests print it
                checks(hosts)
            return hosts
        except AssertionError as error:
            problem = error
    judged((1, str(problem), lab, folder))
    if is_flown:
        return hosts
    raise problem
