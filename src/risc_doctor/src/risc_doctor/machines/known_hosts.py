"""~/.ssh/known_hosts in the form that roslaunch's paramiko and ssh both accept, written so that nothing is lost."""

import os
import pathlib
import subprocess
import tempfile

import paramiko

from risc_doctor.machines.ssh import host_name, known_host_keys

_SCAN_S = 5
_TYPES = "ed25519", "ecdsa", "rsa"


class ChangedKeyError(Exception):
    """A server shows another key than known_hosts has; the text is the type of the key."""


def path():
    """The file that roslaunch reads (what ~ is, $HOME says)."""
    return pathlib.Path(os.path.expanduser("~/.ssh/known_hosts")).resolve()


def scan(address, port):
    """The host keys that a server shows: [paramiko.PKey]. Empty when it shows none in time."""
    command = ["ssh-keyscan", "-T", str(_SCAN_S), "-p", str(port), "-t", ",".join(_TYPES), address]
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=3 * _SCAN_S, check=False
        )
    except subprocess.TimeoutExpired:
        return []
    entries = (paramiko.hostkeys.HostKeyEntry.from_line(line) for line in done.stdout.splitlines() if line[:1] != "#")
    return [entry.key for entry in entries if entry is not None]


def missing_lines(name, address, port, keys):
    """Lines to add so that roslaunch and ssh know a server: [(line, key)], nothing when they do already.

    name: that of the machine, which becomes an alias unless known_hosts has it. keys: those that the server shows.
    Raises ChangedKeyError when known_hosts has another key of the same type, and as `known_host_keys` when that cannot
    be known.
    """
    known = known_host_keys(strict=True)
    full, alias = host_name(address, port), host_name(name, port)
    have = known.lookup(full) or {}
    for key in keys:
        if key.get_name() in have and have[key.get_name()] != key:
            raise ChangedKeyError(key.get_name())
    # roslaunch looks for the bare address even when the server is at another port than 22
    bare = [] if port == 22 or known.lookup(address) else [address]
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
    """Append lines in one step: a program that reads the file sees the old or the new one. Raises OSError."""
    target = path()
    target.parent.mkdir(mode=0o700, exist_ok=True)
    old = target.read_text(encoding="utf-8", errors="surrogateescape") if target.exists() else ""
    old += "\n" if old and not old.endswith("\n") else ""
    with tempfile.TemporaryDirectory(prefix=".known_hosts.", dir=target.parent) as folder:
        new = pathlib.Path(folder, target.name)
        new.touch(mode=0o600)
        new.write_text(old + "".join(line + "\n" for line in lines), encoding="utf-8", errors="surrogateescape")
        os.replace(new, target)
