"""Logging in on another computer exactly as roslaunch does it, and running commands there that always end."""

import base64
import contextlib
import hashlib
import logging
import os
import shlex
import socket
import subprocess
import threading
import time
from dataclasses import dataclass

import paramiko
from roslaunch.remoteprocess import ssh_check_known_hosts

from risc_doctor.findings import red

KEY_FILES = "id_ed25519", "id_ecdsa", "id_rsa"  # in ~/.ssh: those that paramiko tries by itself
MASTER_PORT = 11311  # of a launch from here
CONNECT_S = 5.0  # for a computer in the same laboratory to answer
_SENTENCE = 300  # characters of what a program has printed that a sentence takes
_MARGIN_S = 3.0  # that a far command gets to be ended by its own limit

logging.getLogger("paramiko").addHandler(logging.NullHandler())  # it would print tracebacks of what we report


class MachineError(Exception):
    """Nothing more can be done with a computer; `finding` says why."""

    def __init__(self, finding):
        super().__init__(finding.text)
        self.finding = finding


@contextlib.contextmanager
def visit(findings):
    """The sessions entered into the stack are closed at the end; a MachineError ends the visit as the last finding."""
    try:
        with contextlib.ExitStack() as sessions:
            yield sessions
    except MachineError as problem:
        findings.append(problem.finding)


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
        raise MachineError(red("network", *why_unreachable(error, address, computer.port))) from None


def why_unreachable(error, address, port):
    """(sentence, cure) for an OSError of a TCP connection to an ssh port."""
    where = "%s port %d" % (address, port)
    if isinstance(error, socket.gaierror):
        return (
            "%s: this name cannot be resolved" % address,
            "give its number as the address, or add the name to /etc/hosts here and on every other machine",
        )
    if isinstance(error, ConnectionRefusedError):
        return (
            "%s refuses the connection: the computer is there, its ssh server is not" % where,
            "on that computer:\nsudo apt install openssh-server && sudo systemctl enable --now ssh",
        )
    if isinstance(error, (socket.timeout, TimeoutError)):
        return (
            "no answer from %s within %g s" % (where, CONNECT_S),
            "is it switched on, in the same network, at this address (`ip address` there)? Does a firewall drop ssh?",
        )
    return (
        "no way to %s: %s" % (where, error.strerror or error),
        "look at the cable or the Wi-Fi here, then at `ip route get %s`; two subnets need a route on both sides"
        % address,
    )


def resolve(computer):
    """(address, {option: value}) of ~/.ssh/config, as roslaunch reads it."""
    options = {}
    with contextlib.suppress(OSError, paramiko.SSHException):  # no file, or none that roslaunch would heed
        config = paramiko.SSHConfig()
        with open(os.path.expanduser("~/.ssh/config"), encoding="utf-8") as text:
            config.parse(text)
        options = config.lookup(computer.address)
    return options.get("hostname", computer.address), options


def known_host_keys():
    """The host keys that roslaunch believes, as paramiko.HostKeys."""
    keys = paramiko.HostKeys()
    for path in ("/etc/ssh/ssh_known_hosts", os.path.expanduser("~/.ssh/known_hosts")):
        with contextlib.suppress(OSError, ValueError, paramiko.hostkeys.InvalidHostKey):  # roslaunch complains of those
            keys.load(path)
    return keys


def connect(computer):
    """Log in with a key, as roslaunch 1.15 does it. Returns a Session. Raises MachineError."""
    address, options = resolve(computer)
    client = paramiko.SSHClient()
    complaint = ssh_check_known_hosts(client, address, computer.port, computer.user)
    known = known_host_keys()
    if complaint:
        raise MachineError(_unknown_host(complaint, known, computer, address))
    login = {"timeout": CONNECT_S, "banner_timeout": CONNECT_S, "auth_timeout": 2.0 * CONNECT_S}
    if computer.password is None:
        login["key_filename"] = [os.path.expanduser(path) for path in options.get("identityfile", [])] or None
    else:  # then roslaunch ignores the IdentityFile
        login["password"] = computer.password
    user = computer.user or options.get("user")
    try:
        client.connect(address, computer.port, user, **login)
    except paramiko.BadHostKeyException as error:
        raise MachineError(_bad_host_key(error, known, computer, address)) from None
    except paramiko.PasswordRequiredException:
        raise MachineError(
            red("login", "the ssh key has a passphrase, and roslaunch cannot ask for it", "ssh-add (once a login)")
        ) from None
    except paramiko.AuthenticationException:
        raise MachineError(_refused(computer)) from None
    except (paramiko.SSHException, EOFError) as error:  # EOFError: closed while the keys were exchanged
        raise MachineError(_ssh_problem(str(error) or "it hangs up", computer, address)) from None
    except OSError as error:
        raise MachineError(red("network", *why_unreachable(error, address, computer.port))) from None
    session = Session(client, computer)
    if ":" in session.here:
        session.close()
        text = "%s leads there by IPv6 only, and nodes talk IPv4" % computer.address
        cure = "an IPv4 address in its <machine> tag, or of that name in /etc/hosts here and on every other machine"
        raise MachineError(red("network", text, cure))
    return session


def server_key(address, port):
    """The host key that a server shows, None when it shows none in time."""
    transport = None
    try:
        transport = paramiko.Transport(socket.create_connection((address, port), CONNECT_S))
        transport.banner_timeout = CONNECT_S
        transport.start_client(timeout=CONNECT_S)
        return transport.get_remote_server_key()
    except (OSError, EOFError, paramiko.SSHException):
        return None
    finally:
        if transport is not None:
            transport.close()


def fingerprint(key):
    """As ssh-keygen -l prints it. key: paramiko.PKey."""
    digest = base64.b64encode(hashlib.sha256(key.asbytes()).digest()).decode().rstrip("=")
    return "SHA256:%s (%s)" % (digest, key.get_name())


def host_name(address, port):
    """How known_hosts calls a server."""
    return address if port == 22 else "[%s]:%d" % (address, port)


def _unknown_host(complaint, known, computer, address):
    cure = "./maap machines setup writes the entry (it shows the fingerprint and asks)"
    if "corrupt" in complaint:
        return red(
            "host key",
            "~/.ssh/known_hosts (or /etc/ssh/ssh_known_hosts) cannot be read",
            "ssh-keygen -lf ~/.ssh/known_hosts names the line that is none; remove it",
        )
    key = server_key(address, computer.port)
    if key is None:
        return _ssh_problem("no ssh greeting", computer, address)
    full = host_name(address, computer.port)
    others = [name for entry in known._entries if entry.key == key for name in entry.hostnames if name[:1] != "|"]
    if full in others:
        text = "known_hosts has %s, but roslaunch looks for %s without the port first" % (full, address)
    elif others:
        text = "known_hosts has this key for %s, but the launch file says %s" % (others[0], address)
    else:
        text = "%s is not in ~/.ssh/known_hosts; it shows %s" % (address, fingerprint(key))
    return red("host key", text, cure)


def _bad_host_key(error, known, computer, address):
    name = host_name(address, computer.port)
    entry = known.lookup(name) or {}
    if error.key.get_name() not in entry:
        return red(
            "host key",
            "known_hosts has only the %s key of %s, but the server shows %s"
            % (" and ".join(sorted(entry)), name, fingerprint(error.key)),
            "./maap machines setup adds the ed25519 and ecdsa keys",
        )
    return red(
        "host key",
        "THE HOST KEY OF %s HAS CHANGED to %s: the computer was installed anew, another one has its address, or "
        "somebody listens" % (name, fingerprint(error.key)),
        "when you know why: the line below, and then ./maap machines setup; else do not connect\nssh-keygen -R '%s'"
        % name,
    )


def _refused(computer):
    return red(
        "login",
        "the login %s takes none of this computer's keys" % computer.login,
        "./maap machines setup, or:\n" + copy_id_line(computer),
        bring_key=True,
    )


def _ssh_problem(error, computer, address):
    name = host_name(address, computer.port)
    if "not found in known_hosts" in str(error):
        return red("host key", "%s is not in ~/.ssh/known_hosts" % name, "./maap machines setup writes the entry")
    if "No authentication methods" in str(error):
        cure = "./maap machines setup makes one and brings it there"
        return red("login", "there is no ssh key here to log in with", cure, bring_key=True)
    return red(
        "network",
        "what answers at %s port %d speaks no ssh (%s)" % (address, computer.port, error),
        "is another program at this port, or are too many logins open? On that computer: systemctl status ssh",
    )


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

    def loaded(self, arguments, limit_s, master_uri=None):
        """Run a command through the env-loader, in the words that roslaunch uses. Returns an Answer.

        master_uri: None = where the master of a launch from here will be.
        """
        master_uri = master_uri or "http://%s:%d" % (self.here, MASTER_PORT)
        words = ["env", "ROS_MASTER_URI=%s" % master_uri, "timeout -k 1 %g" % limit_s, self.computer.env_loader]
        return self.shell(" ".join(words + [shlex.quote(word) for word in arguments]), limit_s)

    def limited(self, script, limit_s):
        """Run a shell script that its own limit ends there. Returns an Answer."""
        return self.shell("timeout -k 1 %g sh -c %s" % (limit_s, shlex.quote(script)), limit_s)

    def shell(self, line, limit_s):
        """Run a line of shell. Its standard input stays open: env-loaders take its end for the end of the session."""
        deadline = time.monotonic() + limit_s + _MARGIN_S
        channel = self.channel(line)
        errors = bytearray()
        reader = threading.Thread(target=_read_all, args=(channel.recv_stderr, errors), daemon=True)
        reader.start()
        out = bytearray()
        try:
            while True:
                channel.settimeout(max(deadline - time.monotonic(), 0.01))
                piece = channel.recv(1 << 16)
                if not piece:
                    break
                out += piece
            reader.join(max(deadline - time.monotonic(), 0.01))
            code = channel.recv_exit_status() if channel.status_event.wait(_MARGIN_S) else 255
        except TimeoutError:
            code = None
        finally:
            channel.close()
        if code == -1 and not self._client.get_transport().is_active():
            raise self._lost("while it ran a command")
        timed_out = code in (None, 124, 137)  # 124, 137: of `timeout`
        return Answer(None if timed_out else code, out.decode(errors="replace"), errors.decode(errors="replace"))

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
        text = "the ssh connection to %s is lost (%s)" % (self.computer.name, error)
        cure = "is it still on and in the network? Then the same command again"
        return MachineError(red("network", text, cure))


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


def _read_all(receive, into):
    with contextlib.suppress(OSError, EOFError):  # socket.timeout is an OSError: the reader of stdout has the deadline
        while True:
            piece = receive(1 << 16)
            if not piece:
                return
            into += piece
