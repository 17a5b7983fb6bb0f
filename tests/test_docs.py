"""What the documentation names exists: links, files, programs, launch files and their arguments, commands of maap."""

import pathlib
import re
import subprocess
from functools import cache

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
TRACKED = subprocess.run(
    ["git", "ls-files", "-co", "--exclude-standard"], cwd=str(ROOT), stdout=subprocess.PIPE, text=True, check=True
).stdout.split()
PAGES = sorted(name for name in TRACKED if name.endswith(".md") and name != "CHANGELOG.md" and (ROOT / name).is_file())
FRONT_PAGE_LINES = 90  # two screens
COLUMNS = 120

LINK = re.compile(r"\]\(([^)\s]+)\)|(?:src|href)=\"([^\"]+)\"")
CODE = re.compile(r"^```.*?^```|^ {4}\S.*?$|`[^`]+`", re.MULTILINE | re.DOTALL)
SUFFIXES = "py|yaml|launch|test|cpp|hpp|rviz|cfg|sh|md|msg|srv|html|txt"
FILE = re.compile(r"(?<![\w./$<*{\-])([a-z][\w-]*(?:/[\w.-]+)*\.(?:%s))\b(?![/*:]|\.\w)" % SUFFIXES)
FOLDER = re.compile(r"(?<![\w./$<*{\-])((?:src|docs|launch|tests|docker|firmware)/[\w./-]*\w)")
COMMAND = re.compile(r"\./maap ([a-z]+)")
PROGRAM = re.compile(r"\b(rosrun|roslaunch|rostest)\s+((?:[a-z]+_)+[a-z]+|joy)\s+([\w.-]+)")
MODULE = re.compile(r"python3? -m ((?:risc|data|cortex)_[a-z_]+(?:\.[a-z_]+)*)")
ARGUMENTS = re.compile(r"roslaunch (?:([a-z_]+) )?([\w/.-]+\.launch)((?: +[a-z_0-9]+:=(?:\"[^\"]*\"|\S+))+)")

OURS_ONLY_IN_USE = {  # made by programs, or by a build
    *("flight.yaml", "parameters.yaml", "fleet.yaml", "report.html", "devel/coop.sh", "install/coop.sh", "coop.sh"),
    *("setup.sh", "setup.bash", "faults.yaml", "soak.md"),
}
NOT_OURS = {  # of Debian, of others; of the original release
    *(
        "cameracalibrator.py",
        "mavproxy.py",
        "ar_drone_scipy.py",
        "orbit2traj.py",
        "sharmas_controller.py",
        "trackone_scipy.py",
    ),
}
DEBIAN = {"dynamic_reconfigure", "camera_calibration", "image_view"}


def text(page):
    return (ROOT / page).read_text(encoding="utf-8")


def code(page):
    """What is marked as code, each piece on lines of its own."""
    return "\n".join(re.sub(r"https?://\S+", "", piece) for piece in CODE.findall(text(page)))


@cache
def anchors(page):
    """Anchors of the headings of a page, as GitHub makes them."""
    found = []
    for heading in re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", text(page), flags=re.DOTALL), re.MULTILINE):
        plain = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading)
        found.append(re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-"))
    return found


def is_there(name):
    """Whether it is a file or folder of the tree, or the end of the path of one, e.g. `ros/params.py`."""
    return (ROOT / name).exists() or any(path.endswith("/" + name) for path in TRACKED)


def is_the_readers(name):
    """Whether it is a file that the reader has or makes."""
    return re.search(r"(^|/)(my[_.]|[A-Z_]+\.)[^/]*$|^flights/|^my_", name) is not None


def package(name):
    """Folder of a package, None when it is not one of ours."""
    return next((path[: -len("/package.xml")] for path in TRACKED if path.endswith("/%s/package.xml" % name)), None)


def has_program(folder, program):
    inside = [path for path in TRACKED if path.startswith(folder + "/")]
    targets = re.findall(r"add_executable\((\w+)", text(folder + "/CMakeLists.txt"))
    return program in targets or any(path.endswith("/" + program) for path in inside)


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    broken = []
    for link in (first or second for first, second in LINK.findall(text(page))):
        if re.match(r"https?://|mailto:", link):
            continue
        name, _, anchor = link.partition("#")
        target = ((ROOT / page).parent / name).resolve() if name else ROOT / page
        is_broken = not target.exists() or not target.is_relative_to(ROOT)
        if is_broken or (anchor and anchor not in anchors(str(target.relative_to(ROOT)))):
            broken.append(link)
    assert broken == []


@pytest.mark.parametrize("page", PAGES)
def test_files_and_folders_exist(page):
    names = {name for name in FILE.findall(code(page)) + FOLDER.findall(code(page)) if not is_the_readers(name)}
    assert sorted(name for name in names - OURS_ONLY_IN_USE - NOT_OURS if not is_there(name)) == []


@pytest.mark.parametrize("page", PAGES)
def test_programs_exist(page):
    usage = set(re.findall(r"^  \./maap (\w+)", text("maap"), re.MULTILINE))
    assert {"fly", "help"} <= usage
    missing = ["./maap " + name for name in COMMAND.findall(text(page)) if name not in usage]
    for tool, name, program in PROGRAM.findall(code(page)):
        folder = package(name)
        if name not in DEBIAN and (folder is None or not has_program(folder, program)):
            missing.append("%s %s %s" % (tool, name, program))
    for name in MODULE.findall(code(page)):
        path = name.replace(".", "/")
        if not (is_there(path + ".py") or is_there(path + "/__main__.py")):
            missing.append(name)
    assert missing == []


@pytest.mark.parametrize("page", PAGES)
def test_launch_files_know_their_arguments(page):
    unknown = []
    for name, file, arguments in ARGUMENTS.findall(code(page).replace("\\\n", " ")):
        path = "%s/launch/%s" % (package(name), file) if name else file
        if is_the_readers(path):
            continue
        known = re.findall(r"<arg name=\"(\w+)\"", text(path))
        unknown += ["%s %s" % (path, arg) for arg in re.findall(r"(\w+):=", arguments) if arg not in known]
    assert unknown == []


def test_the_front_page_is_short():
    assert len(text("README.md").splitlines()) <= FRONT_PAGE_LINES


@pytest.mark.parametrize("page", [name for name in PAGES if name.endswith("README.md") and "/test/" not in name])
def test_pages_are_wrapped(page):
    """But for tables, code and pictures."""
    prose = re.sub(r"^```.*?^```", "", text(page), flags=re.MULTILINE | re.DOTALL)
    assert [line for line in prose.splitlines() if len(line) > COLUMNS and not re.match(r"\||    |!\[", line)] == []


@pytest.mark.parametrize("folder", [path[: -len("/package.xml")] for path in TRACKED if path.endswith("/package.xml")])
def test_every_package_has_its_page(folder):
    assert (ROOT / folder / "README.md").is_file()
    assert pathlib.Path(folder).name in text("docs/README.md")
