"""Logging in on another computer exactly as roslaunch does it, and running commands there that always end."""

import base64
import contextlib
import hashlib
import logging
import os
import shlex
import socket
import subprocess
from dataclasses import dataclass

import paramiko
from roslaunch.remoteprocess import ssh_check_known_hosts

from risc_doctor.findings import finding

KEY_FILES = "id_ed25519", "id_ecdsa", "id_rsa"  # in ~/.ssh: those that paramiko tries by itself
MASTER_PORT = 11311  # of a launch from here
CONNECT_S = 5.0  # for a computer in the same laboratory to answer
_SENTENCE = 300  # characters of what a program has printed that a sentence takes
_MARGIN_S = 3.0  # that a far command gets to be ended by its own limit

logging.getLogger("paramiko").addHandler(logging.NullHandler())  # it would print tracebacks of what we report


class MachineError(Exception):
    """Nothing more can be done with a computer; `finding` says why."""

    def __init__(self, check, code, **values):
        self.finding = finding(check, code, **values)
        super().__init__(self.finding.text)


@dataclass(frozen=True)
class Answer:
    """What a command printed, and how it ended."""

    code: int  # None: it took longer than its limit
    out: str
    err: str

    def reason(self):
        """The last line that it printed when something went wrong, for a sentence."""
        if self.code is None:
            return "it takes too long"
        lines = (self.err.strip() or self.out.strip()).splitlines()
        return lines[-1].strip()[:_SENTENCE] if lines else "exit code %d without a word" % self.code


def reach(computer):
    """Open a TCP connection to the ssh port and close it. Raises MachineError with the cause."""
    address, _ = resolve(computer)
    try:
        socket.create_connection((address, computer.port), CONNECT_S).close()
    except OSError as error:
        raise unreachable(error, address, computer.port) from None


def unreachable(error, address, port):
    """The MachineError for an OSError of a TCP connection to an ssh port."""
    if isinstance(error, socket.gaierror):
        code = "unknown_name"
    elif isinstance(error, ConnectionRefusedError):
        code = "refused"
    else:
        code = "silent" if isinstance(error, TimeoutError) else "unreachable"
    values = {"where": "%s port %d" % (address, port), "reason": error.strerror or error, "limit_s": CONNECT_S}
    return MachineError("network", code, address=address, **values)


def resolve(computer):
    """(address, {option: value}) of ~/.ssh/config, as roslaunch reads it."""
    options = {}
    with contextlib.suppress(OSError, paramiko.SSHException):  # no file, or none that roslaunch would heed
        config = paramiko.SSHConfig()
        with open(os.path.expanduser("~/.ssh/config"), encoding="utf-8") as text:
            config.parse(text)
        options = config.lookup(computer.address)
    return options.get("hostname", computer.address), options


def known_host_keys(strict=False):
    """The host keys that roslaunch believes, as paramiko.HostKeys.

    strict: raises ValueError or InvalidHostKey where a file holds a line that is no entry; the rest of it is not read.
    """
    keys, broken = paramiko.HostKeys(), (ValueError, paramiko.hostkeys.InvalidHostKey)  # roslaunch complains of those
    for path in ("/etc/ssh/ssh_known_hosts", os.path.expanduser("~/.ssh/known_hosts")):
        with contextlib.suppress(OSError, *(() if strict else broken)):
            keys.load(path)
    return keys


def connect(computer):
    """Log in with a key, as roslaunch 1.15 does it. Returns a Session. Raises MachineError."""
    address, options = resolve(computer)
    client = paramiko.SSHClient()
    complaint = ssh_check_known_hosts(client, address, computer.port, computer.user)
    if complaint:
        raise _unknown_host(complaint, computer, address)
    login = {"timeout": CONNECT_S, "banner_timeout": CONNECT_S, "auth_timeout": 2.0 * CONNECT_S}
    if computer.password is None:
        login["key_filename"] = [os.path.expanduser(path) for path in options.get("identityfile", [])] or None
    else:  # then roslaunch ignores the IdentityFile
        login["password"] = computer.password
    try:
        client.connect(address, computer.port, computer.user or options.get("user"), **login)
    except paramiko.BadHostKeyException as error:
        raise _bad_host_key(error, computer, address) from None
    except paramiko.PasswordRequiredException:
        raise MachineError("login", "passphrase") from None
    except paramiko.AuthenticationException:
        raise MachineError("login", "refused", login=computer.login, line=copy_id_line(computer)) from None
    except (paramiko.SSHException, EOFError) as error:  # EOFError: closed while the keys were exchanged
        raise _ssh_problem(str(error) or "it hangs up", computer, address) from None
    except OSError as error:
        raise unreachable(error, address, computer.port) from None
    session = Session(client, computer)
    if ":" in session.here:
        session.close()
        raise MachineError("network", "ipv6_only", address=computer.address)
    return session


def server_key(address, port):
    """The host key that a server shows, None when it shows none in time."""
    with contextlib.suppress(OSError, EOFError, paramiko.SSHException):
        with paramiko.Transport(socket.create_connection((address, port), CONNECT_S)) as transport:
            transport.banner_timeout = CONNECT_S
            transport.start_client(timeout=CONNECT_S)
            return transport.get_remote_server_key()
    return None


def fingerprint(key):
    """As ssh-keygen -l prints it. key: paramiko.PKey."""
    digest = base64.b64encode(hashlib.sha256(key.asbytes()).digest()).decode().rstrip("=")
    return "SHA256:%s (%s)" % (digest, key.get_name())


def host_name(address, port):
    """How known_hosts calls a server."""
    return address if port == 22 else "[%s]:%d" % (address, port)


def _unknown_host(complaint, computer, address):
    if "corrupt" in complaint:
        return MachineError("host key", "corrupt")
    key = server_key(address, computer.port)
    if key is None:
        return _ssh_problem("no ssh greeting", computer, address)
    name = host_name(address, computer.port)
    entries = [entry for entry in known_host_keys()._entries if entry.key == key]
    others = [other for entry in entries for other in entry.hostnames if other[:1] != "|"]
    code = "without_port" if name in others else "other_name" if others else "unknown"
    other = others[0] if others else ""
    return MachineError("host key", code, name=name, address=address, other=other, key=fingerprint(key))


def _bad_host_key(error, computer, address):
    name = host_name(address, computer.port)
    types = sorted(known_host_keys().lookup(name) or {})
    code = "changed" if error.key.get_name() in types else "other_type"
    return MachineError("host key", code, name=name, types=" and ".join(types), key=fingerprint(error.key))


def _ssh_problem(error, computer, address):
    if "not found in known_hosts" in error:
        return MachineError("host key", "not_found", name=host_name(address, computer.port))
    if "No authentication methods" in error:
        return MachineError("login", "no_key")
    return MachineError("network", "no_ssh", where="%s port %d" % (address, computer.port), reason=error)


def copy_id_line(computer):
    """The command that brings our key to a computer."""
    port = "" if computer.port == 22 else "-p %d " % computer.port
    return "ssh-copy-id %s%s" % (port, computer.login)


class Session:
    """An open login. Every command has a limit, and is ended there, too, when it takes longer.

    All of them raise MachineError when the connection is lost.
    """

    def __init__(self, client, computer):
        self._client = client
        self.computer = computer
        self.here = client.get_transport().sock.getsockname()[0]  # our address, as that computer sees it

    def close(self):
        """Log out."""
        self._client.close()

    def loaded(self, arguments, limit_s):
        """Run a command through the env-loader. Returns an Answer."""
        return self.shell(self.loaded_line(arguments, limit_s), limit_s)

    def loaded_line(self, arguments, limit_s, master_uri=None):
        """A line of shell that runs a command through the env-loader, in the words that roslaunch uses.

        master_uri: None = where the master of a launch from here will be.
        """
        master_uri = master_uri or "http://%s:%d" % (self.here, MASTER_PORT)
        words = ["env", "ROS_MASTER_URI=%s" % master_uri, "timeout -k 1 %g" % limit_s, self.computer.env_loader]
        return " ".join([*words, shlex.join(arguments)])

    def limited(self, script, limit_s):
        """Run a shell script that its own limit ends there. Returns an Answer."""
        return self.shell("timeout -k 1 %g sh -c %s" % (limit_s, shlex.quote(script)), limit_s)

    def shell(self, line, limit_s):
        """Run a line of shell. Its standard input stays open: env-loaders take its end for the end of the session."""
        channel = self.channel(line)
        channel.settimeout(limit_s + _MARGIN_S)
        try:
            streams = channel.makefile("rb"), channel.makefile_stderr("rb")
            out, err = (stream.read().decode(errors="replace") for stream in streams)
            code = channel.recv_exit_status() if channel.status_event.wait(_MARGIN_S) else 255
        except TimeoutError:
            return Answer(None, "", "")
        finally:
            channel.close()
        if code == -1 and not self._client.get_transport().is_active():
            raise self._lost("while it ran a command")
        return Answer(None if code in (124, 137) else code, out, err)  # 124, 137: of `timeout`

    def channel(self, line):
        """Start a command in the login shell, whichever that is, and return its channel."""
        try:
            channel = self._client.get_transport().open_session(timeout=CONNECT_S)
            channel.settimeout(CONNECT_S)
            channel.exec_command(line)
        except (paramiko.SSHException, EOFError, OSError) as error:
            raise self._lost(error) from None
        return channel

    def _lost(self, error):
        return MachineError("network", "lost", machine=self.computer.name, reason=error)


class Here:
    """This computer, where roslaunch needs neither a login nor an env-loader."""

    def __init__(self, computer):
        self.computer = computer

    def loaded(self, arguments, limit_s):
        """Run a command in the environment that we have. Returns an Answer."""
        try:
            done = subprocess.run(
                arguments, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=limit_s, check=False
            )
        except subprocess.TimeoutExpired:
            return Answer(None, "", "")
        return Answer(done.returncode, done.stdout, done.stderr)
