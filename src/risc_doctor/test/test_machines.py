"""`./maap machines` against a real sshd: each fault gets its own finding, and there are none without a fault."""

import atexit
import contextlib
import functools
import getpass
import io
import os
import pathlib
import re
import runpy
import shlex
import shutil
import socket
import subprocess
import sys
import tempfile
import textwrap
import time

import paramiko
import pytest
from roslaunch.xmlloader import XmlLoader

from risc_doctor.machines import __main__ as machines
from risc_doctor.machines import ssh
from risc_doctor.machines.__main__ import main
from risc_doctor.machines.experiment import Computer
from risc_lab.lab import load_fleet
from risc_lab.ros.launching import PortReservation

ROOT = pathlib.Path(__file__).resolve().parents[3]
SSHD = shutil.which("sshd", path="/usr/sbin:/usr/local/sbin:/sbin")
USER = getpass.getuser()
# this computer's login has another name in these tests: roslaunch then goes to 127.x.y.z by ssh, too
CALLER = "the_caller"
PATIENCE_S = 60.0
LOADER = '#!/bin/sh\n%s\n. "%s/devel/setup.sh"\n%s\nexec "$@"\n'

pytestmark = pytest.mark.skipif(SSHD is None, reason="openssh-server is not installed")


def run(*words, **options):
    return subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True, timeout=PATIENCE_S, **options).stdout


def key_pair(path, kind="ed25519"):
    """Make a key pair; returns its public half as "type base64"."""
    run("ssh-keygen", "-q", "-t", kind, "-N", "", "-C", "", "-f", str(path))
    return " ".join(path.with_name(path.name + ".pub").read_text().split()[:2])


@functools.cache
def host_key(kind):
    """(private file, public half) of the host key of this kind, shared by all servers: making an RSA key takes long."""
    folder = tempfile.TemporaryDirectory(prefix="host_key")
    atexit.register(folder.cleanup)
    path = pathlib.Path(folder.name) / ("host_" + kind)
    return path, key_pair(path, kind)


def free_port(addresses):
    """A TCP port that is free at all the addresses."""
    for port in range(20022, 20200):
        probes = [socket.socket() for _ in addresses]
        try:
            for probe, address in zip(probes, addresses):
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind((address, port))
            return port
        except OSError:
            continue
        finally:
            for probe in probes:
                probe.close()
    raise RuntimeError("no free port")


class Server:
    """An sshd of our own at addresses of a loopback subnet; each address is a machine with its own settings.

    special: {number of the machine: lines of sshd_config for it}; before: shell commands for a mount
    namespace of its own; alone: its machines see only their own processes, no drivers of other tests.
    """

    def __init__(self, folder, count, special=(), before="", config=(), alone=False):
        self.folder = folder
        folder.mkdir()
        self._reservation = PortReservation(range(200, 240))
        self.addresses = ["%s.0.%d" % (self._reservation.subnet, number + 1) for number in range(count)]
        self.port = free_port(self.addresses)
        self.host_keys = {}
        for kind in ("ed25519", "ecdsa", "rsa"):
            private, self.host_keys[kind] = host_key(kind)
            for path in (private, private.with_suffix(".pub")):
                shutil.copy(path, folder)
        self.home = folder / "home"  # of the user who calls ./maap machines
        (self.home / ".ssh").mkdir(parents=True, mode=0o700)
        self.known_hosts = self.home / ".ssh" / "known_hosts"
        self.authorized = folder / "authorized_keys"
        self.authorized.write_text("")
        lines = ["ListenAddress %s:%d" % (address, self.port) for address in self.addresses]
        lines += ["HostKey %s" % (folder / ("host_" + kind)) for kind in self.host_keys]
        lines += ["AuthorizedKeysFile %s" % self.authorized, "PidFile none", "UsePAM no", "StrictModes no"]
        lines += ["PasswordAuthentication no", "PermitRootLogin yes", "MaxStartups 100", *config]
        for number, own in dict(special).items():
            lines += ["Match LocalAddress %s" % self.addresses[number], *own]
        (folder / "sshd_config").write_text("\n".join(lines) + "\n")
        command = [SSHD, "-D", "-e", "-f", str(folder / "sshd_config")]
        if before:
            command = [
                "unshare",
                "--mount",
                "--propagation",
                "private",
                "sh",
                "-ec",
                before + '\nexec "$@"',
                "sh",
                *command,
            ]
        if alone:
            command = ["unshare", "--pid", "--fork", "--kill-child", "--mount-proc", *command]
        self._log = (folder / "sshd.log").open("wb")
        if os.geteuid() == 0:
            pathlib.Path("/run/sshd").mkdir(exist_ok=True)
        self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=self._log, stderr=self._log)
        self._wait()

    def _wait(self):
        deadline = time.monotonic() + PATIENCE_S
        while socket.socket().connect_ex((self.addresses[-1], self.port)) != 0:
            log = (self.folder / "sshd.log").read_text()
            assert self._process.poll() is None and time.monotonic() < deadline, log
            time.sleep(0.02)

    def close(self):
        self._process.kill()
        self._process.wait()
        self._log.close()
        self._reservation.close()

    def restarts(self):
        """How often sshd has reloaded its settings and listens again."""
        return (self.folder / "sshd.log").read_text().count("Server listening on") // len(self.addresses) - 1

    def wait_for_restart(self, number):
        deadline = time.monotonic() + PATIENCE_S
        while self.restarts() < number:
            assert self._process.poll() is None and time.monotonic() < deadline, (self.folder / "sshd.log").read_text()
            time.sleep(0.02)

    def give_key(self):
        """Make a key for the caller and allow it to log in."""
        self.authorized.write_text(key_pair(self.home / ".ssh" / "id_ed25519") + "\n")

    def name(self, number):
        """Name of a machine in known_hosts."""
        return "[%s]:%d" % (self.addresses[number], self.port)

    def know(self, number):
        """The line of known_hosts that roslaunch needs: name with port for ssh, bare address for its own check."""
        return "%s,%s %s\n" % (self.name(number), self.addresses[number], self.host_keys["ed25519"])

    def machine(self, number, name, loader, inside="", **attributes):
        """A <machine> tag with a node. Attributes with - are written with _."""
        values = dict(
            {
                "name": name,
                "address": self.addresses[number],
                "ssh-port": self.port,
                "user": USER,
                "env-loader": loader,
            },
            **{key.replace("_", "-"): value for key, value in attributes.items()},
        )
        tag = "<machine %s/>" % " ".join('%s="%s"' % item for item in values.items())
        return tag + '<node machine="%s" pkg="joy" type="%s" name="%s_node"/>' % (name, inside or "nothing", name)

    def launch_file(self, *machines):
        """Write a launch file; returns its path."""
        path = self.folder / "experiment.launch"
        path.write_text('<launch>\n<arg name="speed" default="1"/>\n%s\n</launch>\n' % "\n".join(machines))
        return path

    def environment(self, root=ROOT, **variables):
        """{name: value} of the user who calls ./maap machines; None = not set."""
        unset = dict.fromkeys(("ROS_IP", "ROS_HOSTNAME", "SSH_AUTH_SOCK", "ROSLAUNCH_SSH_UNKNOWN"))
        return {**unset, "HOME": str(self.home), "LOGNAME": CALLER, "RISC_MAAP_ROOT": str(root), **variables}

    def maap(self, action, *words, root=ROOT, cwd=None, **variables):
        """Run ./maap machines, but in this process: starting one takes longer than it works. (exit code, output)."""
        with pytest.MonkeyPatch.context() as caller, open(os.devnull) as nothing, tempfile.TemporaryFile("w+") as out:
            for name, value in self.environment(root, **variables).items():
                caller.delenv(name, raising=False) if value is None else caller.setenv(name, value)
            for name, stream in (("stdin", nothing), ("stdout", out), ("stderr", out)):
                caller.setattr(sys, name, stream)
            if cwd is not None:
                caller.chdir(cwd)
            code = exit_code_of(action, *words)
            out.seek(0)
            return code, out.read()

    def maap_process(self, action, *words, root=ROOT, **options):
        """Run ./maap machines in a process of its own. Returns (exit code, output)."""
        environment = {**os.environ, **self.environment(root)}
        done = subprocess.run(
            [sys.executable, "-m", "risc_doctor.machines", action, *map(str, words)],
            env={name: value for name, value in environment.items() if value is not None}, text=True,
            **{"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, **options},
            timeout=PATIENCE_S, check=False,
        )  # fmt: skip
        return done.returncode, done.stdout


def flat(text):
    """Without line ends and indents."""
    return re.sub(r"\s+", " ", text)


def sections(printed):
    """{machine: what was printed about it, as one line}; key None: the end of the report."""
    found, name = {}, None
    for line in printed.splitlines():
        heading = re.match(r"(this computer$|\w+(?= \(.*\)$))", line)
        if heading:
            name = heading.group(1)
        elif not line.strip():
            name = None
        else:
            found[name] = found.get(name, "") + " " + line
    return {name: flat(text).strip() for name, text in found.items()}


def write_loader(path, before="", after=""):
    """An env-loader, in the devel folder of a workspace."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(LOADER % (before, ROOT, after))
    path.chmod(0o755)
    return path


CLOCK = textwrap.dedent("""
    import time
    _true = time.time
    time.time = lambda: _true() + 0.05
""")
KILL_SESSION = "p=$$; until ps -o args= -p $p | grep -q ^sshd:; do p=$(ps -o ppid= -p $p); done; kill -KILL $p"
CHRONYC = """#!/bin/sh
[ "$*" = "-c -n tracking" ] || exit 1
echo 7F000001,127.0.0.1,3,1700000000.1,0.090000000,0.00001,0.00002,-6.1,0.01,0.02,0.002,0.001,64.2,Normal
"""


def test_every_fault_is_named_with_its_cure(tmp_path):
    """One machine for each fault, all at once, each in its place of the report."""
    (tmp_path / "late").mkdir()
    (tmp_path / "late" / "sitecustomize.py").write_text(CLOCK)
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "chronyc").write_text(CHRONYC)
    (tmp_path / "bin" / "chronyc").chmod(0o755)
    here = write_loader(tmp_path / "here" / "devel" / "coop.sh")
    (here.parent / "setup.sh").touch()
    other = write_loader(tmp_path / "other" / "devel" / "coop.sh", after="export ROS_IP=255.255.255.255")
    (other.parent / "setup.sh").touch()
    (other.parents[1] / "launch").mkdir()
    (other.parents[1] / "launch" / "strange.launch").touch()
    stubborn = write_loader(here.parent / "stubborn.sh", after="export ROS_MASTER_URI=http://127.0.0.1:9")
    write_loader(here.parent / "nameless.sh", after="export ROS_HOSTNAME=no-such-name.invalid")
    dying = write_loader(here.parent / "dying.sh", KILL_SESSION)
    broken = here.parent / "broken.sh"
    broken.write_text("#!/bin/sh\necho coop.sh: the disk is full >&2\nexit 3\n")
    broken.chmod(0o755)
    flat = here.parent / "flat.sh"
    flat.write_text("")
    nameless = shutil.copytree(here.parents[1], tmp_path / "moved") / "devel" / "nameless.sh"
    special = {
        6: ["AuthorizedKeysFile none"],
        10: ["SetEnv PYTHONPATH=%s" % (tmp_path / "late")],
        11: ["SetEnv PATH=%s:/usr/bin:/bin" % (tmp_path / "bin")],
    }
    server = Server(tmp_path / "server", 14, special)
    mute = socket.socket()
    try:
        mute.bind((server.addresses[0], 0))
        mute.listen(8)  # takes connections and never sends anything
        server.give_key()
        key = server.host_keys["ed25519"]
        strange = key_pair(tmp_path / "strange")
        lines = ["risc2 %s\n" % key, *(server.know(number) for number in range(6, 14))]
        lines += ["%s %s\n" % (server.name(2), key)]
        lines += ["%s,%s %s\n" % (server.name(3), server.addresses[3], strange)]
        lines += ["%s,%s %s\n" % (server.name(4), server.addresses[4], server.host_keys["rsa"])]
        lines += ["%s %s\n" % (server.addresses[5], key)]
        server.known_hosts.write_text("".join(lines))
        machine = server.machine
        file = server.launch_file(
            machine(0, "closed", here, ssh_port=9),
            machine(0, "mute", here, ssh_port=mute.getsockname()[1]),
            machine(0, "nowhere", here, address="no-such-name.invalid"),
            machine(1, "unknown", here),
            machine(2, "bracketed", here),
            machine(3, "changed", here),
            machine(4, "rsa_only", here),
            machine(5, "bare", here),
            machine(6, "refused", here, password=""),
            machine(7, "gone", tmp_path / "gone" / "devel" / "coop.sh", password="secret"),
            machine(8, "flat", flat),
            machine(9, "broken", broken),
            machine(10, "wrong", other, timeout="0.01"),
            machine(11, "stubborn", stubborn),
            machine(12, "nameless", nameless),
            machine(13, "dying", dying),
            '<machine name="spare" address="127.0.0.1"/>',
        )
        code, printed = server.maap_process("check", file, root=here.parents[1])
    finally:
        mute.close()
        server.close()
    print(printed)
    found = sections(printed)
    assert code == 1 and "start it with" not in printed
    assert list(found)[1:-1] == re.findall(r'machine name="(\w+)"', file.read_text())
    for name, texts in {
        "closed": ["red network", "port 9 refuses", "> on that computer: sudo apt install openssh"],
        "mute": ["red network", "not an ssh server"],
        "nowhere": ["red network no-such-name.invalid: ", "/etc/hosts"],
        "unknown": ["red host key known_hosts has this key for risc2, "],
        "bracketed": ["red host key", "looks for %s " % server.addresses[2]],
        "changed": ["red host key THE HOST KEY OF", "HAS CHANGED", "ssh-keygen -R '%s'" % server.name(3)],
        "rsa_only": ["the ssh-rsa key", "> ./maap machines setup adds"],
        "bare": ["red host key %s " % server.name(5), "> ./maap machines setup"],
        "refused": ['yellow password password="" ', "red login", "ssh-copy-id -p %d" % server.port],
        "gone": ["red password", "red env-loader", "deploy"],
        "flat": ["red env-loader", "is not executable there", "chmod +x"],
        "broken": ["red env-loader", "fails there: coop.sh: the disk is full"],
        "wrong": [
            "yellow env-loader", "roslaunch waits 0.01 s", "red workspace", "launch/strange.launch",
            "red topics", "255.255.255.255", "a wrong ROS_IP", "red clock", "ms ahead of", "makestep", "green disk",
        ],
        "stubborn": [
            "green workspace", "red topics", "http://127.0.0.1:9", "devel/coop.sh", " 90.0 ms behind)",
        ],
        "nameless": [
            "red workspace", str(here.parents[1]), str(nameless.parents[1]),
            "from nameless to here", "no-such-name.invalid cannot be resolved", "green clock",
        ],
        "dying": ["red network", "connection to dying is lost"],
        "spare": ["not needed, not checked"],
    }.items():  # fmt: skip
        for text in texts:
            assert text in found[name], (name, text, found[name])
    for name in ("unknown", "changed", "gone", "dying"):  # no finding where nothing can be measured
        assert "topics" not in found[name]


def test_what_is_well_is_well_and_the_command_to_start_is_told(tmp_path):
    server = Server(tmp_path / "server", 2, alone=may_mount())
    try:
        server.give_key()
        # hashed entries, comments and junk do not matter
        server.known_hosts.write_text("# ours\n" + server.know(0) + server.know(1))
        run("ssh-keygen", "-q", "-H", "-f", str(server.known_hosts), stderr=subprocess.DEVNULL)
        server.known_hosts.write_text(server.known_hosts.read_text() + "junk\n")
        root = tmp_path / "ws"  # the real programs, with files that do not change
        (root / "src").mkdir(parents=True)
        (root / "devel").symlink_to(ROOT / "devel")
        loader = root / "devel" / "coop.sh"
        shutil.copy(str(ROOT / "launch/fleets/ardrones3.yaml"), str(tmp_path / "my_fleet.yaml"))
        file = server.launch_file(
            '<arg name="fleet" default="my_fleet.yaml"/>',
            '<machine name="base" address="localhost"/>',
            '<node machine="base" pkg="joy" type="nothing" name="base_node"/>',
            server.machine(0, "risc2", "env RISC_MAAP_ALLOW_SECOND=1 %s" % loader),
            server.machine(1, "risc3", loader),
            '<group ns="risc1"><node machine="risc3" pkg="ardrone_autonomy" type="ardrone_driver" name="driver">',
            '<param name="drone_ip" value="127.199.0.1"/></node>',
            '<node machine="risc3" pkg="joy" type="joy_node" name="joy">',
            '<param name="dev" value="/dev/input/js77"/></node></group>',
        )
        names = {"ROS_HOSTNAME": "localhost", "ROS_IP": "127.0.0.1"}
        words = ("check", file, "speed:=2 3", "--only", "base,risc2")
        good = server.maap(*words, root=root, cwd=tmp_path, **names)
        bad = server.maap("check", file, "--only", "risc3", root=root)
        run("ssh-keygen", "-q", "-p", "-N", "secret", "-f", str(server.home / ".ssh" / "id_ed25519"))
        locked = server.maap("check", file, "--only", "risc2", root=root)
    finally:
        server.close()
    print(good[1], bad[1])
    found = sections(good[1])
    assert good[0] == 0 and not re.search("^red", good[1], re.MULTILINE)
    assert set(found) == {"this computer", "base", "risc2", None}
    for text in ("green login", "green env-loader", "green workspace", "green topics", "green disk"):
        assert text in found["risc2"]
    assert "yellow shell" in found["this computer"] and "ROS_HOSTNAME=localhost" in found["this computer"]
    assert "unset ROS_HOSTNAME; export ROS_IP=127.0.0.1 ROS_MASTER_URI=http://127.0.0.1:" in found["this computer"]
    line = good[1].splitlines()[-1].strip()
    assert line.startswith(
        "./maap shell -c 'env -u ROS_HOSTNAME ROS_MASTER_URI=http://127.0.0.1:11311 ROS_IP=127.0.0.1 roslaunch "
    )
    assert str(file) in line and "speed:=2 3" in line
    found = sections(bad[1])["risc3"]
    assert bad[0] == 1 and "red joystick /dev/input/js77 " in found
    assert re.search("red vehicles .* 127.199.0.1 ", found)
    assert locked[0] == 1 and re.search("red login .* passphrase", sections(locked[1])["risc2"])


def test_a_command_may_print_more_than_a_stream_holds(tmp_path, monkeypatch):
    """On both streams: a reader that reads one to its end before the other would block the command."""
    server = Server(tmp_path / "server", 1)
    try:
        server.give_key()
        server.known_hosts.write_text(server.know(0))
        monkeypatch.setenv("HOME", str(server.home))
        monkeypatch.delenv("SSH_AUTH_SOCK", raising=False)
        script = "import os; [os.write(fd, b'x' * 65536) for _ in range(99) for fd in (1, 2)]"
        with contextlib.closing(ssh.connect(Computer("risc2", server.addresses[0], server.port, USER))) as session:
            answer = session.limited("python3 -c %s" % shlex.quote(script), 10.0)
            dead = session.limited("sleep 60", 0.2)
        assert (answer.code, len(answer.out), len(answer.err)) == (0, 99 * 65536, 99 * 65536)
        assert dead.code is None and dead.reason()
    finally:
        server.close()


def may_mount():
    """Whether a process may have mounts of its own here (root, and not in a container that forbids it)."""
    probe = ["unshare", "--mount", "--propagation", "private", "mount", "--bind", "/tmp", "/tmp"]
    return subprocess.run(probe, stderr=subprocess.DEVNULL, check=False).returncode == 0


needs_mounts = pytest.mark.skipif(not may_mount(), reason="another computer's folders cannot be mounted over ours here")


def answer_yes(server, *words):
    """./maap machines at a terminal where y is typed. Returns what it printed."""
    keyboard, terminal = os.openpty()
    try:
        os.write(keyboard, b"y\n")
        code, printed = server.maap_process(*words, stdin=terminal, stderr=None, start_new_session=True)
        assert code == 0, printed
        return printed
    finally:
        os.close(keyboard)
        os.close(terminal)


@needs_mounts
def test_setup_changes_what_is_missing_and_nothing_twice(tmp_path):
    for folder in ("sshd_config.d", "bin"):
        (tmp_path / folder).mkdir()
    for program, body in (("id", "echo 1000"), ("sudo", "exit 1")):
        (tmp_path / "bin" / program).write_text("#!/bin/sh\n%s\n" % body)
        (tmp_path / "bin" / program).chmod(0o755)
    special = {1: ["AuthorizedKeysFile none"], 2: ["SetEnv PATH=%s:/usr/bin:/bin" % (tmp_path / "bin")]}
    # the third machine is root like all, but its `id` and `sudo` say that it is not, and it finds no file
    settings = tmp_path / "sshd_config.d"
    before = "mount --bind %s /etc/ssh/sshd_config.d" % settings
    server = Server(tmp_path / "server", 3, special, before, ["Include /etc/ssh/sshd_config.d/*.conf"])
    keep_alive = settings / "risc_maap.conf"
    try:
        loader = tmp_path / "ws/devel/coop.sh"  # is not there: a check ends after the keep-alive
        names = ("risc2", "risc3", "risc4")
        file = server.launch_file(*(server.machine(number, name, loader) for number, name in enumerate(names)))
        old = "# of the person\ngithub.invalid %s" % server.host_keys["ecdsa"]  # without a line end
        server.known_hosts.write_text(old)
        code, printed = server.maap("setup", file)
        assert code == 1 and server.known_hosts.read_text() == old
        expected = run("ssh-keygen", "-lf", str(tmp_path / "server" / "host_ed25519.pub")).split()[1]
        assert expected in printed
        key = server.home / ".ssh" / "id_ed25519"
        assert str(key) in flat(printed) and key.stat().st_mode & 0o777 == 0o600
        server.authorized.write_text(key.with_name("id_ed25519.pub").read_text())

        code, printed = server.maap("setup", file, "--only", "risc4", "--yes")
        print(printed)
        assert code == 0 and "yellow keep-alive" in flat(printed) and not keep_alive.exists()
        assert r"printf 'ClientAliveInterval 2\nClientAliveCountMax 3\n' | sudo tee" in flat(printed)

        printed = answer_yes(server, "setup", file, "--only", "risc2")
        assert keep_alive.read_text() == "ClientAliveInterval 2\nClientAliveCountMax 3\n"
        server.wait_for_restart(1)
        code, printed = server.maap("check", file, "--only", "risc2,risc4", root=tmp_path)
        found = sections(printed)
        assert re.search("green keep-alive .* 6 s", found["risc2"]), printed
        assert "green keep-alive /etc/ssh/sshd_config.d/risc_maap.conf " in found["risc4"]
        (settings / "a_first.conf").write_text("ClientAliveInterval 3600\n")  # of several, sshd takes the first
        code, printed = server.maap("setup", file, "--only", "risc2")
        assert "yellow keep-alive wrote /etc/ssh/sshd_config.d/risc_maap.conf " in flat(printed)
        assert "Include /etc/ssh/sshd_config.d/*.conf" in flat(printed)
        (settings / "a_first.conf").unlink()
        server.wait_for_restart(2)
        written = server.known_hosts.read_text()
        assert written.startswith(old + "\n")
        for name in ("[risc2]:%d" % server.port, server.name(0), server.addresses[0]):
            assert set(paramiko.HostKeys(str(server.known_hosts)).lookup(name)) == {
                "ssh-ed25519",
                "ecdsa-sha2-nistp256",
            }

        # nothing is missing, but whether sshd has read it is unknown: it is reloaded once more
        before = server.restarts()
        code, printed = server.maap("setup", file, "--only", "risc2", "--yes")
        assert code == 0 and "wrote" not in printed and "green keep-alive" in flat(printed)
        server.wait_for_restart(before + 1)
        code, printed = server.maap("setup", file, "--only", "risc3", "--yes")
        print(printed)
        found = sections(printed)
        assert code == 1 and "> ./maap machines setup, or: ssh-copy-id" in found["risc3"]
        assert "wrote 2 lines" in found["risc3"]

        changed = server.known_hosts.read_text().replace(server.host_keys["ed25519"], key_pair(tmp_path / "strange"))
        server.known_hosts.write_text(changed)
        code, printed = server.maap("setup", file, "--only", "risc2", "--yes")
        assert code == 1 and "HAS CHANGED" in flat(printed)
        assert "ssh-keygen -R '%s'" % server.name(0) in printed and server.known_hosts.read_text() == changed

        # an sshd that would not survive a reload is left alone, and so is an existing file
        server.known_hosts.write_text(written)
        with (tmp_path / "server" / "sshd_config").open("a") as config:
            config.write("NoSuchSetting yes\n")
        for had_it in (True, False):
            code, printed = server.maap("setup", file, "--only", "risc2")
            print(printed)
            assert code == 0 and "NoSuchSetting" in printed and keep_alive.exists() == had_it
            keep_alive.unlink(missing_ok=True)
        with socket.create_connection((server.addresses[0], server.port)):
            pass
    finally:
        server.close()


@needs_mounts
def test_deploy_brings_the_workspace_and_loses_nothing(tmp_path):
    here, there, poor, other = tmp_path / "ws", tmp_path / "there", tmp_path / "poor", tmp_path / "other"
    for path, text in {
        "src/pkg/nodes/fly.py": "new", "src/pkg/config/cameras/risc1.yaml": "ours", "launch/x.launch": "", "maap": "",
        "devel/setup.sh": "", ".venv/bin/python": "", "build/x": "",
        "apt-packages.txt": "libc6  # there\nno-such-package\n", "logs/x": "", "flights/ours.bag": "", ".git/x": "",
        "src/pkg/__pycache__/x.pyc": "",
    }.items():  # fmt: skip
        (here / path).parent.mkdir(parents=True, exist_ok=True)
        (here / path).write_text(text)
    loader = write_loader(here / "devel" / "coop.sh")
    there.mkdir()
    poor.mkdir()
    for program in ("sh", "timeout", "mkdir"):
        (poor / program).symlink_to(shutil.which(program))
    other.mkdir()
    (other / "uname").write_text("#!/bin/sh\necho pdp11\n")
    (other / "uname").chmod(0o755)
    special = {1: ["SetEnv PATH=%s" % poor], 2: ["SetEnv PATH=%s:/usr/bin:/bin" % other]}
    server = Server(tmp_path / "server", 3, special, "mount --bind %s %s" % (there, here))
    try:
        server.give_key()
        server.known_hosts.write_text("".join(map(server.know, range(3))))
        foreign = server.launch_file(server.machine(2, "risc2", loader))
        code, printed = server.maap("deploy", foreign, root=here)
        assert code == 1 and re.search("red processor .* pdp11", flat(printed))
        assert not any(there.iterdir())
        file = server.launch_file(
            server.machine(0, "risc2", loader), server.machine(1, "risc3", loader),
            server.machine(1, "risc4", tmp_path / "elsewhere/devel/coop.sh"),
        )  # fmt: skip
        code, printed = server.maap("deploy", file, root=here)
        print(printed)
        found = sections(printed)
        assert code == 1 and re.search("green send .* yellow packages .* no-such-package", found["risc2"])
        assert "green workspace" in found["risc2"]
        assert re.search("red rsync .*sudo apt install rsync", found["risc3"])
        assert re.search("red folder .* %s .* %s " % (here, tmp_path / "elsewhere"), found["risc4"])
        arrived = {str(path.relative_to(there)) for path in there.rglob("*") if path.is_file()}
        assert arrived == {
            "src/pkg/nodes/fly.py", "src/pkg/config/cameras/risc1.yaml", "launch/x.launch", "maap", "devel/setup.sh",
            "devel/coop.sh", ".venv/bin/python", ".deployed", "apt-packages.txt",
        }  # fmt: skip

        own = {
            "flights/theirs.bag": "f", "logs/theirs": "l", "src/pkg/config/cameras/theirs.yaml": "c",
            "launch/my_fleet.yaml": "y", "install/theirs": "i",
        }  # fmt: skip
        gone = {"src/pkg/nodes/old.py": "o", "devel/lib/old": "d", ".venv/lib/old.py": "v", "launch/old.launch": "x"}
        for path, text in dict(own, **gone, **{"src/pkg/config/cameras/risc1.yaml": "calibrated there"}).items():
            (there / path).parent.mkdir(parents=True, exist_ok=True)
            (there / path).write_text(text)
        node = subprocess.Popen(
            [sys.executable, "-c", "print(1, flush=True); input()", str(here / "devel/lib/x"), "__name:=driver"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )  # fmt: skip
        try:
            node.stdout.readline()
            code, printed = server.maap("deploy", file, "--only", "risc2", root=here)
        finally:
            node.kill()
            node.communicate()
        assert code == 1 and "(driver)" in flat(printed)
        assert (there / "src/pkg/nodes/old.py").exists()

        code, printed = server.maap("deploy", file, "--only", "risc2", root=here)
        print(printed)
        assert {path: (there / path).read_text() for path in own} == own
        (backup,) = (there / ".deploy_backup").iterdir()
        kept = {str(path.relative_to(backup)): path.read_text() for path in backup.rglob("*") if path.is_file()}
        assert kept == {
            "src/pkg/nodes/old.py": "o", "devel/lib/old": "d", ".venv/lib/old.py": "v", "launch/old.launch": "x",
            "src/pkg/config/cameras/risc1.yaml": "calibrated there",
        }  # fmt: skip
        assert (there / "src/pkg/config/cameras/risc1.yaml").read_text() == "ours"
        assert " 5 files " in flat(printed)
        assert "install/theirs differs" in flat(printed)  # none is made here
        (here / "install").mkdir()
        code, printed = server.maap("deploy", file, "--only", "risc2", root=here)
        assert code == 0 and " 1 files " in flat(printed) and not (there / "install/theirs").exists()
        assert "green workspace" in flat(printed)
        (here / "devel" / "setup.sh").unlink()
        code, printed = server.maap("deploy", file, root=here)
        assert code == 2 and re.fullmatch("maap machines: %s .* ./maap build\n" % here, printed)
    finally:
        server.close()


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ([], "nowhere.launch"),
        (["b.launch"], "nowhere.launch and b.launch"),
        (["--yes"], "--yes"),
    ],
)
def test_wrong_usage_is_one_line(words, line, capsys):
    assert exit_code_of("check", "nowhere.launch", *words) == 2
    assert line in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("content", "words", "line"),
    [
        ("<machine name='a' address='127.0.0.1'/>", ["sped:=1"], " sped: .* speed"),
        ("<machine name='a' address='127.0.0.1'/>", ["--only", "a,b"], " machine b: .* a"),
        ("", [], "<machine>"),
        ("<machine name='a'/>", [], "roslaunch"),
        ("<arg name='ip'/><include file='$(arg ip)'/>", [], "'ip'"),
        ("<machine name='a' address='127.0.0.1'/><node pkg='joy' type='x' name='x' machine='b'/>", [],
         "node x .* machine b, .*<machine>"),
    ],
)  # fmt: skip
def test_a_launch_file_that_does_not_do_is_one_line(content, words, line, tmp_path, capsys):
    file = tmp_path / "x.launch"
    file.write_text("<launch><arg name='speed' default='1'/>%s</launch>" % content)
    assert exit_code_of("check", file, *words) == 2
    (printed,) = capsys.readouterr().err.splitlines()
    assert re.match("maap machines: .*" + line, printed)


YOURS = ["risc%d_address:=127.0.9.%d" % (number, number) for number in range(1, 5)]


@pytest.mark.parametrize(
    ("words", "missing"),
    [
        ([], [word.partition(":=")[0] for word in YOURS]),
        ([ROOT / "launch/Multi_Machine_Experiment.launch", *YOURS[:2]], ["risc3_address", "risc4_address"]),
        (YOURS, ["fleet"]),
        (["machine:=local"], ["fleet"]),
    ],
)
def test_nobody_knocks_before_every_address_is_named(words, missing, monkeypatch, capsys):
    monkeypatch.setenv("RISC_MAAP_ROOT", str(ROOT))
    monkeypatch.setattr(socket, "create_connection", lambda *_: pytest.fail("it knocks"))
    monkeypatch.setattr(machines, "run", lambda *_: pytest.fail("it goes on"))
    for action in machines.ACTIONS:
        assert exit_code_of(action, *words) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert re.findall(r"(\w+):=[A-Z]+\b", line.partition(", or ")[0])[-len(missing) :] == missing


def test_the_virtual_lab_brings_its_own_cortex(monkeypatch):
    monkeypatch.setenv("RISC_MAAP_ROOT", str(ROOT))
    monkeypatch.setattr(
        machines, "run", lambda experiment, *_: sum(len(computer.cortex) for computer in experiment.computers)
    )
    assert exit_code_of("check", "machine:=local", "lab:=true") == 0


@pytest.fixture
def fleet_value_in_this_process(monkeypatch):
    """Run fleet_value.py here: roslaunch would start it for every parameter, which takes longer than all the rest."""
    fleet_value = runpy.run_path(str(ROOT / "src/risc_control/nodes/fleet_value.py"))["main"]
    as_roslaunch_does = XmlLoader.param_value

    def param_value(self, verbose, name, ptype, value, textfile, binfile, command):
        words = shlex.split(command or "")
        if words and pathlib.Path(words[0]).name == "fleet_value.py":
            with pytest.MonkeyPatch.context() as call, contextlib.redirect_stdout(io.StringIO()) as out:
                call.setattr(sys, "argv", words)
                fleet_value()
            value = out.getvalue()
        return as_roslaunch_does(self, verbose, name, ptype, value, textfile, binfile, command)

    monkeypatch.setattr(XmlLoader, "param_value", param_value)


def guide_lines(pattern):
    """Lines that match in the guide's shell blocks, without comments."""
    text = (ROOT / "docs/many_machines.md").read_text()
    blocks = re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    lines = [line.partition("  #")[0] for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    return [line for line in lines if re.search(pattern, line)]


@pytest.mark.usefixtures("fleet_value_in_this_process")
def test_the_guides_fleet_files_are_let_pass(tmp_path, monkeypatch):
    """Its lines, as a reader types them: the fleet of the laboratory, and that of the virtual lab for laptops."""
    (tmp_path / "launch").symlink_to(ROOT / "launch")
    monkeypatch.setenv("RISC_MAAP_ROOT", str(ROOT))
    monkeypatch.chdir(tmp_path)
    done = []
    monkeypatch.setattr(machines, "run", lambda experiment, *_: done.append(experiment) or 0)
    (addresses,) = guide_lines("^addresses=")
    script = "\n".join([*guide_lines("^sed "), addresses, 'printf "%s\\n" $addresses'])
    words = run("bash", "-euc", script, cwd=str(tmp_path)).split()
    assert exit_code_of("check", *words) == 0
    (real,) = {host for computer in done[0].computers for host in computer.cortex}
    assert real.startswith("192.168.0.")
    assert [computer.vehicles for computer in done[0].computers] == [()] + 3 * [("192.168.1.1",)]

    (check,) = guide_lines("machines check .*lab:=true")
    more = run("bash", "-euc", 'printf "%%s\\n" %s' % check.partition("$addresses")[2], cwd=str(tmp_path)).split()
    assert exit_code_of("check", *words, *more) == 0
    base, virtual = done[1].computers[0].address, load_fleet(tmp_path / "my_lab.yaml")
    own = {address for line in guide_lines("ip address add") for address in re.findall(r"[0-9.]{7,}(?=/)", line)}
    assert virtual.mocap.host == base and {vehicle.address for vehicle in virtual.vehicles} == own
    assert not virtual.mocap.interface and virtual.mocap.stream_port > 1023
    assert not any(computer.cortex for computer in done[1].computers)


@pytest.mark.usefixtures("fleet_value_in_this_process")
def test_every_example_of_the_help_is_right(tmp_path, monkeypatch, capsys):
    """Examples are parsed and their files found, with the guide's own launch file; nothing is carried out."""
    shutil.copytree(str(ROOT / "launch"), str(tmp_path / "launch"))
    (own,) = re.findall(r"^```xml\n(.*?)^```$", (ROOT / "docs/many_machines.md").read_text(), re.MULTILINE | re.DOTALL)
    (tmp_path / "launch/my_laboratory.launch").write_text(own)
    run("bash", "-euc", "\n".join(guide_lines("^sed .*my_fleet")), cwd=str(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PWD", str(tmp_path))
    monkeypatch.setenv("RISC_MAAP_ROOT", str(tmp_path))
    done = []
    monkeypatch.setattr(machines, "run", lambda experiment, *_: done.append(experiment) or 0)
    with pytest.raises(SystemExit):
        main(["--help"])
    lines = re.findall(r"^  ./maap machines (.*)$", capsys.readouterr().out, re.MULTILINE)
    assert [main(shlex.split(os.path.expandvars(line))) for line in lines] == [0, 0, 0], capsys.readouterr().err
    assert [len(experiment.computers) for experiment in done] == [4, 1, 2]
    assert done[0].computers[0].cortex == ("192.168.0.5",)
    assert [(c.name, c.login, len(c.vehicles)) for c in done[2].computers] == [
        ("risc2", "pilot@192.168.0.11", 1), ("risc3", "pilot@192.168.0.12", 1)]  # fmt: skip


def exit_code_of(*words):
    try:
        return main([str(word) for word in words])
    except SystemExit as ended:
        return ended.code
