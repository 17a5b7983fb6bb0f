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

from risc_doctor.findings import count_text, exit_code, green, print_findings, red
from risc_doctor.machines import keep_alive, known_hosts, ssh
from risc_doctor.machines.check import needs_login


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
    for computer in computers:
        print("\n%s (%s)" % (computer.name, computer.login), file=out)
        found = set_up(computer, yes, out)
        print_findings(found, out)
        findings += found
    print("\n%s" % count_text(findings), file=out)
    return exit_code(findings)


def set_up(computer, yes, out):
    """Findings about one computer, after what could be changed has been changed."""
    findings = []
    computer = dataclasses.replace(computer, password=None)  # it is about logins without one
    with ssh.visit(findings) as sessions:
        ssh.reach(computer)
        findings.append(_host_key(computer, yes, out))
        session = sessions.enter_context(contextlib.closing(_log_in(computer)))
        findings.append(green("login", "%s without a password" % computer.login))
        findings.append(keep_alive.write(session))
    return findings


def _own_key(computers):
    folder = pathlib.Path(os.path.expanduser("~/.ssh"))
    paths = [str(folder / name) for name in ssh.KEY_FILES]
    for computer in computers:
        paths += map(os.path.expanduser, ssh.resolve(computer)[1].get("identityfile", []))
    for path in filter(os.path.exists, paths):
        return green("key", "%s is there" % path)
    if paramiko.Agent().get_keys():
        return green("key", "the ssh agent has one")
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    comment = "%s@%s" % (getpass.getuser(), socket.gethostname())
    subprocess.run(
        ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", comment, "-f", str(folder / ssh.KEY_FILES[0])],
        check=True, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    return green("key", "made %s (no passphrase: roslaunch cannot ask for one)" % (folder / ssh.KEY_FILES[0]))


def _host_key(computer, yes, out):
    """The Finding that known_hosts knows the computer. Raises MachineError when it does not."""
    address, _ = ssh.resolve(computer)
    name = ssh.host_name(address, computer.port)
    keys = known_hosts.scan(address, computer.port)
    if not keys:
        raise ssh.MachineError(
            red("host key", "%s shows no ed25519, ecdsa or rsa key" % name, "on that computer: sudo ssh-keygen -A")
        )
    try:
        lines = known_hosts.missing_lines(computer.name, address, computer.port, keys)
    except known_hosts.ChangedKeyError as changed:
        raise ssh.MachineError(
            red(
                "host key",
                "THE HOST KEY (%s) OF %s HAS CHANGED; nothing was written" % (changed, name),
                "find out why (installed anew? another computer at this address?), then\nssh-keygen -R '%s'" % name,
            )
        ) from None
    except paramiko.hostkeys.InvalidHostKey:
        cure = "ssh-keygen -lf %s names the line that is none; remove it" % known_hosts.path()
        raise ssh.MachineError(red("host key", "known_hosts cannot be read", cure)) from None
    if not lines:
        return green("host key", "known as %s" % name)
    for _, key in lines:
        print("  %s shows %s" % (name, ssh.fingerprint(key)), file=out)
    if not (yes or _agreed(computer, out)):
        raise ssh.MachineError(
            red(
                "host key",
                "not written to known_hosts: nobody said that these are its keys",
                "compare with what that computer says itself, then answer y or give --yes:\n"
                "ssh-keygen -lf /etc/ssh/ssh_host_ed25519_key.pub",
            )
        )
    known_hosts.add([line for line, _ in lines])
    return green("host key", "wrote %d lines for %s to %s" % (len(lines), name, known_hosts.path()))


def _agreed(computer, out):
    if not sys.stdin.isatty():
        return False
    print("  the same as `ssh-keygen -lf /etc/ssh/ssh_host_ed25519_key.pub` prints on %s?" % computer.name, file=out)
    return input("  write it to known_hosts? [y/N] ").strip().lower() in ("y", "yes")


def _log_in(computer):
    """A Session; brings our key there when that is all that is missing and somebody can type the password."""
    try:
        return ssh.connect(computer)
    except ssh.MachineError as problem:
        if not (problem.finding.data.get("bring_key") and sys.stdin.isatty()):
            raise
    print("  %s asks for the password of %s, this once:" % (ssh.copy_id_line(computer), computer.login), flush=True)
    subprocess.run(shlex.split(ssh.copy_id_line(computer)), check=False)
    return ssh.connect(computer)
