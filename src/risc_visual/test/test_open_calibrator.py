"""open_calibrator: executes cameracalibrator.py in the system's Python, or says in one line what is missing."""

import os
import pathlib
import subprocess
import sys

NODE = pathlib.Path(__file__).resolve().parents[1] / "nodes" / "open_calibrator"


def run(*arguments, **environment):
    return subprocess.run(
        [sys.executable, str(NODE), *arguments],
        env=dict({key: value for key, value in os.environ.items() if key != "DISPLAY"}, **environment),
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_becomes_the_calibrator_with_all_arguments():
    assert "Usage: cameracalibrator.py --size" in run("--help", DISPLAY=":1").stdout
    done = run("--size", "8x6", "image:=ardrone/image_raw", DISPLAY=":1")
    assert done.returncode == 2 and "size and square inputs must be the same" in done.stderr


def test_says_that_there_is_no_screen_and_what_to_do():
    done = run("--size", "8x6")
    assert done.returncode == 1 and done.stdout == ""
    assert "DISPLAY" in done.stderr and "calibrate.py BAG" in done.stderr and done.stderr.count("\n") == 1


def test_its_python_can_open_a_window():
    """cameracalibrator.py imports there, and its OpenCV is one with windows."""
    code = "import cv2, camera_calibration.camera_calibrator; print(cv2.getBuildInformation())"
    done = subprocess.run(["/usr/bin/python3", "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    gui = done.stdout.split("GUI:")[1].splitlines()[0].strip()
    assert gui not in ("", "NONE")
