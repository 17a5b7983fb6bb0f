"""Would topics flow between this computer and another one, in both directions? Connections as nodes make them tell."""

import contextlib
import json
import socket
from urllib.parse import urlsplit

from risc_doctor.findings import Findings
from risc_doctor.machines.echo import trouble_with

_START_S = 15.0  # for Python to start on a slow laptop
_ECHO = ["python", "-m", "risc_doctor.machines.echo", "5"]


def check(session, here):
    """Findings: one for each direction that fails. here: our address for all machines."""
    with socket.create_server(("", 0)) as ours:  # in place of the master and of nodes here
        uri = "http://%s:%d" % (here, ours.getsockname()[1])
        channel = session.channel(session.loaded_line(_ECHO, 2.0 * _START_S, uri))
        channel.settimeout(_START_S)
        try:
            lines = channel.makefile("r")
            there = next(filter(None, map(outcome, lines)), None)
            if there is None:
                last = channel.makefile_stderr("r").read().strip().splitlines()
                return Findings("topics").say("no_program", reason=last[-1] if last else "it prints nothing")
            return judge(session.computer, uri, there, trouble_with(there["uri"]))
        except TimeoutError:
            return Findings("topics").say("no_program", reason="it takes too long")
        finally:
            channel.close()


def outcome(line):
    """What echo printed, None when it is no such line. An env-loader may have printed before."""
    with contextlib.suppress(ValueError):
        found = json.loads(line)
        if isinstance(found, dict) and "master_uri" in found:
            return found
    return None


def judge(computer, uri, there, trouble):
    """Findings. uri: of ours, as the far one was told; there: of `outcome`; trouble: with reaching the far one."""
    found, values = Findings("topics"), {"machine": computer.name, "address": computer.address}
    if there["master_uri"] != uri:
        return found.say("other_uri", uri=there["master_uri"])
    host = urlsplit(there["uri"]).netloc.rpartition(":")[0]  # .hostname would be in small letters
    if there["trouble"]:
        code = "name_unknown_there" if "resolved" in there["trouble"] else "not_there"
        found.say(code, cause=there["trouble"], **values)
    if trouble:
        code = "not_here" if host in _addresses(computer.address) else "other_address"
        found.say(code, cause=trouble, host=host, **values)
    return found or found.say("good", host=host)


def _addresses(name):
    """A name and its addresses."""
    with contextlib.suppress(OSError):
        return {name} | {info[4][0] for info in socket.getaddrinfo(name, None)}
    return {name}
