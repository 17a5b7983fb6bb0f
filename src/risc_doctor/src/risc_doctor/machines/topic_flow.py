"""Would topics flow between this computer and another one, in both directions? Tested by connections like a node's.

`python -m risc_doctor.machines.topic_flow SECONDS` is the far end and stands for a node on that computer: it prints one
line of JSON, whether it reaches the master, and where others would find its topics; there it waits for a connection.
"""

import contextlib
import json
import os
import socket
import sys
from urllib.parse import urlsplit

from rosgraph.network import get_host_name

from risc_doctor.findings import Findings

_REACH_S = 2.0
_START_S = 15.0  # for Python to start on a slow laptop
_FAR_END = ["python", "-m", "risc_doctor.machines.topic_flow", "5"]


def check(session, here):
    """Findings: one for each direction that fails. here: our address for all machines."""
    with socket.create_server(("", 0)) as ours:  # in place of the master and of nodes here
        uri = "http://%s:%d" % (here, ours.getsockname()[1])
        line = session.loaded_line(_FAR_END, 2.0 * _START_S, uri)
        with contextlib.closing(session.channel(line, _START_S)) as channel:
            try:
                there = next(filter(None, map(outcome, channel.makefile("r"))), None)
                if there is None:
                    last = channel.makefile_stderr("r").read().strip().splitlines() or ["it printed nothing"]
                    return Findings("topics").say("no_program", reason=last[-1])
                return judge(session.computer, uri, there, trouble_with(there["uri"])[0])
            except TimeoutError:
                return Findings("topics").say("no_program", reason="it takes too long")


def outcome(line):
    """What the far end printed, None when it is not such a line. An env-loader may have printed before."""
    with contextlib.suppress(ValueError):
        found = json.loads(line)
        if isinstance(found, dict) and "master_uri" in found:
            return found
    return None


def judge(computer, uri, there, trouble):
    """Findings. uri: ours, as the far end was told; there: from `outcome`; trouble: in reaching the far end, or ""."""
    found, values = Findings("topics"), {"machine": computer.name, "address": computer.address}
    if there["master_uri"] != uri:
        return found.say("other_uri", uri=there["master_uri"])
    host = urlsplit(there["uri"]).netloc.rpartition(":")[0]  # .hostname would be in small letters
    if there["trouble"]:
        code = "name_unknown_there" if there["name_unknown"] else "not_there"
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


def trouble_with(uri):
    """(why no program answers at http://HOST:PORT/ as seen from this computer, "" when one does; whether the name HOST
    cannot be resolved).
    """
    parts = urlsplit(uri)
    try:
        socket.create_connection((parts.hostname, parts.port), _REACH_S).close()
    except socket.gaierror:
        return "the name %s cannot be resolved" % parts.hostname, True
    except TimeoutError:
        return "no answer from %s" % parts.netloc, False
    except OSError as error:
        return "%s: %s" % (parts.netloc, error.strerror or error), False
    return "", False


def main(limit_s):
    """Act like a node of this computer."""
    with socket.create_server(("", 0)) as server:
        master_uri = os.environ["ROS_MASTER_URI"]
        own_uri = "http://%s:%d" % (get_host_name(), server.getsockname()[1])  # as a node tells it to its master
        trouble, name_unknown = trouble_with(master_uri)
        told = {"master_uri": master_uri, "trouble": trouble, "name_unknown": name_unknown, "uri": own_uri}
        print(json.dumps(told), flush=True)
        server.settimeout(limit_s)
        with contextlib.suppress(TimeoutError):
            server.accept()[0].close()


if __name__ == "__main__":
    main(float(sys.argv[1]))
