"""open_rviz: executes rviz, or says in one line what is missing."""

import os
import pathlib
import subprocess
import sys

NODE = pathlib.Path(__file__).resolve().parents[1] / "nodes" / "open_rviz"


def run(folder, **environment):
    return subprocess.run(
        [sys.executable, str(NODE), "-d", "some.rviz", "__name:=rviz"],
        env=dict(
            {key: value for key, value in os.environ.items() if key != "DISPLAY"}, PATH=str(folder), **environment
        ),
        capture_output=True,
        text=True,
        timeout=120,
    )


def with_rviz(folder):
    """A stand-in for rviz that prints its arguments."""
    rviz = folder / "rviz"
    rviz.write_text("#!/bin/sh\necho $0 $*\n")
    rviz.chmod(0o755)
    return folder


def test_becomes_rviz_with_all_arguments(tmp_path):
    done = run(with_rviz(tmp_path), DISPLAY=":1")
    assert (done.returncode, done.stdout) == (0, "%s/rviz -d some.rviz __name:=rviz\n" % tmp_path)


def test_says_that_rviz_is_missing(tmp_path):
    done = run(tmp_path, DISPLAY=":1")
    assert done.returncode == 1
    assert "apt-get install rviz" in done.stderr and done.stderr.count("\n") == 1


def test_says_that_there_is_no_screen(tmp_path):
    done = run(with_rviz(tmp_path))
    assert done.returncode == 1
    assert "DISPLAY" in done.stderr and done.stderr.count("\n") == 1
