"""`./maap test` itself: what it refuses, style first, the two tiers, the ledger of --repeat."""

import os
import pathlib
import re
import shutil
import subprocess
import sys

import ledger
import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
STUB = """#!/bin/sh
echo "$@" >>"%s"
exit 1
"""
TOY = """
import pathlib
import pytest

def test_first():
    pass

@pytest.mark.release
@pytest.mark.parametrize("number", range(3))
def test_second(number):
    pass

def test_fuzz(inputs):
    assert inputs(5, 50) == %d
"""
SEEDED = """
def test_seed(seed):
    assert (seed(3), seed(4)) == (%d, %d)
"""
PACKAGE = """<package format="2"><name>toy</name><version>1.0.0</version><description>Toy</description>
<maintainer email="a@b.eu">A</maintainer><license>BSD</license><buildtool_depend>catkin</buildtool_depend></package>
"""
FLAKY = """
import pathlib
import pytest

here = pathlib.Path(__file__).parent

def test_good():
    pass

def test_now_and_then():
    assert not (here / "bad").exists(), "the reason"

@pytest.fixture
def broken():
    assert not (here / "bad").exists()

def test_set_up(broken):
    pass

def test_skipped_always():
    pytest.skip("never here")

def test_skipped_once():
    if (here / "bad").exists():
        pytest.skip("busy")
"""


def run_pytest(folder, content, *options):
    """pytest with this workspace's settings on one file: the finished process."""
    (folder / "test_toy.py").write_text(content)
    command = [sys.executable, "-m", "pytest", "-c", str(ROOT / "pytest.ini"), "--rootdir", str(folder)]
    command += ["-p", "conftest", "-p", "no:cacheprovider", *options, str(folder / "test_toy.py")]
    environment = dict(os.environ, PYTHONPATH=str(ROOT) + os.pathsep + os.environ.get("PYTHONPATH", ""))
    return subprocess.run(command, env=environment, cwd=str(folder), capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize("side_by_side", [(), pytest.param(("--numprocesses", "2"), marks=pytest.mark.release)])
def test_the_second_tier_is_left_out_and_counted(tmp_path, side_by_side):
    done = run_pytest(tmp_path, TOY % 5, *side_by_side)
    assert done.returncode == 0 and "2 passed" in done.stdout, done.stdout
    assert re.search(r"^3 .*--all", done.stdout, re.MULTILINE), done.stdout
    done = run_pytest(tmp_path, TOY % 50, "--all", *side_by_side)
    assert done.returncode == 0 and "5 passed" in done.stdout, done.stdout
    assert "--all" not in done.stdout.rpartition("=== ")[2]


def test_what_a_pattern_leaves_out_is_not_counted(tmp_path):
    done = run_pytest(tmp_path, TOY % 5, "-k", "fuzz or second[1]")
    assert "1 passed" in done.stdout and re.search(r"^1 .*--all", done.stdout, re.MULTILINE), done.stdout


def test_each_pass_has_seeds_of_its_own(tmp_path):
    for options, seeds in (((), (3, 4)), (("--pass", "1"), (3, 4)), (("--pass", "3"), (2003, 2004))):
        done = run_pytest(tmp_path, SEEDED % seeds, *options)
        assert done.returncode == 0, done.stdout


def test_a_marker_that_is_misspelt_is_an_error(tmp_path):
    assert run_pytest(tmp_path, TOY.replace("mark.release", "mark.relase") % 5).returncode == 2


@pytest.mark.parametrize(
    "words", [("lqr", "flatness"), ("--repeat",), ("--repeat", "0"), ("--repeat", "often"), ("--everything",)]
)
def test_wrong_use_ends_before_anything_is_done(tmp_path, words):
    shutil.copy(str(ROOT / "maap"), str(tmp_path))
    done = subprocess.run([str(tmp_path / "maap"), "test", *words], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1 and done.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["maap"]


@pytest.fixture
def workspace(tmp_path):
    """A workspace whose Python and pip only log their arguments, and fail."""
    for name in ("maap", "requirements.txt", "apt-packages.txt"):
        shutil.copy(str(ROOT / name), str(tmp_path))
    for name in ("apt-packages-rviz.txt", "apt-packages-pdf.txt", "apt-packages-test.txt"):
        (tmp_path / name).touch()
    (tmp_path / ".catkin_tools").mkdir()
    (tmp_path / ".venv/bin").mkdir(parents=True)
    for name in ("python", "pip"):
        program = tmp_path / ".venv/bin" / name
        program.write_text(STUB % (tmp_path / "asked"))
        program.chmod(0o755)
    shutil.copy(str(ROOT / ".venv/.requirements"), str(tmp_path / ".venv"))
    return tmp_path


def first_asked(workspace, *options):
    """The first call of Python by `maap test`. It fails and ends that: no test is run, and no Python is compiled."""
    done = subprocess.run([str(workspace / "maap"), "test", *options], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    (asked,) = (workspace / "asked").read_text().splitlines()
    return asked


def test_a_wrong_style_ends_it_before_anything_is_tested(workspace):
    assert "tests/test_style.py" in first_asked(workspace)


def test_a_command_on_its_way_builds_only_what_has_changed(workspace):
    python = workspace / ".venv/bin/python"
    nothing = 'case "$*" in *precompile* | *virtual_lab*) exit 0 ;; esac'
    python.write_text('#!/bin/sh\n%s\nexec %s "$@"\n' % (nothing, sys.executable))
    package = workspace / "src/toy"
    package.mkdir(parents=True)
    shutil.copy(str(ROOT / "src/CMakeLists.txt"), str(workspace / "src"))
    (package / "package.xml").write_text(PACKAGE)
    (package / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.5)\nproject(toy)\nfind_package(catkin REQUIRED)\ncatkin_package()\n"
    )

    def has_built(command):
        log = workspace / "logs/build.log"
        log.unlink(missing_ok=True)
        done = subprocess.run([str(workspace / "maap"), *command], capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
        return log.exists()

    shell, lab = ("shell", "-c", "true"), ("lab",)
    assert has_built(lab) and not has_built(shell)
    os.utime(package / "package.xml", (1.0, 1.0))  # copied here with its old date
    assert has_built(shell) and not has_built(lab)
    assert has_built(("build",)), "it is what was asked for"


def test_the_second_tier_gets_its_ground_stations_and_nothing_else_changes(workspace):
    asked = first_asked(workspace, "--all")
    assert asked.startswith("install") and "--no-deps" in asked and asked.endswith("requirements-all.txt")


def test_each_pass_is_told_its_number(workspace):
    """In a workspace where nothing has to be built."""
    (workspace / ".venv/bin/python").write_text('#!/bin/sh\necho "$@" >>"%s"\n' % (workspace / "asked"))
    for name in ("src", "devel"):
        (workspace / name).mkdir()
    (workspace / "devel/setup.bash").touch()
    for name in ("build", "build-tests"):
        (workspace / ("devel/.made_" + name)).write_text(str(workspace))
    command = [str(workspace / "maap"), "test", "lqr", "--repeat", "2"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert re.findall(r"-k lqr .*--pass (\d+)", (workspace / "asked").read_text()) == ["1", "2"]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Folder with the results of three passes; the third was a bad one."""
    folder = tmp_path_factory.mktemp("flaky")
    for number in (1, 2, 3):
        if number == 3:
            (folder / "bad").touch()
        run_pytest(folder, FLAKY, "--junit-xml", str(folder / "results" / ("%d.alone.xml" % number)))
    return folder / "results"


def test_the_ledger_counts_failures_gaps_and_what_is_skipped_now_and_then(results):
    records = {name.rpartition("::")[2]: record for name, record in ledger.read(results).items()}
    assert {name: record.passes for name, record in records.items()} == dict.fromkeys(records, {1, 2, 3})
    assert {name: record.failed for name, record in records.items() if record.failed} == {
        "test_now_and_then": {3},
        "test_set_up": {3},
    }
    assert records["test_skipped_always"].skipped == {1, 2, 3} and records["test_skipped_once"].skipped == {3}
    text, well = ledger.lines(ledger.read(results), 3)
    assert not well
    (total,) = text[-1:]
    assert re.findall(r"\d+", total) == ["5", "3", "15", "2"]
    told = "\n".join(text[:-1])
    assert all(name in told for name in ("test_now_and_then", "test_set_up", "test_skipped_once")), told
    assert "test_good" not in told and "test_skipped_always" not in told

    good = {name: record for name, record in ledger.read(results).items() if name.endswith(("good", "always"))}
    assert ledger.lines(good, 3)[1]
    assert not ledger.lines(good, 4)[1], "one pass has no results"
    assert not ledger.lines({}, 1)[1]


def test_the_ledgers_exit_code(results, tmp_path):
    for number in (1, 2):
        shutil.copy(str(results / ("%d.alone.xml" % number)), str(tmp_path))
    program = [sys.executable, str(ROOT / "tests/ledger.py"), str(tmp_path)]
    codes = [subprocess.run([*program, passes], capture_output=True).returncode for passes in ("2", "3")]
    assert codes == [0, 1]
