"""The workspace builds with both of catkin's tools, and installs: nodes fly from the install space too."""

import os
import pathlib
import re
import shutil
import subprocess

import pytest
from flying import fly

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


@pytest.mark.release
@pytest.mark.alone
def test_a_vehicle_flies_from_the_install_space(install_space, tmp_path):
    # setup.bash reads the arguments of the script that sources it
    script = """arguments=("$@"); set --; . "$0/setup.bash"
        which python3 && rospack find risc_control && python3 -m risc_experiments.precompile &&
        exec python3 "${arguments[@]}" """
    code, output, _, folder = fly(
        tmp_path / "flight",
        *("--vehicles", "1", "--duration", "5"),
        command=("bash", "-c", script, str(install_space)),
        env=dict(BARE, RISC_MAAP_ROOT=str(ROOT)),
        cwd=str(tmp_path),
    )
    assert code == 0 and "PASSED" in output, output
    assert str(ROOT / ".venv/bin/python3") in output, "setup.bash puts the right Python first"
    assert str(install_space / "share/risc_control") in output
    # The log that roslaunch writes for itself names every program that it starts, and its whole environment.
    logs = [folder / "roslaunch.log", *folder.glob("ros_log/*/roslaunch-*.log")]
    text = "".join(path.read_text(errors="replace") for path in logs)
    commands = [re.findall(r"'([^']*)'", command) for command in re.findall(r"args\[\[([^\]]+)\]", text)]
    # with_priority is followed by a number and the program that it becomes
    commands += [words[2:] for words in commands if words[0].endswith("/with_priority")]
    programs = {pathlib.Path(words[0]) for words in commands if words[0].startswith("/")}
    ours = {program for program in programs if pathlib.Path("/usr") not in program.parents}
    assert {program.name for program in ours} >= {
        "stream_markers",
        "states_estimation.py",
        "generic_DF_controller.py",
        "risc_controller.py",
        "ardrone_driver",
        "virtual_lab_node.py",
    }
    assert [str(program) for program in ours if install_space / "lib" not in program.parents] == []
    for devel_space in (ROOT / "devel", install_space.parent / "devel"):
        assert str(devel_space) not in text


@pytest.mark.release
@pytest.mark.alone
def test_catkin_build_builds_it_too(tmp_path):
    (tmp_path / "src").symlink_to(ROOT / "src")
    run(["catkin", "config", "--init", "--no-extend", "--cmake-args", PYTHON], tmp_path, env=BARE)
    run(["catkin", "build", "--no-status", "--no-notify", "--summarize"], tmp_path, env=BARE)
    script = ". devel/setup.bash && rosrun cortex_ros cortex_dump --file %s" % (
        ROOT / "src/cortex_ros/test/golden/frame_2bodies.bin"
    )
    assert '"type"' in run(["bash", "-c", script], tmp_path, env=BARE)


@pytest.mark.release  # in small: test_env_loader.py
@pytest.mark.alone
def test_the_env_loader_of_the_install_space_is_for_that_space(install_space, tmp_path):
    found = run([str(install_space / "coop.sh"), "rospack", "find", "risc_control"], tmp_path, env=BARE)
    assert found.strip() == str(install_space / "share/risc_control")


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
