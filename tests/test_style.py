"""The whole tree keeps one style, and every package is what catkin expects."""

import ast
import functools
import importlib.util
import pathlib
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
BIN = pathlib.Path(sys.executable).parent
PYTHON = ["src", "tests", "conftest.py"]
CPP = sorted(
    str(path) for suffix in ("*.cpp", "*.hpp") for path in (ROOT / "src").rglob(suffix) if "golden" not in path.parts
)
CPP += sorted(str(path) for suffix in ("*.cpp", "*.h", "*.ino") for path in (ROOT / "firmware").rglob(suffix))


def run(*command, **options):
    done = subprocess.run(
        command, cwd=str(ROOT), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **options
    )
    assert done.returncode == 0, "%s\n%s" % (" ".join(command[:3]), done.stdout[-4000:])
    return done.stdout


def test_python_is_clean():
    run(str(BIN / "ruff"), "check", "--no-cache", *PYTHON)


def test_python_is_formatted():
    run(str(BIN / "ruff"), "format", "--no-cache", "--check", *PYTHON)


def test_nodes_without_suffix_are_clean():
    nodes = [
        str(path)
        for path in (ROOT / "src").rglob("nodes/*")
        if path.is_file() and not path.suffix and path.read_text(encoding="utf-8").startswith("#!/usr/bin/env python3")
    ]
    assert nodes, "the drop-in drivers have nodes without a suffix"
    run(str(BIN / "ruff"), "check", "--no-cache", *nodes)
    run(str(BIN / "ruff"), "format", "--no-cache", "--check", *nodes)


def programs():
    """Python sources of the packages, nodes without suffix included, tests not."""
    for path in (ROOT / "src").rglob("*"):
        if path.is_file() and "test" not in path.parts and (path.suffix == ".py" or path.parent.name == "nodes"):
            yield path


@functools.cache
def nodes_of(path):
    """All nodes of the syntax tree of a Python source."""
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


def test_every_subscriber_asks_for_messages_at_once():
    """Without TCP_NODELAY a publisher's computer may hold small messages back for 40 ms: Nagle's algorithm."""
    found, without = 0, []
    for path in programs():
        for node in nodes_of(path):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "rospy.Subscriber":
                found += 1
                asked = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
                if asked.get("tcp_nodelay") != "True":
                    without.append("%s:%d" % (path.relative_to(ROOT), node.lineno))
    assert found > 20
    assert not without, "say tcp_nodelay=True: " + ", ".join(without)


def test_no_timer_dies_of_an_exception():
    """rospy.Timer's thread ends with the first exception of its callback: those of risc_lab.ros.ticker go on."""
    found = [path.name for path in programs() if "rospy.Timer(" in path.read_text(encoding="utf-8")]
    assert found == ["ticker.py"]


def test_no_callback_of_a_flying_node_is_without_a_guard():
    """rospy logs a traceback for each message that a callback fails on. `risc_lab.ros.guard.subscribe` and
    PacedSubscriber guard theirs.
    """
    drivers = "drivers/ardrone_autonomy", "drivers/roscopter", "drivers/rosserial_python"
    flying = [ROOT / "src" / name for name in ("risc_control", "risc_estimation", *drivers)]
    sources = [path for path in programs() if any(folder in path.parents for folder in flying)]
    bare = [
        "%s:%d" % (path.relative_to(ROOT), node.lineno)
        for path in sources
        for node in nodes_of(path)
        if isinstance(node, ast.Attribute) and ast.unparse(node) == "rospy.Subscriber"
    ]
    guarded = [path for path in sources if "guard import" in path.read_text(encoding="utf-8")]
    assert len(guarded) > 5, "where flying nodes are"
    assert not bare, "use risc_lab.ros.guard.subscribe: " + ", ".join(bare)


def test_one_file_asks_rospy_whether_it_closes():
    """rospy has no documented name for it."""
    asking = [path.name for path in programs() if "is_shutdown_" + "requested" in path.read_text(encoding="utf-8")]
    assert asking == ["until_shutdown.py"]


def test_every_node_and_every_test_forgets_no_publisher():
    """A plain rospy node may: see the file."""
    plain = re.compile(r"^ *rospy\.init_node\(", re.MULTILINE)
    paths = {*programs(), *(ROOT / "src").rglob("*.py"), *(ROOT / "tests").rglob("*.py")}
    assert {path.name for path in paths if plain.search(path.read_text(encoding="utf-8"))} == {"publisher_updates.py"}


def test_one_file_reads_who_sent_a_message():
    """rospy has no public name for it, so a new rospy may move it: what uses it asks `risc_lab.ros.sender`."""
    assert readers_of("_connection_header") == ["sender.py"]


def test_no_file_reads_where_rospy_keeps_the_bytes_of_a_message():
    """The same: `risc_lab.ros.raw_messages` keeps them itself."""
    assert readers_of("_buff") == []


def readers_of(attribute):
    """Names of the files, tests included, that read an attribute of this name."""
    sources = [*programs(), *(ROOT / "src").rglob("test/**/*.py"), *(ROOT / "tests").rglob("*.py")]
    return [path.name for path in sources if re.search(r"\.%s\b" % attribute, path.read_text(encoding="utf-8"))]


def test_cpp_is_formatted():
    assert CPP
    run(str(BIN / "clang-format"), "--dry-run", "-Werror", *CPP)


def test_catkin_lint_is_clean():
    packages = [str(path.parent) for path in (ROOT / "src").rglob("package.xml")]
    assert len(packages) > 5
    # without a rosdep database it prints a remark and checks everything but the names of Debian's packages
    run("/usr/bin/python3", "/usr/bin/catkin_lint", "-W1", "--strict", *packages)


@pytest.mark.parametrize("script", ["maap", ".ci/run", "tests/fresh_machine.sh", "firmware/arm/build.sh"])
def test_shell_scripts_are_clean(script):
    assert shutil.which("shellcheck"), "shellcheck is missing: ./maap setup installs it"
    run("shellcheck", script)


def test_nodes_are_executable():
    nodes = [path for path in (ROOT / "src").rglob("nodes/*") if path.is_file()]
    assert nodes
    assert [str(path) for path in nodes if not path.stat().st_mode & 0o100] == []


def test_nothing_of_anybodys_computer_is_in_the_tree():
    """No path into a home but those of the images (risc) and of examples; wherever this clone is."""
    files = subprocess.run(["git", "ls-files"], cwd=str(ROOT), stdout=subprocess.PIPE, check=True, text=True).stdout
    found = set()
    for name in files.split():
        for path, user in re.findall(rb"(?<![\w.)}/-])(/(?:root|work|home/(\w+))/[\w.]*)", (ROOT / name).read_bytes()):
            if user not in (b"risc", b"me", b"pilot", b"a", b"b"):
                found.add("%s: %s" % (name, path.decode()))
    assert found == set()


MANIFESTS = sorted((ROOT / "src").rglob("package.xml"))
# Folders of our Python packages, and the ROS package that each is in; packages of messages only have none.
MODULES = {init.parent.name: init.parent for path in MANIFESTS for init in path.parent.glob("*/*/__init__.py")}
PACKAGE_OF = {path.parent.name: path.parent for path in MANIFESTS}
PACKAGE_OF.update((module, place.parents[1]) for module, place in MODULES.items())
OTHER_NAMES = {  # module or C++ library -> what package.xml calls it, where that is not its name
    "CLI": "cli11",
    "cv2": "opencv",
    "camera_info_manager": "camera_info_manager_py",
    "nlohmann": "nlohmann-json",
    "PIL": "pil",
    "ruamel": "ruamel.yaml",
}
# Of requirements.txt, for which rosdep has no name: package.xml cannot name them.
WITHOUT_ROSDEP_NAME = {"msgspec", "pymavlink", "rosbags", "viser"}


def imports(path, with_optional=False):
    """(line, module, name or None) of the imports of a file, with or without those that it can do without."""
    tried = [node for node in nodes_of(path) if isinstance(node, ast.Try) and not with_optional]
    optional = {part for node in tried if "ImportError" in ast.unparse(node.handlers) for part in ast.walk(node)}
    for node in nodes_of(path):
        if isinstance(node, ast.Import) and node not in optional:
            yield from ((node.lineno, alias.name, None) for alias in node.names)
        if isinstance(node, ast.ImportFrom) and node not in optional:
            yield from ((node.lineno, node.module, alias.name) for alias in node.names)


@functools.cache
def names_in(path):
    """What a module has once it is imported: a set."""
    names = set()
    for node in nodes_of(path):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            names.add(node.name)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            names.update(alias.asname or alias.name for alias in node.names)
    return names


@functools.cache
def is_there(module, name):
    """Whether a module, and a name in it, is in the tree or installed."""
    top, *rest = module.split(".")
    if top not in PACKAGE_OF:
        return importlib.util.find_spec(top) is not None
    if (rest or [name])[0] in ("msg", "srv", "cfg"):  # made of the files in a folder of that name
        wanted = re.sub("(Config|Request|Response)$", "", [*rest, name][1] if rest else "")
        files = PACKAGE_OF[top].glob("%s/*" % (rest or [name])[0])
        return any(wanted in (path.stem, "") or '"%s"' % wanted in path.read_text(encoding="utf-8") for path in files)
    place = MODULES[top].joinpath(*rest)
    file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
    if name is None or not file.exists():
        return file.exists()
    return (place / name).is_dir() or (place / (name + ".py")).exists() or name in names_in(file)


def test_every_import_is_there():
    """Of every program, also of a node that no test starts."""
    missing = [
        "%s:%d: %s" % (path.relative_to(ROOT), line, ".".join(filter(None, (module, name))))
        for path in programs()
        for line, module, name in imports(path)
        if not is_there(module, name)
    ]
    assert missing == []


FLOORS = (  # of docs/architecture.md, from the ground; on one floor, a package may import those before it
    ("risc_msgs", "risc_maap_msgs", "risc_lab"),
    ("cortex_ros", "drivers", "risc_estimation", "risc_control", "risc_simulator"),  # these do not import each other,
    ("data_extraction", "risc_visual"),
    ("risc_experiments", "risc_doctor"),
)
# but for messages and codecs of these; the last two replace a driver in offline flights
SHARED = {"cortex_ros": {"wire"}, "drivers": {"msg", "srv", "protocol", "navdata_message", "LOST_S"}}
ROOMS = [room for floor in FLOORS for room in floor]


def room(path):
    """Folder in src that a file is in."""
    return path.relative_to(ROOT / "src").parts[0]


@functools.cache
def steps():
    """Imports from one of the ROOMS into another: (text for people, from, into, parts of the name)."""
    found = []
    for path in programs():
        for line, module, name in imports(path, with_optional=True):
            names = [*module.split("."), *filter(None, [name])]
            target = room(PACKAGE_OF[names[0]]) if names[0] in PACKAGE_OF else room(path)
            if target != room(path):
                text = "%s:%d: %s" % (path.relative_to(ROOT), line, ".".join(names))
                found.append((text, room(path), target, set(names)))
    return found


def are_neighbours(source, target):
    return {source, target} <= set(FLOORS[1])


def test_every_package_has_its_floor():
    assert {room(path) for path in MANIFESTS} == set(ROOMS)


def test_imports_go_down_only():
    assert len(steps()) > 500
    up = [
        text
        for text, source, target, _ in steps()
        if ROOMS.index(target) > ROOMS.index(source) and not are_neighbours(source, target)
    ]
    assert not up, "these are above: " + ", ".join(up)


def test_the_second_floor_shares_messages_and_codecs_only():
    others = [
        text
        for text, source, target, names in steps()
        if are_neighbours(source, target) and not names & SHARED.get(target, set())
    ]
    assert not others, "neither messages nor a codec: " + ", ".join(others)


def test_nothing_that_flies_looks_or_evaluates_imports_the_simulator():
    importing = {source for _, source, target, _ in steps() if target == "risc_simulator"}
    assert importing and importing <= set(FLOORS[-1])


@pytest.mark.parametrize("manifest", MANIFESTS, ids=lambda path: path.parent.name)
def test_a_package_depends_on_what_it_imports_and_on_nothing_else(manifest):
    name = manifest.parent.name
    requirements = (ROOT / "requirements.txt").read_text(encoding="utf-8")
    known = {
        "python3-" + item
        for item in {"opencv", "pil", *re.findall(r"(?m)^([\w.-]+)==", requirements)} - WITHOUT_ROSDEP_NAME
    }
    known |= set((ROOT / "apt-packages.txt").read_text(encoding="utf-8").split())

    def package_of(module):
        """None for Python's own modules, and libraries that rosdep has no name for."""
        python = "python3-" + OTHER_NAMES.get(module, module)
        if module in PACKAGE_OF:
            return PACKAGE_OF[module].name
        if pathlib.Path("/usr/share", module, "package.xml").exists():
            return module
        return python if python in known else None

    tree = xml.etree.ElementTree.parse(manifest)
    declared = {item.text: item.tag for item in tree.iter() if item.tag.endswith("depend")}
    sources = [path for path in programs() if manifest.parent in path.parents and path.name != "setup.py"]
    used = {package_of(module.partition(".")[0]) for path in sources for _, module, _ in imports(path)} - {None, name}
    lacking = used - {item for item, tag in declared.items() if tag in ("depend", "exec_depend")}
    assert lacking == set(), "package.xml needs an exec_depend"
    text = " ".join(
        path.read_text(encoding="utf-8", errors="ignore")
        for path in manifest.parent.rglob("*")
        if path.is_file() and path.suffix in ("", ".py", ".cpp", ".hpp", ".txt", ".launch", ".test", ".msg", ".srv")
    )
    words = {OTHER_NAMES.get(word, word).lower() for word in re.findall(r"\w+", text)} | {"setuptools"}
    unused = [item for item in declared if re.sub("^python3-|-dev$", "", item) not in words]
    assert unused == [], "nothing here names what package.xml depends on"
