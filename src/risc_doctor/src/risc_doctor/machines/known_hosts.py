"""~/.ssh/known_hosts in the form that roslaunch's paramiko and ssh both accept, written so that nothing is lost."""

import os
import pathlib
import subprocess
import tempfile

import paramiko

from risc_doctor.machines.ssh import host_name

_SYSTEM_WIDE = pathlib.Path("/etc/ssh/ssh_known_hosts")
_SCAN_S = 5
_TYPES = "ed25519", "ecdsa", "rsa"


class ChangedKeyError(Exception):
    """A server shows another key than known_hosts has. `type_name` is that of the key."""


def path():
    """The file that roslaunch reads (what ~ is, $HOME says)."""
    return pathlib.Path(os.path.expanduser("~/.ssh/known_hosts")).resolve()


def scan(address, port):
    """The host keys that a server shows: [paramiko.PKey]. Empty when it shows none in time."""
    command = ["ssh-keyscan", "-T", str(_SCAN_S), "-p", str(port), "-t", ",".join(_TYPES), address]
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
            timeout=3 * _SCAN_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return []
    entries = (paramiko.hostkeys.HostKeyEntry.from_line(line) for line in done.stdout.splitlines() if line[:1] != "#")
    return [entry.key for entry in entries if entry is not None]


def missing_lines(name, address, port, keys):
    """Lines to add so that roslaunch and ssh know a server: [(line, key)], nothing when they do already.

    name: that of the machine, which becomes an alias unless known_hosts has it. keys: those that the server shows.
    Raises ChangedKeyError when known_hosts has another key of the same type.
    """
    known = paramiko.HostKeys()
    for file in (_SYSTEM_WIDE, path()):  # as roslaunch does
        if file.exists():
            known.load(str(file))
    full = host_name(address, port)
    have = known.lookup(full) or {}
    for key in keys:
        if key.get_name() in have and have[key.get_name()] != key:
            raise ChangedKeyError(key.get_name())
    # roslaunch looks for the bare address even when the server is at another port than 22
    bare = [] if port == 22 or known.lookup(address) else [address]
    alias = host_name(name, port)
    aliases = [] if alias == full or known.lookup(alias) else [alias]
    lines = []
    # a server that has keys of other types shows roslaunch one of those, and an rsa entry is of no use
    only_rsa = all(key.get_name() == "ssh-rsa" for key in keys)
    for key in keys:
        names = bare if key.get_name() in have else [*aliases, full, *bare]
        if names and (only_rsa or key.get_name() != "ssh-rsa"):
            lines.append(("%s %s %s" % (",".join(names), key.get_name(), key.get_base64()), key))
    return lines


def add(lines):
    """Append lines in one step: whoever reads the file sees the old or the new one. Raises OSError."""
    target = path()
    target.parent.mkdir(mode=0o700, exist_ok=True)
    old = target.read_bytes() if target.exists() else b""
    if old and not old.endswith(b"\n"):
        old += b"\n"
    handle, temporary = tempfile.mkstemp(prefix=".known_hosts.", dir=str(target.parent))  # mode 600
    try:
        with os.fdopen(handle, "wb") as new:
            new.write(old + "".join(line + "\n" for line in lines).encode())
            new.flush()
            os.fsync(new.fileno())
        os.replace(temporary, str(target))
    except BaseException:
        os.unlink(temporary)
        raise
