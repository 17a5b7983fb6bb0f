"""`./maap machines setup`: host keys, an ssh key, quick detection of dead connections. Says what it changed."""

import contextlib
import dataclasses
import getpass
import os
import pathlib
import shlex
import socket
import subprocess
import sys

import paramiko

from risc_doctor.findings import FoundError, finding
from risc_doctor.machines import keep_alive, known_hosts, ssh


def begin(experiment, _root, yes):
    """Like `check.begin`; sets up every computer, one after the other. yes: write host keys without asking."""
    computers = [computer for computer in experiment.computers if computer.needs_login]
    return [_own_key(computers)], lambda computer: set_up(computer, yes)


def set_up(computer, yes):
    """Yields findings about one computer, after what could be changed has been changed. Raises FoundError."""
    computer = dataclasses.replace(computer, password=None)  # the login must work without one
    ssh.reach(computer)
    yield _host_key(computer, yes)
    with contextlib.closing(_log_in(computer)) as session:
        yield finding("login", "no_password", login=computer.login)
        yield keep_alive.write(session)


def _own_key(computers):
    folder = pathlib.Path("~/.ssh").expanduser()
    paths = [str(folder / name) for name in ssh.KEY_FILES]
    for computer in computers:
        paths += map(os.path.expanduser, ssh.resolve(computer)[1].get("identityfile", []))
    for path in filter(os.path.exists, paths):
        return finding("key", "there", path=path)
    if paramiko.Agent().get_keys():
        return finding("key", "agent")
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    comment = "%s@%s" % (getpass.getuser(), socket.gethostname())
    command = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", comment, "-f", paths[0]]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)
    return finding("key", "made", path=paths[0])


def _host_key(computer, yes):
    """The Finding that known_hosts knows the computer. Raises FoundError when it does not."""
    address, _ = ssh.resolve(computer)
    name = known_hosts.host_name(address, computer.port)
    keys = known_hosts.shown_keys(address, computer.port)
    if not keys:
        raise FoundError("host key", "none", name=name)
    try:
        lines = known_hosts.missing_lines(computer.name, address, computer.port, keys)
    except known_hosts.ChangedKeyError as changed:
        raise FoundError("host key", "changed_not_written", type=changed, name=name) from None
    except (ValueError, paramiko.hostkeys.InvalidHostKey):
        raise FoundError("host key", "corrupt") from None
    if not lines:
        return finding("host key", "known", name=name)
    for _, key in lines:
        print("  %s shows %s" % (name, known_hosts.fingerprint(key)))
    if not (yes or _agreed(computer)):
        raise FoundError("host key", "not_agreed")
    known_hosts.add([line for line, _ in lines])
    return finding("host key", "written", count=len(lines), name=name, path=known_hosts.FILE)


def _agreed(computer):
    if not sys.stdin.isatty():
        return False
    print("  the same as `ssh-keygen -lf /etc/ssh/ssh_host_ed25519_key.pub` prints on %s?" % computer.name)
    return input("  write it to known_hosts? [y/N] ").strip().lower() in ("y", "yes")


def _log_in(computer):
    """A Session. If only our key is missing there, and a person can type the password, copies the key first."""
    try:
        return ssh.connect(computer)
    except FoundError as problem:
        found = problem.finding  # ("refused" is also what a port without ssh does)
        if found.check != "login" or found.code not in ("refused", "no_key") or not sys.stdin.isatty():
            raise
    print("  %s asks for the password of %s, this once:" % (ssh.copy_id_line(computer), computer.login), flush=True)
    subprocess.run(shlex.split(ssh.copy_id_line(computer)), check=False)
    return ssh.connect(computer)
