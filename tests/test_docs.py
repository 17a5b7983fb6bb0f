"""What the documentation names exists: links, paths, modules, programs, launch files with their arguments, commands of maap."""

import pathlib
import re
import subprocess
from functools import lru_cache

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
TRACKED = subprocess.run(
    ["git", "ls-files", "-co", "--exclude-standard"], cwd=str(ROOT), stdout=subprocess.PIPE, text=True, check=True
).stdout.split("\n")
PAGES = sorted(name for name in TRACKED if name.endswith(".md") and name != "CHANGELOG.md" and (ROOT / name).is_file())
LINK = re.compile(r"\]\(([^)\s]+)\)|(?:src|href)=\"([^\"]+)\"")
SUFFIXES = "py|yaml|launch|test|cpp|hpp|rviz|cfg|sh|md|msg|srv|html|txt"
# `src/.../file.py`, `controllers/lqr.py`, `file.py`; names in capitals, and those of `my_*`, are the reader's own
FILE = re.compile(r"(?<![\w./$<*{-])(?!my_|[A-Z])([\w-]+(?:/[\w.-]+)*\.(?:%s))\b(?![/*:])" % SUFFIXES)
FOLDER = re.compile(r"(?<![\w./$<*{-])((?:src|docs|launch|tests|docker|firmware)/[\w./-]*\w)")
MADE_BY_PROGRAMS = {"flight.yaml", "parameters.yaml", "fleet.yaml", "report.html", "labels.json", "version.txt", "coop.sh"}
MADE_BY_PROGRAMS |= {"setup.sh", "setup.bash"}
COMMAND = re.compile(r"\./maap ([a-z]+)")
PROGRAM = re.compile(r"\b(rosrun|roslaunch|rostest) ((?:[a-z]+_)*[a-z]+) ([\w.-]+)")
MODULE = re.compile(r"python3? -m ([a-z_]+(?:\.[a-z_]+)*)")
ARGUMENTS = re.compile(r"roslaunch (?:([a-z_]+) )?([\w/.-]+\.launch)((?: +[a-z_0-9]+:=(?:\"[^\"]*\"|\S+))+)")


def text(page):
    return (ROOT / page).read_text(encoding="utf-8")


@lru_cache(maxsize=None)
def anchors(page):
    """Anchors of the headings of a page, as GitHub makes them."""
    found = []
    for heading in re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", text(page), flags=re.DOTALL), re.MULTILINE):
        plain = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading)
        found.append(re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-"))
    return found


def in_tree(name):
    """A file, or the end of the path of one, e.g. `ros/params.py`."""
    return name in TRACKED or any(path.endswith("/" + name) for path in TRACKED)


def package(name):
    folders = [path[: -len("/package.xml")] for path in TRACKED if path.endswith("/%s/package.xml" % name)]
    return folders[0] if folders else None


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    broken = []
    for link in (first or second for first, second in LINK.findall(text(page))):
        if re.match(r"https?://|mailto:", link):
            continue
        name, _, anchor = link.partition("#")
        target = ((ROOT / page).parent / name).resolve() if name else ROOT / page
        if not target.exists() or not target.is_relative_to(ROOT):
            broken.append(link)
        elif anchor and anchor not in anchors(str(target.relative_to(ROOT))):
            broken.append(link)
    assert broken == []


@pytest.mark.parametrize("page", PAGES)
def test_files_and_folders_exist(page):
    words = re.sub(r"https?://\S+", "", text(page))
    missing = [name for name in FILE.findall(words) if name not in MADE_BY_PROGRAMS and not in_tree(name)]
    missing += [name for name in FOLDER.findall(words) if not (ROOT / name).exists() and not in_tree(name)]
    assert missing == []


@pytest.mark.parametrize("page", PAGES)
def test_commands_exist(page):
    usage = set(re.findall(r"^  \./maap (\w+)", (ROOT / "maap").read_text(encoding="utf-8"), re.MULTILINE))
    assert {"fly", "help"} <= usage
    missing = ["./maap " + name for name in COMMAND.findall(text(page)) if name not in usage]
    for tool, name, program in PROGRAM.findall(text(page)):
        folder = package(name)
        if folder is None and tool == "rosrun" and name in ("dynamic_reconfigure", "rosgraph"):
            continue
        inside = [path for path in TRACKED if folder and path.startswith(folder + "/")]
        # a C++ program is named in CMakeLists.txt
        cmake = text(folder + "/CMakeLists.txt") if folder else ""
        if not any(path.endswith("/" + program) for path in inside) and not re.search(r"add_executable\(%s\b" % program, cmake):
            missing.append("%s %s %s" % (tool, name, program))
    for name in MODULE.findall(text(page)):
        path = name.replace(".", "/")
        if name.startswith(("risc_", "data_")) and not (in_tree(path + ".py") or in_tree(path + "/__main__.py")):
            missing.append(name)
    assert missing == []


@pytest.mark.parametrize("page", PAGES)
def test_launch_files_know_their_arguments(page):
    unknown = []
    for name, file, arguments in ARGUMENTS.findall(text(page).replace("\\\n", " ")):
        path = "%s/launch/%s" % (package(name), file) if name else file
        if path not in TRACKED:
            unknown.append(path)
            continue
        known = re.findall(r"<arg name=\"(\w+)\"", text(path))
        unknown += ["%s %s" % (path, arg) for arg in re.findall(r"(\w+):=", arguments) if arg not in known]
    assert unknown == []
