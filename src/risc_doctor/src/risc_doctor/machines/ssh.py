"""Logging in on another computer exactly as roslaunch does it, and running commands there that always end."""

import concurrent.futures
import contextlib
import logging
import os
import shlex
import socket
import subprocess
from dataclasses import dataclass

import msgspec
import paramiko
from roslaunch.remoteprocess import ssh_check_known_hosts

from risc_doctor.findings import FoundError
from risc_doctor.machines.known_hosts import fingerprint, host_name, known_keys, names_of, shown_keys

KEY_FILES = "id_ed25519", "id_ecdsa", "id_rsa"  # in ~/.ssh: those that paramiko tries by itself
MASTER_PORT = 11311  # of a launch from here
CONNECT_S = 5.0  # for a computer in the same laboratory to answer
_SENTENCE = 300  # most characters of a program's output in a sentence
_MARGIN_S = 3.0  # beyond the limit of a far command, for that limit to end it

logging.getLogger("paramiko").addHandler(logging.NullHandler())  # else it prints tracebacks of errors that we report


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
        return lines[-1].strip()[:_SENTENCE] if lines else "exit code %d, no output" % self.code

    def told(self, kind):
        """Decode the last line that a program of ours printed, JSON of a type. Raises ValueError."""
        return msgspec.json.decode((self.out.splitlines() or [""])[-1], type=kind)


def reach(computer):
    """Open a TCP connection to the ssh port and close it. Raises FoundError with the cause."""
    address, _ = resolve(computer)
    try:
        socket.create_connection((address, computer.port), CONNECT_S).close()
    except OSError as error:
        raise unreachable(error, address, computer.port) from None


def unreachable(error, address, port):
    """The FoundError for an OSError of a TCP connection to an ssh port."""
    kinds = {socket.gaierror: "unknown_name", ConnectionRefusedError: "refused", TimeoutError: "silent"}
    code = next((code for kind, code in kinds.items() if isinstance(error, kind)), "unreachable")
    values = {"where": "%s port %d" % (address, port), "reason": error.strerror or error, "limit_s": CONNECT_S}
    return FoundError("network", code, address=address, **values)


def resolve(computer):
    """(address, {option: value}) of ~/.ssh/config, as roslaunch reads it."""
    options = {}
    with contextlib.suppress(OSError, paramiko.SSHException):  # no file, or one that roslaunch would ignore
        options = paramiko.SSHConfig.from_path(os.path.expanduser("~/.ssh/config")).lookup(computer.address)
    return options.get("hostname", computer.address), options


def connect(computer):
    """Log in with a key, as roslaunch 1.15 does it. Returns a Session. Raises FoundError."""
    address, options = resolve(computer)
    client, port = paramiko.SSHClient(), computer.port
    complaint = ssh_check_known_hosts(client, address, port, computer.user)
    if complaint:
        raise _unknown_host(complaint, address, port)
    login = {"timeout": CONNECT_S, "banner_timeout": CONNECT_S, "auth_timeout": 2.0 * CONNECT_S}
    if computer.password is None:
        login["key_filename"] = [os.path.expanduser(path) for path in options.get("identityfile", [])] or None
    else:  # then roslaunch ignores the IdentityFile
        login["password"] = computer.password
    try:
        client.connect(address, port, computer.user or options.get("user"), **login)
    except paramiko.BadHostKeyException as error:
        name = host_name(address, port)
        types = sorted(known_keys().lookup(name) or {})
        code = "changed" if error.key.get_name() in types else "other_type"
        values = {"types": " and ".join(types), "key": fingerprint(error.key)}
        raise FoundError("host key", code, name=name, **values) from None
    except paramiko.PasswordRequiredException:
        raise FoundError("login", "passphrase") from None
    except paramiko.AuthenticationException:
        raise FoundError("login", "refused", login=computer.login, line=copy_id_line(computer)) from None
    except (paramiko.SSHException, EOFError) as error:  # EOFError: closed while the keys were exchanged
        if "not found in known_hosts" in str(error):
            raise FoundError("host key", "not_found", name=host_name(address, port)) from None
        if "No authentication methods" in str(error):
            raise FoundError("login", "no_key") from None
        raise _no_ssh(address, port, str(error) or "it closes the connection") from None
    except OSError as error:
        raise unreachable(error, address, port) from None
    session = Session(client, computer)
    if ":" in session.here:
        session.close()
        raise FoundError("network", "ipv6_only", address=computer.address)
    return session


def _unknown_host(complaint, address, port):
    if "corrupt" in complaint:
        return FoundError("host key", "corrupt")
    keys = shown_keys(address, port)
    if not keys:
        return _no_ssh(address, port, "no ssh greeting")
    name, others = host_name(address, port), names_of(keys)
    code = "without_port" if name in others else "other_name" if others else "unknown"
    return FoundError("host key", code, name=name, address=address, other="".join(others[:1]), key=fingerprint(keys[0]))


def _no_ssh(address, port, reason):
    return FoundError("network", "no_ssh", where="%s port %d" % (address, port), reason=reason)


def copy_id_line(computer):
    """The command that copies our key to a computer."""
    port = "" if computer.port == 22 else "-p %d " % computer.port
    return "ssh-copy-id %s%s" % (port, computer.login)


class Session:
    """An open login. Every command has a time limit, which ends it on the far side, too.

    All of them raise FoundError when the connection is lost.
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
        """Run a shell script, which `timeout` ends there. Returns an Answer."""
        return self.shell("timeout -k 1 %g sh -c %s" % (limit_s, shlex.quote(script)), limit_s)

    def shell(self, line, limit_s):
        """Run a line of shell. Its standard input stays open: env-loaders take its end for the end of the session."""
        channel = self.channel(line, limit_s + _MARGIN_S)
        with concurrent.futures.ThreadPoolExecutor(1) as reader, contextlib.closing(channel):
            try:  # both streams at a time: a program blocks when its output is not read
                err = reader.submit(channel.makefile_stderr("rb").read)
                out, err = channel.makefile("rb").read(), err.result()
            except TimeoutError:
                return Answer(None, "", "")
            code = channel.recv_exit_status() if channel.status_event.wait(_MARGIN_S) else 255
        if code == -1 and not self._client.get_transport().is_active():
            raise self._lost("while it ran a command")
        code = None if code in (124, 137) else code  # 124, 137: of `timeout`
        return Answer(code, out.decode(errors="replace"), err.decode(errors="replace"))

    def channel(self, line, silence_s):
        """Start a command in the login shell, whichever that is, and return its channel.

        silence_s: after which reading from it raises TimeoutError.
        """
        try:
            channel = self._client.get_transport().open_session(timeout=CONNECT_S)
            channel.settimeout(CONNECT_S)
            channel.exec_command(line)
        except (paramiko.SSHException, EOFError, OSError) as error:
            raise self._lost(error) from None
        channel.settimeout(silence_s)
        return channel

    def _lost(self, error):
        return FoundError("network", "lost", machine=self.computer.name, reason=error)


def loaded_here(arguments, limit_s):
    """An Answer of this computer, where roslaunch needs neither a login nor an env-loader."""
    try:
        done = subprocess.run(arguments, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=limit_s)
    except subprocess.TimeoutExpired:
        return Answer(None, "", "")
    return Answer(done.returncode, done.stdout, done.stderr)
