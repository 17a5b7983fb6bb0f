"""The whole tree keeps one style, and every package is what catkin expects."""

import ast
import pathlib
import re
import shutil
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
BIN = pathlib.Path(sys.executable).parent
PYTHON = ["src", "tests", "conftest.py"]
CPP = sorted(
    str(path) for suffix in ("*.cpp", "*.hpp") for path in (ROOT / "src").rglob(suffix) if "golden" not in path.parts
)


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


def test_every_subscriber_asks_for_messages_at_once():
    """Without TCP_NODELAY a publisher's computer may hold small messages back for 40 ms: Nagle's algorithm."""
    found, without = 0, []
    for path in programs():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
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


def test_cpp_is_formatted():
    assert CPP
    run(str(BIN / "clang-format"), "--dry-run", "-Werror", *CPP)


def test_catkin_lint_is_clean():
    packages = [str(path.parent) for path in (ROOT / "src").rglob("package.xml")]
    assert len(packages) > 5
    # without a rosdep database it prints a remark and checks everything but the names of Debian's packages
    run("/usr/bin/python3", "/usr/bin/catkin_lint", "-W1", "--strict", *packages)


@pytest.mark.parametrize("script", ["maap", ".ci/run", "tests/fresh_machine.sh"])
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
