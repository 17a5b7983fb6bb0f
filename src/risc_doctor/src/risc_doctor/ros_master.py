"""The ROS master and its nodes, queried with timeouts. Needs no ROS."""

import concurrent.futures
import contextlib
import http.client
import socket
import threading
import urllib.parse
import xml.parsers.expat
import xmlrpc.client

CALLER = "/maap_doctor"
CALL_PATIENCE_S = 2.0
NODE_PATIENCE_S = 1.0
NAME_PATIENCE_S = 2.0
DEFAULT_URI = "http://localhost:11311"


class MasterError(Exception):
    """The master, or a node, does not answer; the text says why."""


class NobodyThereError(MasterError):
    """The computer is there, but nothing listens on the port."""


class SilentError(MasterError):
    """It does not answer in time."""


class UnknownHostError(MasterError):
    """The name of its computer is not known here."""


class _PatientTransport(xmlrpc.client.Transport):
    """A transport with a time-out."""

    def __init__(self, patience_s):
        super().__init__()
        self._patience_s = patience_s

    def make_connection(self, host):
        connection = super().make_connection(host)
        connection.timeout = self._patience_s
        return connection


def call(uri, method, *arguments, caller=(CALLER,), patience_s=CALL_PATIENCE_S):
    """Value that the slave or master API at a URI answers. caller: () for roslaunch's API. Raises MasterError."""
    try:
        host, _ = host_and_port(uri)
        if resolve(host) is None:
            raise UnknownHostError("the host name '%s' of %s is not known here" % (host, uri))
        proxy = xmlrpc.client.ServerProxy(uri, _PatientTransport(patience_s), allow_none=True)
        code, text, value = getattr(proxy, method)(*caller, *arguments)
    except TimeoutError:
        raise SilentError("no answer from %s within %g s" % (uri, patience_s)) from None
    except ConnectionRefusedError:
        raise NobodyThereError("nothing listens at %s" % uri) from None
    except xml.parsers.expat.ExpatError:
        raise MasterError("what answers at %s is not a ROS program" % uri) from None
    except (OSError, http.client.HTTPException, xmlrpc.client.Error, ValueError, TypeError) as error:
        raise MasterError("%s: %s" % (uri, error or type(error).__name__)) from None
    if code != 1:
        raise MasterError(str(text))
    return value


def resolve(name, patience_s=NAME_PATIENCE_S):
    """IPv4 address of a host name, or None when it is not resolved in time."""
    result = []

    def look_up():
        with contextlib.suppress(OSError, UnicodeError):
            result.append(socket.gethostbyname(name))

    thread = threading.Thread(target=look_up, daemon=True)  # a dead name server takes half a minute to time out
    thread.start()
    thread.join(patience_s)
    return result[0] if result else None


def host_and_port(uri):
    """(host, port) of a URI such as http://risc1:11311. Raises ValueError for any other text."""
    parts = urllib.parse.urlsplit(uri)
    if parts.scheme != "http" or not parts.hostname or not parts.port:
        raise ValueError("%r is not the address of a ROS master (http://HOST:11311)" % uri)
    return parts.hostname, parts.port


class Master:
    """A master that has answered once."""

    def __init__(self, uri):
        """Raises MasterError when nothing answers there."""
        self.uri = uri
        call(uri, "getPid")

    def parameter(self, name, default=None):
        """A parameter, or the default when it is not set. Raises MasterError when the master is gone."""
        return call(self.uri, "getParam", name) if call(self.uri, "hasParam", name) else default

    def publishers(self):
        """{topic: [node, ...]}. Raises MasterError."""
        return {topic: nodes for topic, nodes in call(self.uri, "getSystemState")[0] if nodes}

    def topics_of_type(self, kind):
        """Names of the topics of a type that are known. Raises MasterError."""
        return sorted(name for name, its_kind in call(self.uri, "getTopicTypes") if its_kind == kind)

    def ask_nodes(self):
        """{node: None when it answers, else a MasterError} of all registered nodes. Raises MasterError."""
        state = call(self.uri, "getSystemState")
        names = sorted({node for table in state for _, nodes in table for node in nodes if node != CALLER})
        with concurrent.futures.ThreadPoolExecutor(min(32, len(names) + 1)) as pool:
            return dict(zip(names, pool.map(self._ask_node, names)))

    def _ask_node(self, name):
        try:
            call(call(self.uri, "lookupNode", name), "getPid", patience_s=NODE_PATIENCE_S)
        except MasterError as error:
            return error
        return None
