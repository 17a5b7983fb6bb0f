"""coop.sh, the env-loader of <machine> tags, behind a real sshd; and that no launch outlives its session there."""

import contextlib
import getpass
import os
import pathlib
import queue
import re
import shutil
import signal
import socket
import subprocess
import threading
import xmlrpc.client
import xmlrpc.server

import pytest

from risc_lab.ros.launching import free_tcp_port
from risc_lab.testing import LIMIT_S, wait_for

ROOT = pathlib.Path(__file__).resolve().parents[1]
COOP = ROOT / "devel/coop.sh"
SOURCE = ROOT / "src/risc_doctor/machines/coop.sh.in"
BARE = {"HOME": os.environ.get("HOME", "/root"), "PATH": "/usr/bin:/bin"}
FROM_BASE = "10.77.0.1 40000 10.77.0.2 22"  # SSH_CONNECTION of a login from another machine
REFUSED = "already runs /risc1/driver "


def coop(*command, path=COOP, **variables):
    """Run the env-loader on this computer. Returns the completed process."""
    return subprocess.run(
        [str(path), *command],
        env=dict(BARE, **variables),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
    )


def variables_of(text):
    return dict(line.partition("=")[::2] for line in text.splitlines())


# ---------------------------------------------------------------- a machine that is reached by ssh


class Sshd:
    """A real sshd of this login on the loopback interface, with keys of its own."""

    def __init__(self, folder):
        self.folder = folder
        self.port = free_tcp_port()
        for key in ("host_key", "id_ed25519"):
            subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(folder / key)], check=True)
        shutil.copy(str(folder / "id_ed25519.pub"), str(folder / "authorized_keys"))
        algorithm, key = (folder / "host_key.pub").read_text().split()[:2]
        lines = ["%s %s %s" % (name, algorithm, key) for name in ("[127.0.0.1]:%d" % self.port, "127.0.0.1")]
        (folder / "known_hosts").write_text("\n".join(lines) + "\n")
        settings = {
            "Port": self.port,
            "ListenAddress": "127.0.0.1",
            "HostKey": folder / "host_key",
            "AuthorizedKeysFile": folder / "authorized_keys",
            "StrictModes": "no",
            "PasswordAuthentication": "no",
            "PidFile": "none",
        }
        (folder / "sshd_config").write_text("".join("%s %s\n" % item for item in settings.items()))
        if os.geteuid() == 0:
            os.makedirs("/run/sshd", exist_ok=True)  # for sshd's privilege separation; its service makes it at boot
        with (folder / "sshd.log").open("w") as log:
            self._process = subprocess.Popen(
                ["/usr/sbin/sshd", "-D", "-e", "-f", str(folder / "sshd_config")], stdout=log, stderr=log
            )
        wait_for(self._answers, "sshd answers")

    def _answers(self):
        assert self._process.poll() is None, (self.folder / "sshd.log").read_text()
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    def popen(self, command, **options):
        """A command in a login without a terminal. Its input stays open, as that of paramiko does."""
        ssh = ["ssh", "-F", "none", "-p", str(self.port), "-i", str(self.folder / "id_ed25519"), "-o", "BatchMode=yes"]
        ssh += ["-o", "UserKnownHostsFile=%s" % (self.folder / "known_hosts"), "127.0.0.1", command]
        pipe = subprocess.PIPE
        return subprocess.Popen(ssh, stdin=pipe, stdout=pipe, stderr=pipe, text=True, **options)

    def run(self, command):
        """Returns (exit code, output, errors)."""
        process = self.popen(command)
        output, errors = process.communicate(timeout=LIMIT_S)
        return process.returncode, output, errors

    def close(self):
        self._process.terminate()
        self._process.wait()


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    sshd = Sshd(tmp_path_factory.mktemp("sshd"))
    yield sshd
    sshd.close()


# ---------------------------------------------------------------- environment


def test_the_script_is_clean_and_the_build_keeps_it_fresh():
    done = subprocess.run(["shellcheck", "-s", "sh", str(SOURCE)], stdout=subprocess.PIPE, text=True)
    assert done.returncode == 0, done.stdout
    python = str(ROOT / ".venv/bin/python")
    assert COOP.read_text() == SOURCE.read_text().replace("@PYTHON_EXECUTABLE@", python), "./maap build"


def test_a_command_meets_the_environment_of_a_login(machine):
    """Even if a .bashrc has set up other workspaces."""
    login = subprocess.run(
        ["sh", "-c", ". %s/devel/setup.sh && env" % ROOT], env=BARE, stdout=subprocess.PIPE, text=True, check=True
    )
    elsewhere = (
        "CMAKE_PREFIX_PATH=/other PYTHONPATH=/other ROS_PACKAGE_PATH=/other LD_LIBRARY_PATH=/other CATKIN_SHELL=bash"
    )
    code, output, errors = machine.run(
        "env %s PATH=/other:$PATH ROS_MASTER_URI=http://127.0.0.1:11311 %s env" % (elsewhere, COOP)
    )
    assert (code, errors) == (0, "")
    assert all(re.match(r"\w+=", line) for line in output.splitlines()), "env-loaders print nothing"
    wanted, found = variables_of(login.stdout), variables_of(output)
    assert found["PATH"].startswith(wanted.pop("PATH")), "the workspace's Python first, then Debian's programs"
    assert found["ROS_MASTER_URI"] == "http://127.0.0.1:11311" and found["ROS_IP"] == "127.0.0.1"
    ignored = {"ROS_MASTER_URI", "PWD", "OLDPWD", "SHLVL", "_", "HOME"}
    assert {name: found.get(name) for name in wanted if name not in ignored} == {
        name: value for name, value in wanted.items() if name not in ignored
    }
    assert "/other" not in output.replace(found["PATH"], "")


def test_it_is_found_through_links_and_passes_arguments_and_exit_codes(machine, tmp_path):
    (tmp_path / "ws").symlink_to(ROOT / "devel")
    (tmp_path / "coop").symlink_to("ws/coop.sh")
    code, output, errors = machine.run(
        "env ROS_MASTER_URI=http://localhost:11311 %s/coop python3 -c "
        "'import sys, risc_control; print(sys.executable, sys.argv[1:]); sys.exit(7)' 'two words' --extend" % tmp_path
    )
    assert (code, errors) == (7, "")
    assert output == "%s ['two words', '--extend']\n" % (ROOT / ".venv/bin/python3")


def test_without_ssh_it_is_a_login_on_this_computer():
    done = coop("env")
    found = variables_of(done.stdout)
    assert (found["ROS_MASTER_URI"], found["ROS_IP"]) == ("http://localhost:11311", "127.0.0.1")
    assert done.stderr == ""


def test_so_it_is_on_a_computer_without_a_network(laboratory):
    done = laboratory("exec unshare --net sh -c 'ip link set lo up && exec %s env'" % COOP)
    assert done.stderr == "" and variables_of(done.stdout)["ROS_IP"] == "127.0.0.1"


@pytest.fixture(scope="module")
def laboratory():
    """Runs a script on a host with two networks: 10.77.0.2/24 and 10.88.0.2/24, and no way anywhere else."""
    setup = "ip link set lo up && ip link add one type veth peer name two && ip link set one up && ip link set two up"
    setup += " && ip addr add 10.77.0.2/24 dev one && ip addr add 10.88.0.2/24 dev two && "
    enter = ["unshare", "--net"] if os.geteuid() == 0 else ["unshare", "--net", "--map-root-user"]

    def run(script, **variables):
        environment = dict(BARE, PATH="/usr/bin:/bin:/usr/sbin:/sbin", **variables)
        command = [*enter, "sh", "-c", setup + script]
        return subprocess.run(command, env=environment, capture_output=True, text=True)

    probe = run("true")
    if probe.returncode:
        pytest.skip("no network namespaces here: " + probe.stderr.strip())
    return run


@pytest.mark.parametrize(
    ("variables", "address", "warning"),
    [
        ({"ROS_MASTER_URI": "http://10.77.0.1:11311"}, "10.77.0.2", ""),
        ({"ROS_MASTER_URI": "http://10.88.0.1:11311/"}, "10.88.0.2", ""),
        ({"ROS_MASTER_URI": "http://10.88.0.1:11311", "ROS_HOSTNAME": "risc2"}, "10.88.0.2", ""),
        ({"ROS_MASTER_URI": "http://10.88.0.1:11311", "ROS_IP": "10.77.0.2"}, "10.77.0.2", ""),
        ({"ROS_MASTER_URI": "http://10.88.0.1:11311", "ROS_IP": "10.88.0.9"}, "10.88.0.2", "ROS_IP=10.88.0.9 is no"),
        ({"ROS_MASTER_URI": "http://10.88.0.1:11311", "ROS_IP": "127.0.0.1"}, "10.88.0.2", "ROS_IP=127.0.0.1 is no"),
        # no route leads to the master, but the base station has come by ssh
        ({"ROS_MASTER_URI": "http://10.99.0.1:11311", "SSH_CONNECTION": FROM_BASE}, "10.77.0.2", ""),
    ],
)
def test_ros_ip_is_that_of_the_interface_that_reaches_the_master(laboratory, variables, address, warning):
    done = laboratory("exec %s env" % COOP, **variables)
    found = variables_of(done.stdout)
    assert (found["ROS_IP"], found.get("ROS_HOSTNAME")) == (address, None)
    assert done.stderr.count("\n") == bool(warning) and warning in done.stderr


def test_who_has_logged_in_by_ssh_may_use_it_for_a_master_there():
    found = variables_of(coop("env", SSH_CONNECTION=FROM_BASE).stdout)
    assert (found["ROS_MASTER_URI"], found["ROS_IP"]) == ("http://localhost:11311", "127.0.0.1")


def test_no_way_to_the_master_is_an_error(laboratory):
    done = laboratory("exec %s env" % COOP, ROS_MASTER_URI="http://10.99.0.1:11311")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("coop.sh: ") and "10.99.0.1" in done.stderr


@pytest.mark.parametrize(
    ("variables", "words"),
    [
        ({}, ("ROS_MASTER_URI is missing", "env ROS_MASTER_URI=http://")),
        ({"ROS_MASTER_URI": "10.77.0.1:11311"}, ("is not http://HOST:PORT", "base station")),
        ({"ROS_MASTER_URI": "http://10.77.0.1"}, ("is not http://HOST:PORT", "base station")),
        ({"ROS_MASTER_URI": "http://10.77.0.1:/"}, ("is not http://HOST:PORT", "base station")),
        ({"ROS_MASTER_URI": "http://risc.invalid:11311"}, ("'risc.invalid'", "/etc/hosts")),
        ({"ROS_MASTER_URI": "http://localhost:11311"}, ("this machine", "set ROS_IP and")),
        ({"ROS_MASTER_URI": "http://127.0.0.1:11311"}, ("this machine", "set ROS_IP and")),
    ],
)
def test_a_wrong_master_is_one_line_with_cause_and_cure(variables, words):
    done = coop("roslaunch", "-c", "risc2-0", SSH_CONNECTION=FROM_BASE, **variables)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert done.stderr.startswith("coop.sh: ") and all(word in done.stderr for word in words), done.stderr


def test_no_command_is_wrong_usage():
    done = coop()
    assert (done.returncode, done.stdout) == (2, "")
    assert 'coop.sh COMMAND ARGUMENTS..., or env-loader="%s"' % COOP in done.stderr


def test_a_workspace_that_is_not_built_says_so(tmp_path):
    alone = tmp_path / "coop.sh"
    shutil.copy(str(COOP), str(alone))
    done = coop("env", path=alone)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert "no setup.sh in %s" % tmp_path in done.stderr and "./maap build" in done.stderr
    (tmp_path / "setup.sh").write_text("echo cannot; return 22\n")
    done = coop("env", path=alone)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("cannot\ncoop.sh: %s/setup.sh failed" % tmp_path)
    alone.write_text(alone.read_text().replace("\npython=/", "\npython=/nowhere/"))
    done = coop("env", path=alone)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert "Python, /nowhere/" in done.stderr and "./maap machines deploy" in done.stderr


def test_a_workspace_that_is_half_built_says_so(tmp_path):
    """Its environment is there, its packages are not."""
    shutil.copy(str(COOP), str(tmp_path / "coop.sh"))
    (tmp_path / "setup.sh").write_text("PYTHONPATH=; export PYTHONPATH\n")
    for space in ("lib", "share"):
        (tmp_path / space).symlink_to(COOP.parent / space)
    launch = ("roslaunch", "-c", "laptop-0", "-u", "http://127.0.0.1:1/")
    done = coop(*launch, path=tmp_path / "coop.sh", ROS_MASTER_URI="http://127.0.0.1:11311")
    assert (done.returncode, done.stdout) == (1, ""), done.stderr
    assert "No module named 'risc_doctor'" in done.stderr and "Traceback" not in done.stderr


def test_the_install_space_gets_it_too(tmp_path):
    script = ROOT / "build/risc_doctor/cmake_install.cmake"
    command = ["cmake", "-DCMAKE_INSTALL_PREFIX=/ws/install", "-P", str(script)]
    subprocess.run(command, env=dict(BARE, DESTDIR=str(tmp_path)), stdout=subprocess.DEVNULL, check=True)
    installed = tmp_path / "ws/install/coop.sh"
    assert installed.read_text() == COOP.read_text() and os.access(str(installed), os.X_OK)
    # The rest of the space would take long to install; what coop.sh needs of it is its setup.sh.
    setup = "_CATKIN_SETUP_DIR=%s/devel\n" % ROOT + '. "$_CATKIN_SETUP_DIR/setup.sh"\n'
    (tmp_path / "ws/install/setup.sh").write_text(setup)
    done = coop("python", "-c", "import risc_control; print('found')", path=installed)
    assert (done.returncode, done.stdout, done.stderr) == (0, "found\n", "")
    done = coop("roslaunch", "-c", "risc2-0", path=installed)
    assert done.returncode == 2 and "coop.sh roslaunch: error: the following arguments are required: -u" in done.stderr


# ---------------------------------------------------------------- sessions

RUN_ID = "of_one_master"  # equal for all launches: it does not tell them apart
DRIVER = """<launch><group ns="risc1">
  <node pkg="rosout" type="rosout" name="driver" launch-prefix="%s"/>
</group></launch>"""
POLITE = "#!/bin/sh\ntrap 'echo interrupted >>{log}; exit' INT\necho started >>{log}\nwhile :; do sleep 0.1; done\n"
STUBBORN = "#!/bin/sh\ntrap '' INT TERM\necho started >>{log}\nwhile :; do sleep 0.1; done\n"


def processes_of(uri):
    """{pid: command} of the launch whose roslaunch has this server: guard, roslaunch, nodes and what they started."""
    found = {}
    for entry in pathlib.Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            is_guard = "session_guard.py" in command and uri in command
            if is_guard or b"RISC_MAAP_SESSION=" + uri.encode() in (entry / "environ").read_bytes():
                found[int(entry.name)] = command
    return found


def guards_of(uri):
    return [pid for pid, command in processes_of(uri).items() if "session_guard.py" in command]


class BaseStation:
    """The launching side, by hand: one server for what roslaunch and the master have there, and the ssh session."""

    def __init__(self, machine, folder, before=()):
        """before: server URIs of launches; which of their processes still run when ours appears is kept in `beside`."""
        self._machine, self._folder, self._before = machine, folder, before
        self._children = queue.Queue()
        self.beside = {}
        self.session = None
        self._server = xmlrpc.server.SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        self._server.register_instance(self)
        self._server.register_multicall_functions()
        self.uri = "http://127.0.0.1:%d/" % self._server.server_address[1]
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.05})
        self._thread.start()

    def _dispatch(self, method, arguments):
        """A call from the machine, to the parent roslaunch or to the master."""
        if method == "register":
            for other in self._before:
                self.beside.update(processes_of(other))
            self._children.put(arguments[1])
        return 1, "", RUN_ID if method == "getParam" else os.getpid()

    def open_session(self, variables=""):
        """The command that roslaunch gives to paramiko."""
        self.session = self._machine.popen(
            "env ROS_MASTER_URI=%s ROS_HOME=%s %s %s roslaunch -c 127.0.0.1-0 -u %s --run_id %s"
            % (self.uri, self._folder, variables, COOP, self.uri, RUN_ID)
        )

    def child(self):
        """XML-RPC client of the roslaunch on the machine, as soon as that has registered."""
        return xmlrpc.client.ServerProxy(self._children.get(timeout=LIMIT_S))

    def start(self, script=POLITE, variables=""):
        """Start a node with a body of shell. Returns the file that it writes to, and roslaunch's client."""
        log = self._folder / ("log%d" % self._server.server_address[1])
        program = log.with_suffix(".sh")
        program.write_text(script.format(log=log))
        program.chmod(0o755)
        self.open_session(variables)
        child = self.child()
        code, text, (succeeded, _) = child.launch(DRIVER % program)
        assert (code, len(succeeded)) == (1, 1), text
        wait_for(lambda: log.exists() and "started" in log.read_text(), "the node has started")
        return log, child

    def refused(self):
        """What the machine prints when it refuses to start."""
        output, errors = self.session.communicate(timeout=LIMIT_S)
        assert (self.session.returncode, output) == (1, ""), errors
        return errors

    def end(self):
        """End the launching roslaunch; its session may stay open, as after an outage that was not noticed."""
        if self._thread.is_alive():
            self._server.shutdown()
            self._server.server_close()
            self._thread.join()

    def close(self):
        self.end()
        for pid in processes_of(self.uri):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        if self.session:
            self.session.kill()
            self.session.communicate()


@pytest.fixture
def station(machine, tmp_path):
    """Makes launching sides; those that a test leaves running are ended."""
    made = []

    def make(**options):
        made.append(BaseStation(machine, tmp_path, **options))
        return made[-1]

    yield make
    for base in made:
        base.close()


def test_a_launch_that_is_ended_leaves_nothing(station):
    base = station()
    log, child = base.start()
    assert len(guards_of(base.uri)) == 1
    child.shutdown()
    assert base.session.wait(LIMIT_S) == 0
    assert log.read_text().split() == ["started", "interrupted"]
    assert processes_of(base.uri) == {}


def test_the_exit_code_of_roslaunch_comes_back(station):
    base = station()
    log, child = base.start()
    roslaunch = [pid for pid, words in processes_of(base.uri).items() if "bin/roslaunch -c" in words]
    os.kill(roslaunch[0], signal.SIGKILL)
    assert base.session.wait(LIMIT_S) == 128 + signal.SIGKILL
    assert log.read_text().split() == ["started", "interrupted"], "its nodes do not outlive it"
    assert processes_of(base.uri) == {}


def test_when_the_session_ends_so_does_everything_in_it(station):
    """Also a node that ignores SIGINT, and with a base station that does not answer."""
    base = station()
    base.start(STUBBORN)
    base.end()
    base.session.kill()
    wait_for(lambda: not processes_of(base.uri), "everything is gone")


def test_a_second_launch_never_starts_beside_a_first(station):
    first, second = station(), station()
    log, _ = first.start()
    second.open_session()
    errors = second.refused()
    assert errors.count("\n") == 1 and REFUSED in errors and first.uri in errors
    assert log.read_text().split() == ["started"], "the first goes on"
    first.end()
    assert guards_of(first.uri), "the first was not told"
    third = station(before=[first.uri])
    third.start()
    assert third.beside == {}
    assert log.read_text().split() == ["started", "interrupted"]
    assert first.session.wait(LIMIT_S) >= 0
    fourth = station()
    fourth.start(variables="RISC_MAAP_ALLOW_SECOND=1")
    assert processes_of(third.uri), "launches that share no vehicle may be allowed"


def test_of_two_launches_at_the_same_time_one_starts(station):
    bases = [station(), station()]
    for base in bases:
        base.open_session()
    wait_for(lambda: any(base.session.poll() is not None for base in bases), "one has given up")
    loser, winner = sorted(bases, key=lambda base: base.session.poll() is None)
    assert "(%s)" % winner.uri in loser.refused()
    winner.child().shutdown()
    assert winner.session.wait(LIMIT_S) == 0


def test_a_real_launch_over_ssh(machine, tmp_path):
    """roslaunch and paramiko themselves: a node starts, a second launch is refused with the reason, Ctrl-C ends all."""
    ssh = tmp_path / "home/.ssh"
    ssh.mkdir(parents=True)
    for name in ("id_ed25519", "known_hosts"):
        shutil.copy(str(machine.folder / name), str(ssh / name))
    program = tmp_path / "driver.sh"
    program.write_text(POLITE.format(log=tmp_path / "log"))
    program.chmod(0o755)
    loader = "env ROS_HOME=%s/far %s" % (tmp_path, COOP)
    tag = (
        '<machine name="far" address="127.0.0.1" ssh-port="%d" user="%s" env-loader="%s" default="true" timeout="%d"/>'
    )
    tag %= (machine.port, getpass.getuser(), loader, LIMIT_S)
    (tmp_path / "far.launch").write_text((DRIVER % program).replace("<launch>", "<launch>" + tag))

    def launch(name):
        port = free_tcp_port()
        # roslaunch goes by ssh even to its own address if the user there is another one than here
        environment = dict(os.environ, LOGNAME="somebody_else", HOME=str(tmp_path / "home"), PYTHONUNBUFFERED="1")
        environment.update(
            ROS_HOME=str(tmp_path / name), ROS_MASTER_URI="http://127.0.0.1:%d" % port, ROS_IP="127.0.0.1"
        )
        command = ["roslaunch", "--skip-log-check", "-p", str(port), str(tmp_path / "far.launch")]
        with (tmp_path / (name + ".txt")).open("w") as out:
            return subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, stdout=out, stderr=out)

    first = launch("first")
    try:
        wait_for(lambda: (tmp_path / "log").exists(), (tmp_path / "first.txt").read_text())
        uri = re.search(r"started roslaunch server (http://[\d.:]+/)", (tmp_path / "first.txt").read_text()).group(1)
        assert guards_of(uri)
        second = launch("second")
        assert second.wait(LIMIT_S) != 0
        assert re.search(r"%s.*\(%s\)" % (REFUSED, uri), (tmp_path / "second.txt").read_text())
        assert (tmp_path / "log").read_text().split() == ["started"]
    finally:
        first.send_signal(signal.SIGINT)
        assert first.wait(LIMIT_S) == 0
    wait_for(lambda: not processes_of(uri), "everything is gone")
    assert (tmp_path / "log").read_text().split() == ["started", "interrupted"]
