"""Starting a whole launch file and ending it so that nothing is left behind."""

import contextlib
import functools
import http.client
import os
import pathlib
import random
import re
import signal
import socket
import subprocess
import time
import uuid
import xmlrpc.client

import psutil

from risc_lab.mortal import mortal

MARK = "RISC_MAAP_FLIGHT"  # every process of a flight carries its identity in this environment variable
_PORTS = range(15000, 30000)  # of TCP, for masters and pages
_MASTER_PATIENCE_S = 20.0  # after that roslaunch starts one of its own
_ATTEMPTS = 50  # to find one that is free


class PortReservation:
    """A part of the loopback network that belongs to one flight: 127.<n>.*.*, told apart by <n>.

    The reservation is a listening socket, so it ends with this process and the roslaunch that it is passed on to
    (`Launch`), also when these are killed.
    """

    PORT = 1510

    def __init__(self, numbers=range(78, 127)):  # 127.77 is that of the shipped fleet files, for `maap lab`
        for number in numbers:
            guard = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            try:
                guard.bind(("127.%d.0.254" % number, self.PORT))
                guard.listen(1)
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:  # an orphaned lab?
                    probe.bind(("127.%d.0.1" % number, self.PORT))
            except OSError:
                guard.close()
                continue
            self._guard = guard
            self.subnet = "127.%d" % number
            return
        raise RuntimeError("no free loopback subnet: %d flights are running already" % len(numbers))

    def fileno(self):
        """Descriptor of the reservation: while any process has it open, the subnet is taken."""
        return self._guard.fileno()

    def close(self):
        """Release the subnet."""
        self._guard.close()


def free_tcp_port(*preferred):
    """A TCP port on 127.0.0.1 on which no program listens: the preferred one, unless it is taken.

    It is outside the range from which Linux assigns ports to programs, so it stays free until it is used.
    """
    for port in (*preferred, *random.sample(_PORTS, _ATTEMPTS)):
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return probe.getsockname()[1]
    raise RuntimeError("this computer has no free TCP port left")


class Launch:
    """One roslaunch, and a roscore unless one runs at its port, in sessions of their own, their output in a file.

    A roslaunch that owns the master ends everything when that dies; here the nodes go on with the connections that they
    have. However the caller dies, nothing is left behind: the kernel terminates both then, roslaunch ends its nodes,
    and the vehicle nodes land their vehicles. (The kernel watches the thread that starts it: let that be the main one.)
    """

    def __init__(self, launch_file, arguments, folder, master_port, reservation=None):
        """Start it. arguments: {name: value}; folder: for its log and ROS home; reservation: kept open by it, too."""
        self.identity = uuid.uuid4().hex
        self.log_path = pathlib.Path(folder) / "roslaunch.log"
        environment = {
            **os.environ,
            MARK: self.identity,
            "ROS_MASTER_URI": "http://127.0.0.1:%d" % master_port,
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(folder),
            "ROS_LOG_DIR": str(pathlib.Path(folder) / "ros_log"),
            "PYTHONUNBUFFERED": "1",
        }
        environment.pop("ROS_HOSTNAME", None)
        arguments = ["%s:=%s" % item for item in arguments.items()]
        with self.log_path.open("wb") as log:
            start = functools.partial(
                subprocess.Popen,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment,
                pass_fds=() if reservation is None else (reservation.fileno(),),
                start_new_session=True,  # a Ctrl-C at the terminal is for us: the vehicles must land first
            )
            self._core = None
            if not _listens(master_port):
                self._core = start(mortal("TERM", ["roscore", "-p", master_port]))
                wait_until(lambda: _is_up(master_port) or self._core.poll() is not None, _MASTER_PATIENCE_S, 0.02)
            self._process = start(mortal("TERM", ["roslaunch", "--skip-log-check", launch_file, *arguments]))

    def running(self):
        """Whether roslaunch is alive; it ends by itself when a required node dies."""
        return self._process.poll() is None

    def stop(self, patience_s=30.0):
        """End all nodes and the master, first by SIGINT. Returns the commands of processes that had to be killed."""
        started = [process for process in (self._process, self._core) if process is not None]
        for process in started:
            process.send_signal(signal.SIGINT)  # nothing happens to one that has ended
            try:
                process.wait(patience_s)
            except subprocess.TimeoutExpired:
                process.kill()
        leftovers = end_processes(self.identity)
        for process in started:
            process.wait()
        return sorted(leftovers.values())

    def log_tail(self, lines=15):
        """The last lines that roslaunch and its nodes printed."""
        text = self.log_path.read_text(encoding="utf-8", errors="replace")
        return "\n".join(text.splitlines()[-lines:])


def marked_processes(identity):
    """{process id: command} of the processes of one flight, without the caller."""
    return all_marked_processes().get(identity, {})


def all_marked_processes():
    """{identity: {process id: command}} of all flights, without the caller."""
    found = {}
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):  # it ended while we looked, or it belongs to another user
            identity = process.environ().get(MARK)
            if identity and process.pid != os.getpid():
                found.setdefault(identity, {})[process.pid] = " ".join(process.cmdline())
    return found


def end_processes(identity):
    """End what is left of a flight. Returns {process id: command} of what that was."""
    leftovers = marked_processes(identity)
    for number in (signal.SIGTERM, signal.SIGKILL):
        for pid in marked_processes(identity):
            send_signal(pid, number)
        wait_until(lambda: not marked_processes(identity), 3.0)
    return leftovers


def wait_until(done, patience_s, period_s=0.1):
    """Whether `done` came true in time."""
    deadline = time.monotonic() + patience_s
    while not done():
        if time.monotonic() > deadline:
            return False
        time.sleep(period_s)
    return True


def _listens(port):
    """Whether a program of this computer listens on a TCP port."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def _is_up(port):
    """Whether a roscore listens and has set its /run_id: a roslaunch that comes sooner sets one of its own, and
    ends because of that.
    """
    master = xmlrpc.client.ServerProxy("http://127.0.0.1:%d" % port)
    try:
        return bool(master.hasParam("/launching", "/run_id")[2])
    except (OSError, http.client.HTTPException, xmlrpc.client.Error):
        return False


def any_busy(pids):
    """Whether a thread of one of the processes runs or waits for a processor."""
    for pid in pids:
        for path in pathlib.Path("/proc/%d/task" % pid).glob("*/stat"):
            with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it ended while we looked
                if path.read_text(errors="replace").rpartition(")")[2].split()[0] == "R":  # its name may hold anything
                    return True
    return False


def send_signal(pid, number):
    """Signal a process, which may be gone."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, number)


def program_of(words):
    """Usual name of a command line: roslaunch for ["/usr/bin/python3", "-u", "/x/roslaunch", "a.launch"]."""
    words = list(words)
    if words and re.match("python|bash|sh$|nice$|env$", os.path.basename(words[0])):
        if "-m" in words[:-1]:
            return words[words.index("-m") + 1]
        scripts = [word for word in words[1:] if not word.startswith("-")]
        words = scripts[:1] if scripts and words[1] != "-c" else words
    return os.path.basename(words[0]) if words else ""


def argument_of(words, name):
    """Value of a remapping argument NAME:=VALUE on a command line, or ""."""
    return next((word[len(name) + 2 :] for word in words if word.startswith(name + ":=")), "")
