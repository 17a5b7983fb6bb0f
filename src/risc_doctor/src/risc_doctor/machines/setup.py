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

from risc_doctor.findings import count_text, exit_code, finding, print_findings
from risc_doctor.machines import keep_alive, known_hosts, ssh
from risc_doctor.machines.check import needs_login, visit_each


def run(experiment, yes, out=None):
    """Set up every computer, one after the other. yes: write host keys without asking. Returns the exit code."""
    out = sys.stdout if out is None else out
    computers = list(filter(needs_login, experiment.computers))
    if not computers:
        print("nothing to set up: no node of %s runs on another computer" % experiment.path, file=out)
        return 0
    findings = [_own_key(computers)]
    print("this computer", file=out)
    print_findings(findings, out)
    print(file=out)
    findings += visit_each(computers, lambda computer: set_up(computer, yes, out), out)
    print(count_text(findings), file=out)
    return exit_code(findings)


def set_up(computer, yes, out):
    """Findings about one computer, after what could be changed has been changed."""
    found, computer = [], dataclasses.replace(computer, password=None)  # it is about logins without one
    try:
        ssh.reach(computer)
        found.append(_host_key(computer, yes, out))
        with contextlib.closing(_log_in(computer)) as session:
            found.append(finding("login", "no_password", login=computer.login))
            found.append(keep_alive.write(session))
    except ssh.MachineError as problem:
        found.append(problem.finding)
    return found


def _own_key(computers):
    folder = pathlib.Path(os.path.expanduser("~/.ssh"))
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


def _host_key(computer, yes, out):
    """The Finding that known_hosts knows the computer. Raises MachineError when it does not."""
    address, _ = ssh.resolve(computer)
    name = ssh.host_name(address, computer.port)
    keys = known_hosts.scan(address, computer.port)
    if not keys:
        raise ssh.MachineError("host key", "none", name=name)
    try:
        lines = known_hosts.missing_lines(computer.name, address, computer.port, keys)
    except known_hosts.ChangedKeyError as changed:
        raise ssh.MachineError("host key", "changed_not_written", type=changed, name=name) from None
    except (ValueError, paramiko.hostkeys.InvalidHostKey):
        raise ssh.MachineError("host key", "corrupt") from None
    if not lines:
        return finding("host key", "known", name=name)
    for _, key in lines:
        print("  %s shows %s" % (name, ssh.fingerprint(key)), file=out)
    if not (yes or _agreed(computer, out)):
        raise ssh.MachineError("host key", "not_agreed")
    known_hosts.add([line for line, _ in lines])
    return finding("host key", "written", count=len(lines), name=name, path=known_hosts.path())


def _agreed(computer, out):
    if not sys.stdin.isatty():
        return False
    print("  the same as `ssh-keygen -lf /etc/ssh/ssh_host_ed25519_key.pub` prints on %s?" % computer.name, file=out)
    return input("  write it to known_hosts? [y/N] ").strip().lower() in ("y", "yes")


def _log_in(computer):
    """A Session; brings our key there when that is all that is missing and a person is there to type the password."""
    try:
        return ssh.connect(computer)
    except ssh.MachineError as problem:
        found = problem.finding  # ("refused" is also what a port without ssh does)
        if found.check != "login" or found.code not in ("refused", "no_key") or not sys.stdin.isatty():
            raise
    print("  %s asks for the password of %s, this once:" % (ssh.copy_id_line(computer), computer.login), flush=True)
    subprocess.run(shlex.split(ssh.copy_id_line(computer)), check=False)
    return ssh.connect(computer)
