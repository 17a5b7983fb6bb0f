"""The workspace builds with both of catkin's tools, and installs: nodes fly from the install space too."""

import os
import pathlib
import re
import shutil
import subprocess

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
PYTHON = "-DPYTHON_EXECUTABLE=%s" % (ROOT / ".venv/bin/python")
# A person's shell before anything is sourced.
BARE = {"HOME": os.environ.get("HOME", "/root"), "PATH": "/usr/bin:/bin", "LC_ALL": "C.UTF-8"}


def run(command, folder, **options):
    done = subprocess.run(
        command,
        cwd=str(folder),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        **options,
    )
    assert done.returncode == 0, done.stdout[-5000:]
    return done.stdout


@pytest.fixture(scope="module")
def install_space(tmp_path_factory):
    """Folder that `catkin_make install` filled."""
    folder = tmp_path_factory.mktemp("install")
    spaces = ["-DCATKIN_DEVEL_PREFIX=%s" % (folder / "devel"), "-DCMAKE_INSTALL_PREFIX=%s" % (folder / "install")]
    run(["catkin_make", "--build", str(folder / "build"), PYTHON, *spaces, "install"], ROOT, env=BARE)
    yield folder / "install"
    shutil.rmtree(str(folder))


def test_a_vehicle_flies_from_the_install_space(install_space, tmp_path):
    fly = "python3 -m risc_experiments.fly --vehicles 1 --duration 5 --out %s" % (tmp_path / "flight")
    script = ". %s/setup.bash && which python3 && rospack find risc_control && %s" % (install_space, fly)
    output = run(["bash", "-c", script], tmp_path, env=dict(BARE, RISC_MAAP_ROOT=str(ROOT)))
    assert "PASSED" in output
    assert str(ROOT / ".venv/bin/python3") in output, "setup.bash puts the right Python first"
    assert str(install_space / "share/risc_control") in output
    log = (tmp_path / "flight/roslaunch.log").read_text()
    assert "%s/lib/" % install_space in log or str(ROOT / "devel") not in log


def test_catkin_build_builds_it_too(tmp_path):
    (tmp_path / "src").symlink_to(ROOT / "src")
    run(["catkin", "config", "--init", "--no-extend", "--cmake-args", PYTHON], tmp_path, env=BARE)
    run(["catkin", "build", "--no-status", "--no-notify", "--summarize"], tmp_path, env=BARE)
    script = ". devel/setup.bash && rosrun cortex_ros cortex_dump --file %s" % (
        ROOT / "src/cortex_ros/test/golden/frame_2bodies.bin"
    )
    assert '"type"' in run(["bash", "-c", script], tmp_path, env=BARE)


def test_every_installed_folder_is_in_git():
    """A folder that is only on this computer makes `catkin_make install` fail in a fresh clone."""
    for path in (ROOT / "src").rglob("CMakeLists.txt"):
        for names in re.findall(r"install\(DIRECTORY ([^)]*?) (?:DESTINATION|FILES)", path.read_text()):
            for name in names.split():
                folder = path.parent / name.replace("${PROJECT_NAME}", path.parent.name)
                tracked = subprocess.run(
                    ["git", "ls-files", str(folder)], cwd=str(ROOT), stdout=subprocess.PIPE, text=True, check=True
                )
                assert tracked.stdout, "%s installs %s, which is not in git" % (path, name)
