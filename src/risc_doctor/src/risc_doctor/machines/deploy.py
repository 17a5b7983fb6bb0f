"""`./maap machines deploy`: the workspace, as it is built here, to the same folder of every other computer."""

import contextlib
import dataclasses
import json
import os
import pathlib
import shlex
import socket
import subprocess
import sys
import time

from risc_doctor.findings import count_text, exit_code, green, print_findings, red, yellow
from risc_doctor.machines import ssh, workspace_digest
from risc_doctor.machines.check import needs_login

_COMMAND_S = 20.0
_NO_ANSWER_S = 20  # of the network, then rsync gives up; what arrived is kept for the next time
_BACKUPS = ".deploy_backup"
# What runs in every frame, compiled here: of use to a computer with the same processor, another one compiles it again.
_COMPILED = "__pycache__/", "__pycache__/*.nbi", "__pycache__/*.nbc"
# First match wins, after those above. Not sent, and never removed there: what belongs to one computer.
_NOT_SENT = (
    "/.git", "/build", "/build_tools", "/devel_tools", "/install_tools", "/.catkin_tools", "/.catkin_workspace",
    "/logs", "/flights", "/fuzz_findings", "/.maap.lock", "/%s" % workspace_digest.DEPLOYED, "/%s" % _BACKUPS,
    ".rsync-partial", "__pycache__/*", "*.pyc", "*~", ".pytest_cache", ".ruff_cache", ".hypothesis",
)  # fmt: skip
# A file that is gone here goes there, too (into the backup); everywhere else nothing goes.
_MIRRORED = "/src", "/launch", "/devel", "/install", "/.venv"
_SETUP_THERE = "on that computer, once (installs its Debian packages):\ncd %s && ./maap setup"
# A process of this workspace that roslaunch started; [_] so that the pattern does not find itself
_RUNNING = "pgrep -f -a -- %s"


def run(experiment, root, out=None):
    """Bring the workspace to every computer, one after the other. Returns the exit code.

    root: folder of the workspace here; out: text stream, None = stdout.
    """
    out = sys.stdout if out is None else out
    root = pathlib.Path(root).resolve()
    computers = list(filter(needs_login, experiment.computers))
    if not computers:
        print("nothing to deploy: no node of %s runs on another computer" % experiment.path, file=out)
        return 0
    description = workspace_digest.describe(root)
    if not description["built"]:
        print("maap machines: %s is not built: ./maap build" % root, file=sys.stderr)
        return 2
    findings = []
    for computer in computers:
        print("%s (%s)" % (computer.name, computer.login), file=out, flush=True)
        found = deploy(computer, root, description)
        print_findings(found, out)
        print(file=out, flush=True)
        findings += found
    print(count_text(findings), file=out)
    return exit_code(findings)


def deploy(computer, root, description):
    """Findings about one computer, after the workspace was sent there. description: of workspace_digest.describe."""
    findings = []
    computer = dataclasses.replace(computer, password=None)  # rsync has none to give
    with ssh.visit(findings) as sessions:
        if computer.workspace != str(root):
            raise ssh.MachineError(
                red(
                    "folder",
                    "the workspace is %s here, but %s there" % (root, computer.workspace),
                    "devel and .venv hold absolute paths: put it into the same folder on every computer (its env-loader"
                    " is devel/coop.sh in there, no link to it), or clone it there and ./maap build",
                )
            )
        ssh.reach(computer)
        session = sessions.enter_context(contextlib.closing(ssh.connect(computer)))
        _prepare(session, root)
        findings.append(_send(session, root))
        _stamp(session, root, description)
        findings += _packages(session, root)
        findings.append(_verify(session, description))
    return findings


def _prepare(session, root):
    """A folder to write into, rsync, a processor like ours, and nothing of ours that runs. Raises MachineError."""
    folder = shlex.quote(str(root))
    if session.limited("mkdir -p %s && test -w %s" % (folder, folder), _COMMAND_S).code != 0:
        user = session.computer.user or "$USER"
        cure = "on that computer: sudo install -d -o %s %s" % (user, folder)
        raise ssh.MachineError(red("folder", "this login cannot write %s there" % root, cure))
    if session.limited("command -v rsync", _COMMAND_S).code != 0:
        raise ssh.MachineError(red("rsync", "it is not installed there", "on that computer: sudo apt install rsync"))
    answer = session.limited("uname -m", _COMMAND_S)
    kind = answer.out.strip()
    if answer.code == 0 and kind != os.uname().machine:
        text = "its processor is %s, this one is %s: what is built here does not run there" % (kind, os.uname().machine)
        raise ssh.MachineError(red("processor", text, "clone the workspace there, at the same revision: ./maap build"))
    pattern = "".join("[%s]" % c if c in "[]()*+?{}|$." else c for c in str(root)) + "/.* [_]_name:="
    running = session.limited(_RUNNING % shlex.quote(pattern), _COMMAND_S)
    if running.code == 0:
        nodes = sorted({word[len("__name:=") :] for word in running.out.split() if word.startswith("__name:=")})
        raise ssh.MachineError(
            red(
                "running",
                "nodes of this workspace run there (%s): their files must not change under them" % ", ".join(nodes),
                "land, end the launch with Ctrl-C, and deploy again",
            )
        )
    if running.code != 1:
        raise ssh.MachineError(
            red(
                "running",
                "cannot see what runs there: " + running.reason(),
                "on that computer: sudo apt install procps",
            )
        )


def _send(session, root):
    computer = session.computer
    if session.limited("rm -f %s" % shlex.quote(str(root / workspace_digest.DEPLOYED)), _COMMAND_S).code != 0:
        raise ssh.MachineError(red("folder", "cannot write %s there" % root, "who owns it there? ls -ld %s" % root))
    backup = "%s/%s" % (_BACKUPS, time.strftime("%Y%m%d-%H%M%S"))
    command = ["rsync", "--archive", "--compress", "--partial-dir=.rsync-partial", "--timeout=%d" % _NO_ANSWER_S]
    command += ["--backup", "--backup-dir=" + backup, "--delete", "--rsh", _remote_shell(computer)]
    if sys.stderr.isatty():
        command += ["--info=progress2", "--human-readable"]
    command += ["--include=" + pattern for pattern in _COMPILED]
    command += ["--exclude=" + pattern for pattern in _NOT_SENT]
    command += ["--filter=protect %s" % pattern for pattern in workspace_digest.KEPT_THERE]
    mirrored = [folder for folder in _MIRRORED if os.path.isdir(str(root) + folder)]
    command += ["--filter=risk %s/***" % folder for folder in mirrored] + ["--filter=protect /***"]
    where = computer.address if computer.user is None else "%s@%s" % (computer.user, computer.address)
    done = subprocess.run(
        [*command, "%s/" % root, "%s:%s/" % (where, root)],
        stdin=subprocess.DEVNULL, stdout=sys.stderr, stderr=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    if done.returncode != 0:
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        cure = "run the same command again: what has arrived is not sent twice"
        if "No space left" in done.stderr:
            cure = "on that computer: df -h %s; remove old flights and old folders of %s there, then %s" % (
                shlex.quote(str(root)), root / _BACKUPS, cure,
            )  # fmt: skip
        text = "rsync stopped: %s" % (lines[0] if lines else "exit code %d" % done.returncode)
        raise ssh.MachineError(red("send", text, cure))
    kept = session.limited(
        "cd %s && find %s -type f | wc -l" % (shlex.quote(str(root)), shlex.quote(backup)), _COMMAND_S
    )
    count = int(kept.out) if kept.code == 0 and kept.out.strip().isdigit() else 0
    text = "the workspace is there"
    if count:
        text += "; %d files that were different or gone here are kept in %s/%s there" % (count, root, backup)
    return green("send", text)


def _remote_shell(computer):
    """ssh for rsync, with the files that roslaunch's login uses: ssh alone ignores $HOME."""
    folder = pathlib.Path(os.path.expanduser("~/.ssh"))
    words = ["ssh", "-o", "BatchMode=yes", "-o", "ConnectTimeout=%d" % ssh.CONNECT_S, "-p", str(computer.port)]
    words += ["-o", "ServerAliveInterval=2", "-o", "UserKnownHostsFile=%s" % (folder / "known_hosts")]
    if (folder / "config").exists():
        words += ["-F", str(folder / "config")]
    for name in ssh.KEY_FILES:
        if (folder / name).exists():
            words += ["-i", str(folder / name)]
    return " ".join(map(shlex.quote, words))


def _stamp(session, root, description):
    content = {
        "revision": description["revision"],
        "hash": workspace_digest.content_hash(description),
        "time": time.strftime("%Y-%m-%d %H:%M:%S %z"),
        "from": socket.gethostname(),
    }
    line = "printf '%%s\\n' %s > %s" % (
        shlex.quote(json.dumps(content)),
        shlex.quote(str(root / workspace_digest.DEPLOYED)),
    )
    answer = session.limited(line, _COMMAND_S)
    if answer.code != 0:
        raise ssh.MachineError(
            red(
                "send",
                "cannot write %s there: %s" % (workspace_digest.DEPLOYED, answer.reason()),
                "is the disk there full? df -h",
            )
        )


def _packages(session, root):
    """Findings about the Debian packages that the workspace needs and that computer lacks."""
    path = root / "apt-packages.txt"
    if not path.exists():
        return []
    wanted = [line.partition("#")[0].strip() for line in path.read_text(encoding="utf-8").splitlines()]
    wanted = [name for name in wanted if name]
    script = "dpkg-query -W -f '${Package} ${db:Status-Status}\\n' %s 2>/dev/null" % " ".join(map(shlex.quote, wanted))
    found = {
        line.split()[0] for line in session.limited(script, _COMMAND_S).out.splitlines() if line.endswith(" installed")
    }
    missing = [name for name in wanted if name not in found]
    if not missing:
        return [green("packages", "all %d Debian packages are installed there" % len(wanted))]
    text = "%d Debian packages are missing there: %s" % (len(missing), ", ".join(missing[:5]))
    return [yellow("packages", text + (" ..." if len(missing) > 5 else ""), _SETUP_THERE % shlex.quote(str(root)))]


def _verify(session, description):
    """That what arrived runs there and is what was sent."""
    answer = session.loaded(["true"], _COMMAND_S)
    if answer.code != 0:
        return red(
            "env-loader",
            "%s does not work there: %s" % (session.computer.env_loader, answer.reason()),
            _SETUP_THERE % session.computer.workspace,
        )
    answer = session.loaded(["python", "-m", workspace_digest.__name__, session.computer.workspace], _COMMAND_S)
    try:
        there = workspace_digest.from_output(answer.out)
    except ValueError:
        cure = _SETUP_THERE % session.computer.workspace
        return red("workspace", "its Python does not run there: %s" % answer.reason(), cure)
    return workspace_digest.compare(description, there)
