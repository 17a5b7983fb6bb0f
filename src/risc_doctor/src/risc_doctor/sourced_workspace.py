"""Which workspace is it, and is it the one that is sourced?"""

import os
import pathlib
import sys

import risc_lab
from risc_doctor.findings import Findings
from risc_doctor.machines.workspace_digest import describe


def check(situation):
    """Revision and content of the workspace, to be compared between computers."""
    root, found = situation.root, Findings("workspace")
    ours = describe(root)
    values = {"revision": ours.revision, "revision_text": ours.revision or "no git revision", "content": ours.content}
    found.say("content" if ours.built else "not_built_here", path=str(root), **values)
    _sourced(root, situation.environment, found)
    return found


def _sourced(root, environment, found):
    """Whether the environment is that of this workspace, with its Python."""
    prefixes = [pathlib.Path(p) for p in environment.get("CMAKE_PREFIX_PATH", "").split(os.pathsep) if p]
    source = ". %s/devel/setup.bash" % root
    if not prefixes:
        found.say("none_sourced", source=source)
        return
    if prefixes[0].resolve().parent != root:
        found.say("another_sourced", prefix=prefixes[0], source=source)
    others = [str(p) for p in prefixes[1:] if not str(p).startswith(("/opt/ros", "/usr")) and p.parent != root]
    if others:
        found.say("others_below", others=", ".join(others), source=source)
    place = pathlib.Path(risc_lab.__path__[0]).resolve()
    if root not in place.parents:
        found.say("programs_elsewhere", place=place, root=root, source=source)
    venv = root / ".venv"
    if not venv.is_dir():
        found.say("no_python", venv=venv, python=sys.executable)
    elif pathlib.Path(sys.prefix).resolve() != venv.resolve():
        found.say("other_python", python=sys.executable, source=source, venv=venv)
