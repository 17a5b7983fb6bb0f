"""The far end of a look at topics: `python -m risc_doctor.machines.echo SECONDS` stands for a node on that computer.

Prints one line of JSON: whether it reaches the master, and where others would find its topics; there it waits for one
connection, for so many seconds.
"""

import contextlib
import json
import os
import socket
import sys
from urllib.parse import urlsplit

from rosgraph.network import get_host_name

_REACH_S = 2.0


def trouble_with(uri):
    """Why no program answers at http://HOST:PORT/ as seen from this computer; "" when one does."""
    parts = urlsplit(uri)
    try:
        socket.create_connection((parts.hostname, parts.port), _REACH_S).close()
    except socket.gaierror:
        return "the name %s cannot be resolved" % parts.hostname
    except TimeoutError:
        return "no answer from %s" % parts.netloc
    except OSError as error:
        return "%s: %s" % (parts.netloc, error.strerror or error)
    return ""


def main(limit_s):
    """Stand for a node."""
    with socket.create_server(("", 0)) as server:
        master_uri = os.environ["ROS_MASTER_URI"]
        own_uri = "http://%s:%d" % (get_host_name(), server.getsockname()[1])  # as a node tells it to its master
        print(json.dumps({"master_uri": master_uri, "trouble": trouble_with(master_uri), "uri": own_uri}), flush=True)
        server.settimeout(limit_s)
        with contextlib.suppress(TimeoutError):
            server.accept()[0].close()


if __name__ == "__main__":
    main(float(sys.argv[1]))
