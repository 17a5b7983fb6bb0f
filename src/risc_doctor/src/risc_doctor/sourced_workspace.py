"""Which workspace is it, and is it the one that is sourced?"""

import os
import pathlib
import sys

import risc_lab
from risc_doctor.findings import green, red, yellow
from risc_doctor.machines.workspace_digest import content_hash, describe


def check(situation):
    """Revision and content of the workspace, to be compared between computers."""
    root = situation.root
    found = describe(root)
    data = {"path": str(root), "revision": found["revision"], "content": content_hash(found)}
    text = "%s: %s, content %s" % (root, data["revision"] or "no git revision", data["content"])
    findings = [green("workspace", text, **data)]
    if not found["built"]:
        findings = [red("workspace", text + ", not built", "./maap build", **data)]
    return findings + _sourced(root, situation.environment)


def _sourced(root, environment):
    """Whether the environment is that of this workspace, with its Python."""
    say, findings = "workspace", []
    prefixes = [p for p in environment.get("CMAKE_PREFIX_PATH", "").split(os.pathsep) if p]
    source = ". %s/devel/setup.bash" % root
    if not prefixes:
        return [red(say, "no workspace is sourced", source)]
    first = pathlib.Path(prefixes[0])
    if first.resolve().parent != root:
        text = "another workspace is sourced on top of this one: %s" % first
        findings.append(red(say, text, "in a new terminal: %s" % source))
    others = [p for p in prefixes[1:] if not p.startswith(("/opt/ros", "/usr")) and pathlib.Path(p).parent != root]
    if others:
        text = "other workspaces lie under this one: %s" % ", ".join(others)
        findings.append(yellow(say, text, "build in a clean terminal (./maap build does), or %s" % source))
    place = pathlib.Path(risc_lab.__path__[0]).resolve()
    if root not in place.parents:
        text = "the programs come from %s, not from %s" % (place, root)
        findings.append(red(say, text, "in a new terminal: %s" % source))
    venv = root / ".venv"
    if venv.is_dir() and pathlib.Path(sys.prefix).resolve() != venv.resolve():
        text = "Python is %s, not the workspace's" % sys.executable
        findings.append(red(say, text, "%s; its PATH begins with %s/bin" % (source, venv)))
    elif not venv.is_dir():
        text = "there is no Python environment in %s; %s is used" % (venv, sys.executable)
        findings.append(yellow(say, text, "./maap setup"))
    return findings
