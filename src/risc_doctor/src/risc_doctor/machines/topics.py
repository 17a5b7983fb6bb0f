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

from risc_doctor.findings import Findings
from risc_doctor.machines.echo import trouble_with

_TALK_S = 6.0  # for the first message; a second is usual
_START_S = 15.0  # for Python and rospy to start on a slow laptop
_MASTER_S = 20.0
_ECHO = "risc_doctor.machines.echo"


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
            return Findings("topics").say("no_program", reason=answer.reason())
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
    found, values = Findings("topics"), {"machine": computer.name, "address": computer.address}
    if there["master_uri"] != uri:
        return found.say("other_uri", uri=there["master_uri"])
    if there["master_trouble"]:
        return found.say("no_master", trouble=there["master_trouble"], **values)
    host = _host(there["uri"])
    if not there["heard"]:
        cause = there.get("trouble") or "the node here answers, but its topic does not come through"
        found.say("name_unknown_there" if "resolved" in cause else "not_there", cause=cause, **values)
    if not here.get("heard"):
        cause = here.get("trouble") or "the node there answers, but its topic does not come through"
        code = "not_here" if host in _addresses(computer.address) else "other_address"
        found.say(code, cause=cause, host=host, **values)
    return found or found.say("good", host=host)


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
