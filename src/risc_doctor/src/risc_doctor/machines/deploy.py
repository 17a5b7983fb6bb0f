"""`./maap machines deploy`: copy the workspace, as it is built here, to the same folder of every other computer."""

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

from risc_doctor.findings import FoundError, finding
from risc_doctor.machines import ssh, workspace_digest
from risc_doctor.machines.experiment import ExperimentError

_COMMAND_S = 20.0
_NO_ANSWER_S = 20  # without an answer, then rsync gives up; what arrived is kept for the next time
_BACKUPS = ".deploy_backup"
# Code for every frame, compiled here: a computer with the same processor can use it, another one compiles it again.
_COMPILED = "__pycache__/", "__pycache__/*.nbi", "__pycache__/*.nbc"
# Not sent, and never removed there: what belongs to one computer. The first match wins; those above come first.
_NOT_SENT = (
    "/.git", "/build", "/build_tools", "/devel_tools", "/install_tools", "/.catkin_tools", "/.catkin_workspace",
    "/logs", "/flights", "/fuzz_findings", "/.maap.lock", "/%s" % workspace_digest.DEPLOYED, "/%s" % _BACKUPS,
    ".rsync-partial", "__pycache__/*", "*.pyc", "*~", ".pytest_cache", ".ruff_cache", ".hypothesis",
)  # fmt: skip
# In these, a file that this computer no longer has is removed there, too (into the backup); nothing else is removed.
_MIRRORED = "/src", "/launch", "/devel", "/install", "/.venv"
# A process of this workspace that roslaunch started; [_] so that the pattern does not find itself
_RUNNING = "pgrep -f -a -- %s"


def begin(_experiment, root, _yes):
    """Like `check.begin`; copies the workspace to every computer, one after the other."""
    description = workspace_digest.describe(root)
    if not description.built:
        raise ExperimentError("%s is not built: ./maap build" % root)
    return [], lambda computer: deploy(computer, root, description)


def deploy(computer, root, description):
    """Yields findings about one computer, after the workspace was sent there. Raises FoundError."""
    computer = dataclasses.replace(computer, password=None)  # rsync cannot give one
    if computer.workspace != str(root):
        raise FoundError("folder", "elsewhere", here=root, there=computer.workspace)
    ssh.reach(computer)
    with contextlib.closing(ssh.connect(computer)) as session:
        _prepare(session, root)
        yield _send(session, root, description)
        yield _packages(session, root)
        yield _verify(session, description)


def _prepare(session, root):
    """Require a writable folder, rsync, a processor like ours, and that no node of ours runs. Raises FoundError."""
    folder = shlex.quote(str(root))
    if session.limited("mkdir -p %s && test -w %s" % (folder, folder), _COMMAND_S).code != 0:
        user = session.computer.user or "$USER"
        raise FoundError("folder", "not_writable", folder=root, user=user, quoted=folder)
    if session.limited("command -v rsync", _COMMAND_S).code != 0:
        raise FoundError("rsync", "missing")
    answer = session.limited("uname -m", _COMMAND_S)
    if answer.code == 0 and answer.out.strip() != os.uname().machine:
        raise FoundError("processor", "other", there=answer.out.strip(), here=os.uname().machine)
    pattern = "".join("[%s]" % c if c in "[]()*+?{}|$." else c for c in str(root)) + "/.* [_]_name:="
    running = session.limited(_RUNNING % shlex.quote(pattern), _COMMAND_S)
    if running.code == 0:
        nodes = sorted({word[len("__name:=") :] for word in running.out.split() if word.startswith("__name:=")})
        raise FoundError("running", "nodes", nodes=", ".join(nodes))
    if running.code != 1:
        raise FoundError("running", "unknown", reason=running.reason())


def _send(session, root, description):
    computer, quoted = session.computer, shlex.quote(str(root))
    backup = "%s/%s" % (_BACKUPS, time.strftime("%Y%m%d-%H%M%S"))
    command = ["rsync", "--archive", "--compress", "--partial-dir=.rsync-partial", "--timeout=%d" % _NO_ANSWER_S]
    command += ["--backup", "--backup-dir=" + backup, "--delete", "--rsh", _remote_shell(computer)]
    if sys.stderr.isatty():
        command += ["--info=progress2", "--human-readable"]
    command += ["--include=" + pattern for pattern in _COMPILED]
    command += ["--exclude=" + pattern for pattern in _NOT_SENT]
    command += ["--filter=protect %s" % pattern for pattern in workspace_digest.KEPT_THERE]
    command += ["--filter=risk %s/***" % folder for folder in _MIRRORED if os.path.isdir(str(root) + folder)]
    command += ["--filter=protect /***", "%s/" % root, "%s:%s/" % (computer.login, root)]
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, stdout=sys.stderr, stderr=subprocess.PIPE, text=True, check=False
    )
    if done.returncode != 0:
        lines = [line for line in done.stderr.splitlines() if line.strip()] or ["exit code %d" % done.returncode]
        code = "no_room" if "No space left" in done.stderr else "stopped"
        raise FoundError("send", code, reason=lines[0], quoted=quoted, backups=root / _BACKUPS)
    stamp = shlex.quote(json.dumps({"revision": description.revision, "from": socket.gethostname()}))
    answer = session.limited("printf '%%s\\n' %s > %s/%s" % (stamp, quoted, workspace_digest.DEPLOYED), _COMMAND_S)
    if answer.code != 0:
        raise FoundError("send", "no_stamp", file=workspace_digest.DEPLOYED, reason=answer.reason())
    kept = session.limited("cd %s && find %s -type f | wc -l" % (quoted, shlex.quote(backup)), _COMMAND_S)
    count = int(kept.out) if kept.code == 0 and kept.out.strip().isdigit() else 0
    return finding("send", "done_with_backup" if count else "done", count=count, folder=root / backup)


def _remote_shell(computer):
    """ssh for rsync, with the files that roslaunch's login uses: ssh alone ignores $HOME."""
    folder = pathlib.Path("~/.ssh").expanduser()
    words = ["ssh", "-o", "BatchMode=yes", "-o", "ConnectTimeout=%d" % ssh.CONNECT_S, "-p", str(computer.port)]
    words += ["-o", "ServerAliveInterval=2", "-o", "UserKnownHostsFile=%s" % (folder / "known_hosts")]
    files = [("-F", folder / "config"), *(("-i", folder / name) for name in ssh.KEY_FILES)]
    return shlex.join([*words, *(word for option, path in files if path.exists() for word in (option, str(path)))])


def _packages(session, root):
    """The Finding about the Debian packages that the workspace needs."""
    lines = (root / "apt-packages.txt").read_text(encoding="utf-8").splitlines()
    wanted = [name for name in (line.partition("#")[0].strip() for line in lines) if name]
    script = "dpkg-query -W -f '${Package} ${db:Status-Status}\\n' %s 2>/dev/null" % shlex.join(wanted)
    found = session.limited(script, _COMMAND_S).out.splitlines()
    missing = [name for name in wanted if "%s installed" % name not in found]
    if not missing:
        return finding("packages", "all", count=len(wanted))
    names = ", ".join(missing[:5]) + (" ..." if len(missing) > 5 else "")
    return finding("packages", "missing", count=len(missing), names=names, folder=shlex.quote(str(root)))


def _verify(session, description):
    """The Finding whether the copy runs there and is what was sent."""
    computer = session.computer
    answer = session.loaded(["true"], _COMMAND_S)
    if answer.code != 0:
        values = {"loader": computer.env_loader, "reason": answer.reason(), "folder": computer.workspace}
        return finding("env-loader", "fails_after_deploy", **values)
    answer = session.loaded(["python", "-m", workspace_digest.__name__, computer.workspace], _COMMAND_S)
    try:
        return workspace_digest.compare(description, answer.told(workspace_digest.Workspace))
    except ValueError:
        return finding("workspace", "python_fails", reason=answer.reason(), folder=computer.workspace)
