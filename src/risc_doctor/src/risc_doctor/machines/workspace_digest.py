"""Is the workspace on two computers the same? What it is made of, file by file, and what it was made from.

`python -m risc_doctor.machines.workspace_digest FOLDER` prints that of a workspace, and its folder, as JSON.
When there is none in FOLDER (a link from outside the workspace led to coop.sh), it is the one that is sourced.
"""

import fnmatch
import hashlib
import json
import os
import pathlib
import sys

from risc_doctor.findings import finding
from risc_lab.revision import revision

DEPLOYED = ".deployed"  # what `machines deploy` leaves there: JSON with revision, hash, time, from
_PARTS = "src", "launch", "devel", "install", "maap", "requirements.txt", ".venv/.requirements"
_BUILT = "devel/", "install/"
# made by running or editing it, or nothing that runs
_NOT_COMPARED = (
    "__pycache__", "*.pyc", ".pytest_cache", ".ruff_cache", ".hypothesis", "cmake.lock", "*~", ".*.sw?", "*.md",
)  # fmt: skip
CALIBRATIONS = "src/*/config/cameras/*"  # made where the camera is: may be newer there
KEPT_THERE = "*.yaml", "*.bag", "*.ini", "*.csv"  # what people and programs put into a workspace: never removed
_NAMED = 3  # how many differing files a sentence names


def describe(root):
    """What a workspace is made of: {"revision", "built", "files": {path: hash}}. root: its folder."""
    root = pathlib.Path(root)
    return {
        "revision": revision(root) or _deployed(root).get("revision"),
        "built": _is_built(root),
        "files": {str(path.relative_to(root)): _hash(path) for path in _files(root)},
    }


def from_output(printed):
    """What the program printed last: a description with its "folder". Raises ValueError when it is none."""
    try:
        found = json.loads(printed.splitlines()[-1])
        if isinstance(found["files"], dict) and {"revision", "built"} <= set(found):
            return found
    except (IndexError, KeyError, TypeError):
        pass
    raise ValueError("no description of a workspace: %r" % printed[-200:])


def content_hash(description):
    """One text for all files of a workspace."""
    lines = "\n".join("%s %s" % item for item in sorted(description["files"].items()))
    return hashlib.sha256(lines.encode()).hexdigest()[:12]


def compare(here, there):
    """The Finding about the workspace of another computer. here, there: of `describe`."""
    differing = {path for path, value in here["files"].items() if there["files"].get(path) != value}
    extra = {path for path in there["files"] if path not in here["files"]}
    own = {path for path in differing if fnmatch.fnmatch(path, CALIBRATIONS) and path in there["files"]}
    own |= {path for path in extra if _matches(path, KEPT_THERE)}
    strange = (differing | extra) - own
    revision = "revision %s" % (there["revision"] or "unknown")
    if not there["built"]:
        return finding("workspace", "not_built", revision=revision)
    if here["revision"] != there["revision"]:
        revision += ", here %s" % (here["revision"] or "unknown")
    source = {path for path in strange if not path.startswith(_BUILT)}
    if source:
        return finding("workspace", "another", revision=revision, files=_differ(source))
    if strange:
        return finding("workspace", "another_build", revision=revision, files=_differ(strange))
    if own & differing:
        return finding("workspace", "own_calibration", revision=revision, files=", ".join(sorted(own & differing)))
    return finding("workspace", "same", revision=revision, content=content_hash(here))


def _differ(paths):
    names = sorted(paths, key=lambda path: (path.startswith(_BUILT), path))[:_NAMED]
    more = len(paths) - len(names)
    verb = "differs" if len(paths) == 1 else "differ"
    return "%s%s %s" % (", ".join(names), " and %d more files" % more if more else "", verb)


def _files(root):
    for part in _PARTS:
        path = root / part
        if path.is_file():
            yield path
        for folder, folders, names in os.walk(str(path)):
            folders[:] = [name for name in folders if not _matches(name, _NOT_COMPARED)]
            for name in names:
                if not _matches(name, _NOT_COMPARED):
                    yield pathlib.Path(folder) / name


def _matches(name, patterns):
    return any(fnmatch.fnmatch(name, pattern) for pattern in patterns)


def _hash(path):
    if path.is_symlink():
        return "-> " + os.readlink(str(path))
    return hashlib.blake2b(path.read_bytes(), digest_size=8).hexdigest()


def _is_built(root):
    return any((root / space / "setup.sh").exists() for space in ("devel", "install"))


def _deployed(root):
    try:
        return json.loads((root / DEPLOYED).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}


def main(folder):
    """Print the description."""
    root, sourced = pathlib.Path(folder), os.environ.get("CMAKE_PREFIX_PATH", "").split(os.pathsep)[0]
    if sourced and not _is_built(root):
        root = pathlib.Path(sourced).parent
    print(json.dumps(dict(describe(root), folder=str(root))))


if __name__ == "__main__":
    main(sys.argv[1])
