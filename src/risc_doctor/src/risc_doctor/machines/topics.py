"""Do topics flow between this computer and another one, in both directions, as they will in a flight?"""

import contextlib
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time

from risc_doctor.findings import green, red
from risc_doctor.machines import workspace_digest
from risc_doctor.machines.echo import trouble_with

_TALK_S = 6.0  # for the first message; a second is usual
_START_S = 15.0  # for Python and rospy to start on a slow laptop
_MASTER_S = 20.0
_ECHO = "risc_doctor.machines.echo"
_ALL_PORTS = "nodes talk over any TCP port: open all of them between the machines, e.g. sudo ufw allow from %s"


class Master:
    """A ROS master of our own at a free port, for as long as the checks take."""

    def __init__(self):
        """Start it. Raises RuntimeError when it does not answer; whatever is raised, nothing is left behind."""
        with socket.socket() as probe:
            probe.bind(("", 0))
            self.port = probe.getsockname()[1]
        self._logs = tempfile.mkdtemp(prefix="machines")
        self._process = subprocess.Popen(
            ["rosmaster", "--core", "-p", str(self.port)],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env=dict(_nameless(), ROS_LOG_DIR=self._logs),  # with ROS_HOSTNAME=localhost only we would reach it
        )  # fmt: skip
        try:
            self._wait()
        except BaseException:
            self.close()
            raise

    def _wait(self):
        deadline = time.monotonic() + _MASTER_S
        while trouble_with("http://127.0.0.1:%d/" % self.port):
            if self._process.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError("no ROS master starts here: does `rosmaster --core` work?")
            time.sleep(0.05)

    def uri(self, address):
        """Where it is for a computer that knows us under this address."""
        return "http://%s:%d" % (address, self.port)

    def close(self):
        """End it."""
        self._process.kill()
        self._process.wait()
        shutil.rmtree(self._logs, ignore_errors=True)


def check(session, master, here, number):
    """Findings: one for each direction that fails. here: our address for all machines; number: of this one."""
    uri = master.uri(here)
    ours, theirs = "/machine%d/from_here" % number, "/machine%d/from_there" % number
    near = subprocess.Popen(
        [sys.executable, "-m", _ECHO, ours, theirs, str(_TALK_S + 2.0 * _START_S)],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        env=dict(_nameless(), ROS_MASTER_URI=uri, ROS_IP=here),
    )  # fmt: skip
    try:
        answer = session.loaded(["python", "-m", _ECHO, theirs, ours, str(_TALK_S)], _TALK_S + _START_S, uri)
        there = outcome(answer.out)
        if there is None:
            return [red("topics", "the test program does not run there: " + answer.reason(), workspace_digest.CURE)]
        if there.get("heard") and there.get("answered"):
            return judge(session.computer, uri, there, {"heard": True})
        near.terminate()
        return judge(session.computer, uri, there, outcome(near.communicate(timeout=_START_S)[0]) or {})
    except subprocess.TimeoutExpired:
        return judge(session.computer, uri, there, {})
    finally:
        near.kill()
        near.communicate()


def outcome(printed):
    """What echo printed last, None when it printed nothing of the kind. An env-loader may have printed before."""
    for line in reversed(printed.splitlines()):
        with contextlib.suppress(ValueError):
            found = json.loads(line)
            if isinstance(found, dict) and "master_uri" in found:
                return found
    return None


def judge(computer, uri, there, here):
    """Findings from the two outcomes of echo. uri: of the master that the far one was told."""
    if there["master_uri"] != uri:
        return [
            red(
                "topics",
                "its env-loader sets ROS_MASTER_URI to %s" % there["master_uri"],
                "it must pass on the one that it is given: use devel/coop.sh as env-loader",
            )
        ]
    if there["master_trouble"]:
        text = "nodes there do not reach a ROS master here: %s" % there["master_trouble"]
        return [red("topics", text, "a firewall here? " + _ALL_PORTS % computer.address)]
    findings = []
    if not there["heard"]:
        cause = there.get("trouble") or "the node here answers, but its topic does not come through"
        cure = _cure_of_name(there, "here", "there") or "a firewall here? " + _ALL_PORTS % computer.address
        findings.append(red("topics", "nothing flows from here to %s: %s" % (computer.name, cause), cure))
    if not here.get("heard"):
        cause = here.get("trouble") or "the node there answers, but its topic does not come through"
        name = _host(there["uri"])
        cure = "a firewall there? " + _ALL_PORTS % "ADDRESS_OF_THIS_COMPUTER"
        if name not in _addresses(computer.address):
            cause = "nodes there say that they are at %s, but %s is at %s (%s)" % (
                name, computer.name, computer.address, cause,
            )  # fmt: skip
            cure = (
                "a wrong ROS_IP or ROS_HOSTNAME there: devel/coop.sh sets ROS_IP by itself; remove both from the "
                "env-loader, ~/.profile and /etc/environment there"
            )
        findings.append(red("topics", "nothing flows from %s to here: %s" % (computer.name, cause), cure))
    return findings or [green("topics", "they flow in both directions (nodes there are at %s)" % _host(there["uri"]))]


def _cure_of_name(outcome_there, where, elsewhere):
    if "resolved" in outcome_there.get("trouble", ""):
        return "set ROS_IP %s to this computer's address, or add the name to /etc/hosts %s" % (where, elsewhere)
    return ""


def _host(uri):
    return uri.partition("//")[2].rpartition(":")[0]


def _addresses(name):
    """A name and its addresses."""
    with contextlib.suppress(OSError):
        return {name} | {info[4][0] for info in socket.getaddrinfo(name, None)}
    return {name}


def _nameless():
    """Our environment without what it says that this computer is called (ROS_HOSTNAME would win over ROS_IP)."""
    return {name: value for name, value in os.environ.items() if name not in ("ROS_HOSTNAME", "ROS_IP")}
