"""Nothing that draws is needed for flight: rviz and every drawing node are killed in the air, and the flight passes."""

import contextlib
import os
import pathlib
import re
import signal
import time
import xml.etree.ElementTree as ElementTree

import pytest
from flying import ROOT, end, fly, left_behind, wait_for_line

from risc_visual.pictures.virtual_screen import VirtualScreen, missing_programs

DRAWING = ROOT / "src" / "risc_visual" / "launch" / "risc_visualize.launch"
LAUNCH_FILES = [*ROOT.glob("launch/*.launch"), *ROOT.glob("src/*/launch/*.launch")]
# This file runs the calibrator, and ends with the calibrator's window; nothing flies meanwhile.
CALIBRATION = DRAWING.with_name("camera_setup.launch")
FLYING = [path for path in LAUNCH_FILES if path != CALIBRATION]
START_PATIENCE_S = 60.0
BETWEEN_S = 1.0  # between two kills


def drawing_programs():
    """File names of the programs that risc_visualize.launch starts by default."""
    arguments = {node.get("name"): node.get("default") for node in ElementTree.parse(DRAWING).iter("arg")}
    found = set()
    for node in ElementTree.parse(DRAWING).iter("node"):
        condition = re.fullmatch(r"\$\(arg (\w+)\)", node.get("if", ""))
        if condition is None or arguments[condition.group(1)] == "true":
            found.add("rviz" if node.get("type") == "open_rviz" else node.get("type"))
    return found


def running(folder, names):
    """{process id: name} of the programs of a flight that have one of the names."""
    found = {}
    for pid in left_behind(folder):
        with contextlib.suppress(OSError):  # it ended meanwhile
            words = pathlib.Path("/proc/%d/cmdline" % pid).read_bytes().decode(errors="replace").split("\0")
            # an interpreter comes before the script; what only starts another program (with_priority) is replaced by it
            name = next((pathlib.Path(word).name for word in words[:2] if pathlib.Path(word).name in names), None)
            if name:
                found[pid] = name
    return found


def nodes_of_risc_visual(path):
    """Elements of a launch file that start programs that draw, or look at pictures."""
    return [node for node in ElementTree.parse(path).iter("node") if node.get("pkg") == "risc_visual"]


@pytest.mark.parametrize("path", FLYING, ids=lambda path: "/".join(path.parts[-3:]))
def test_no_launch_file_makes_drawing_required(path):
    for node in nodes_of_risc_visual(path):
        assert node.get("required", "false") == "false", node.get("name")


def test_no_program_that_draws_escapes_that_test():
    found = {node.get("type") for path in FLYING for node in nodes_of_risc_visual(path)}
    assert found >= {"open_rviz", "draw_cortex", "draw_waypoints", "draw_overlay", "transform_tuner", "DF_Plots.py"}
    assert found >= {"live_view", "risc_landmarks", "compress_images"}


def test_what_calibrates_a_camera_is_in_no_launch_file_that_flies():
    assert any(node.get("required") == "true" for node in nodes_of_risc_visual(CALIBRATION))
    includes = {
        path: [include.get("file") for include in ElementTree.parse(path).iter("include")] for path in LAUNCH_FILES
    }
    users = {path.name for path, files in includes.items() if any(CALIBRATION.name in name for name in files)}
    assert users == {"risc_camera_setup.launch", "risc_camera_setup_bottom.launch"}
    starters = {path.name for path, files in includes.items() for name in files if pathlib.Path(name).name in users}
    assert starters == set()


def test_these_are_the_programs_that_draw():
    assert drawing_programs() >= {"rviz", "draw_risc_maap", "draw_cortex", "draw_trajectories"}


def kill_what_draws(flight, folder):
    """In the air, one after the other, as if each had crashed."""
    names = drawing_programs()
    wait_for_line(flight, folder, " fly")
    try:
        deadline = time.monotonic() + START_PATIENCE_S
        while set(running(folder, names).values()) != names:
            assert flight.poll() is None and time.monotonic() < deadline, "only %s run" % running(folder, names)
            time.sleep(0.2)
        for pid in running(folder, names):
            os.kill(pid, signal.SIGKILL)
            time.sleep(BETWEEN_S)
        assert flight.poll() is None, "the flight was over before everything was killed"
        assert running(folder, names) == {}, "nothing of it came back"
    except BaseException:
        end(flight, folder)
        raise


@pytest.mark.release  # of the drawing nodes without rviz: test_live_view.py
@pytest.mark.alone
@pytest.mark.skipif(
    bool(missing_programs("rviz")), reason="no rviz or no Xvfb: './maap screenshot' installs what pictures need"
)
def test_a_flight_passes_although_rviz_and_all_drawing_nodes_are_killed(tmp_path):
    with VirtualScreen() as screen:
        environment = screen.environment(RISC_MAAP_ROOT=str(ROOT))
        flight = ("--vehicles", "1", "--duration", "40", "--rviz")
        code, output, _, folder = fly(tmp_path, *flight, meanwhile=kill_what_draws, env=environment)
    assert code == 0, output
    assert left_behind(folder) == []
