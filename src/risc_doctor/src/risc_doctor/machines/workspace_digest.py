"""Is the workspace on two computers the same? Compares descriptions: a hash of each file, and the revision.

`python -m risc_doctor.machines.workspace_digest FOLDER` prints that of a workspace as JSON. When there is none in
FOLDER (a link from outside the workspace led to coop.sh), it describes the one that is sourced.
"""

import fnmatch
import hashlib
import json
import os
import pathlib
import sys
from dataclasses import dataclass

import msgspec

from risc_doctor.findings import finding
from risc_lab.revision import revision

DEPLOYED = ".deployed"  # what `machines deploy` leaves there: JSON with the revision
_PARTS = "src", "launch", "devel", "install", "maap", "requirements.txt", ".venv/.requirements"
_BUILT = "devel/", "install/"
# made by running or editing the workspace, or not part of what runs
_NOT_COMPARED = (
    "__pycache__", "*.pyc", ".pytest_cache", ".ruff_cache", ".hypothesis", "cmake.lock", "*~", ".*.sw?", "*.md",
)  # fmt: skip
CALIBRATIONS = "src/*/config/cameras/*"  # made where the camera is: may be newer there
KEPT_THERE = "*.yaml", "*.bag", "*.ini", "*.csv"  # what people and programs put into a workspace: never removed
_NAMED = 3  # how many differing files a sentence names


@dataclass(frozen=True)
class Workspace:
    """Description of a workspace."""

    folder: str
    revision: str | None  # None: not known
    built: bool
    files: dict[str, str]  # {path: hash}

    @property
    def content(self):
        """One hash for all files."""
        lines = "\n".join("%s %s" % item for item in sorted(self.files.items()))
        return hashlib.sha256(lines.encode()).hexdigest()[:12]


def describe(root):
    """The Workspace in a folder."""
    root = pathlib.Path(root)
    files = {str(path.relative_to(root)): _hash(path) for path in _files(root)}
    return Workspace(str(root), revision(root) or _deployed(root).get("revision"), _is_built(root), files)


def compare(here, there):
    """The Finding about the Workspace of another computer."""
    differing = {path for path, value in here.files.items() if there.files.get(path) != value}
    extra = there.files.keys() - here.files.keys()
    own = {path for path in differing if fnmatch.fnmatch(path, CALIBRATIONS) and path in there.files}
    own |= {path for path in extra if _matches(path, KEPT_THERE)}
    strange = (differing | extra) - own
    source = {path for path in strange if not path.startswith(_BUILT)}
    text = "revision %s" % (there.revision or "unknown")
    if here.revision != there.revision and there.built:
        text += ", here %s" % (here.revision or "unknown")
    code, files = "same", ""
    if not there.built:
        code = "not_built"
    elif strange:
        code, files = "another" if source else "another_build", _differ(source or strange)
    elif own & differing:
        code, files = "own_calibration", ", ".join(sorted(own & differing))
    return finding("workspace", code, revision=text, files=files, content=here.content)


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
        for folder, folders, names in os.walk(path):
            folders[:] = [name for name in folders if not _matches(name, _NOT_COMPARED)]
            yield from (pathlib.Path(folder, name) for name in names if not _matches(name, _NOT_COMPARED))


def _matches(name, patterns):
    return any(fnmatch.fnmatch(name, pattern) for pattern in patterns)


def _hash(path):
    if path.is_symlink():
        return "-> " + os.readlink(path)
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
    print(msgspec.json.encode(describe(root)).decode())


if __name__ == "__main__":
    main(sys.argv[1])
