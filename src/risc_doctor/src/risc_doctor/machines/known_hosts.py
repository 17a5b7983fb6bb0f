"""The host keys that roslaunch's paramiko and ssh trust: looked up, compared, and added so that nothing is lost."""

import base64
import contextlib
import hashlib
import os
import pathlib
import subprocess

import paramiko

FILE = "~/.ssh/known_hosts"  # which roslaunch reads (~ is $HOME), and where new entries go
_SCAN_S = 5
_TYPES = "ed25519", "ecdsa", "rsa"


class ChangedKeyError(Exception):
    """A server shows another key than known_hosts has; the text is the type of the key."""


def known_keys(strict=False):
    """The host keys that roslaunch trusts, as paramiko.HostKeys.

    strict: raises ValueError or InvalidHostKey where a file has a line that is not an entry; its rest is not read.
    """
    keys, broken = paramiko.HostKeys(), (ValueError, paramiko.hostkeys.InvalidHostKey)  # roslaunch complains of those
    for path in ("/etc/ssh/ssh_known_hosts", os.path.expanduser(FILE)):
        with contextlib.suppress(OSError, *(() if strict else broken)):
            keys.load(path)
    return keys


def names_of(keys):
    """Names, except hashed ones, that known_hosts has for a server with one of these keys."""
    entries = known_keys().items()
    return [name for name, known in entries if name[:1] != "|" and any(key in known.values() for key in keys)]


def shown_keys(address, port):
    """The host keys that a server shows: [paramiko.PKey]. Empty when it shows none in time."""
    command = ["ssh-keyscan", "-T", str(_SCAN_S), "-p", str(port), "-t", ",".join(_TYPES), address]
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=3 * _SCAN_S)
    except subprocess.TimeoutExpired:
        return []
    entries = (paramiko.hostkeys.HostKeyEntry.from_line(line) for line in done.stdout.splitlines() if line[:1] != "#")
    return [entry.key for entry in entries if entry is not None]


def host_name(address, port):
    """Name of a server in known_hosts."""
    return address if port == 22 else "[%s]:%d" % (address, port)


def fingerprint(key):
    """As ssh-keygen -l prints it. key: paramiko.PKey."""
    digest = base64.b64encode(hashlib.sha256(key.asbytes()).digest()).decode().rstrip("=")
    return "SHA256:%s (%s)" % (digest, key.get_name())


def missing_lines(name, address, port, keys):
    """Lines to add so that roslaunch and ssh know a server: [(line, key)], [] when they do already.

    name: that of the machine, which becomes an alias unless known_hosts has it. keys: those that the server shows.
    Raises ChangedKeyError when known_hosts has another key of the same type, and as `known_keys` when that cannot be
    known.
    """
    known = known_keys(strict=True)
    full, alias = host_name(address, port), host_name(name, port)
    have = known.lookup(full) or {}
    for key in keys:
        if have.get(key.get_name(), key) != key:
            raise ChangedKeyError(key.get_name())
    # roslaunch looks for the bare address even when the server is at another port than 22
    bare = [] if port == 22 or known.lookup(address) else [address]
    aliases = [] if alias == full or known.lookup(alias) else [alias]
    # a server that has keys of other types shows roslaunch one of those, and an rsa entry is of no use
    useful = [key for key in keys if key.get_name() != "ssh-rsa"] or keys
    lines = []
    for key in useful:
        names = bare if key.get_name() in have else [*aliases, full, *bare]
        if names:
            lines.append(("%s %s %s" % (",".join(names), key.get_name(), key.get_base64()), key))
    return lines


def add(lines):
    """Append lines, in a single write. Raises OSError."""
    path = pathlib.Path(FILE).expanduser()
    path.parent.mkdir(mode=0o700, exist_ok=True)
    with open(path, "a+b", opener=lambda name, flags: os.open(name, flags, 0o600)) as file:
        file.seek(0)
        before = file.read()
        text = "".join(line + "\n" for line in lines).encode()
        file.write(text if before.endswith(b"\n") or not before else b"\n" + text)
