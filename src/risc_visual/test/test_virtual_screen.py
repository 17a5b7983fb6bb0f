"""The virtual screen: a picture shows what a program has drawn, and nothing is left running."""

import os
import shutil
import subprocess
import sys
import time

import cv2
import numpy as np
import psutil
import pytest

from risc_visual.pictures.virtual_screen import (
    ScreenError,
    VirtualScreen,
    missing_programs,
    save_picture,
    shows_something,
)

# A window of one colour, by Xlib: x, y, width, height, colour.
WINDOW = """
import ctypes, sys, time
x, y, width, height, colour = (int(text, 0) for text in sys.argv[1:])
xlib = ctypes.CDLL("libX11.so.6")
xlib.XOpenDisplay.restype = ctypes.c_void_p
display = ctypes.c_void_p(xlib.XOpenDisplay(None))
root = xlib.XDefaultRootWindow(display)
window = xlib.XCreateSimpleWindow(display, root, x, y, width, height, 0, 0, colour)
xlib.XMapWindow(display, window)
xlib.XSync(display, 0)
time.sleep(60)
"""

needs_screen = pytest.mark.skipif(
    bool(missing_programs()), reason="no Xvfb: './maap screenshot' installs what pictures need"
)


def window(*arguments):
    return [sys.executable, "-c", WINDOW, *arguments]


def has_orange(picture):
    return (picture == (255, 128, 0)).all(axis=2).any()


@needs_screen
def test_a_window_is_in_the_picture_where_and_as_it_was_drawn(tmp_path):
    with VirtualScreen(321, 240) as screen:
        screen.start(window("100", "50", "80", "60", "0xff8000"))
        picture = screen.steady_picture(accept=has_orange, steady_s=0.3)
    assert picture.shape == (240, 321, 3) and picture.dtype == np.uint8
    inside = np.zeros((240, 321), dtype=bool)
    inside[50:110, 100:180] = True
    np.testing.assert_array_equal((picture == (255, 128, 0)).all(axis=2), inside)
    save_picture(tmp_path / "window.png", picture)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "window.png"))[:, :, ::-1], picture)


@needs_screen
def test_screens_do_not_see_each_other():
    with VirtualScreen(200, 100) as first, VirtualScreen(200, 100) as second:
        assert first.display != second.display
        first.start(window("0", "0", "50", "50", "0xff8000"))
        first.steady_picture(accept=has_orange, steady_s=0.3)
        assert not has_orange(second.picture())


@pytest.fixture
def own_display(tmp_path, monkeypatch):
    """Xvfb takes a display of its own: another test may take the lowest free one as soon as it is released."""
    program = tmp_path / "Xvfb"
    program.write_text('#!/bin/sh\nexec %s "$@" :%d\n' % (shutil.which("Xvfb"), 1000 + os.getpid() % 50000))
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)


@needs_screen
@pytest.mark.usefixtures("own_display")
def test_everything_ends_with_the_screen():
    with VirtualScreen(200, 100) as screen:
        program = screen.start(window("0", "0", "50", "50", "0xff8000"))
        screen.steady_picture(accept=has_orange, steady_s=0.3)
    assert program.poll() is not None
    socket = "/tmp/.X11-unix/X" + screen.display[1:]
    assert not os.path.exists(socket)
    # programs that still use the display are told so
    late = subprocess.run(window("0", "0", "5", "5", "0"), env=screen.environment(), timeout=60, capture_output=True)
    assert late.returncode != 0


@needs_screen
@pytest.mark.usefixtures("own_display")
def test_everything_ends_with_whoever_opened_the_screen():
    """Also if that is killed and cannot clean up."""
    script = """
import time, psutil
from risc_visual.pictures.virtual_screen import VirtualScreen
screen = VirtualScreen(200, 100)
program = psutil.Process(screen.start(["sleep", "1000"]).pid)
while program.name() != "sleep":
    time.sleep(0.01)
print(program.pid, screen.display[1:], flush=True)
time.sleep(1000)
"""
    opened = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    pid, number = opened.stdout.readline().split()
    opened.kill()
    opened.wait()
    _, alive = psutil.wait_procs([psutil.Process(int(pid))] if psutil.pid_exists(int(pid)) else [], timeout=30.0)
    assert not alive
    deadline = time.monotonic() + 30.0
    while os.path.exists("/tmp/.X11-unix/X" + number):
        assert time.monotonic() < deadline, "Xvfb goes on"
        time.sleep(0.05)


@needs_screen
def test_a_program_that_ends_is_told_with_its_last_words():
    with VirtualScreen(200, 100) as screen:
        screen.start([sys.executable, "-c", "raise SystemExit('no luck today')"])
        with pytest.raises(ScreenError, match=r"exit code 1\D*no luck today"):
            screen.steady_picture()


@needs_screen
def test_an_empty_screen_is_no_picture():
    with VirtualScreen(200, 100) as screen:
        assert not shows_something(screen.picture())
        with pytest.raises(ScreenError, match="shows nothing"):
            screen.steady_picture(steady_s=0.2, timeout_s=1.0)


def test_missing_programs_are_named(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert missing_programs("rviz") == ["Xvfb", "rviz"]
    with pytest.raises(ScreenError, match="Xvfb"):
        VirtualScreen()


def test_something_is_more_than_a_window_with_a_frame():
    picture = np.zeros((100, 100, 3), dtype=np.uint8)
    picture[10:90, 10:90] = 200
    assert not shows_something(picture)
    picture[40, :, 0] = np.arange(100)
    assert shows_something(picture)
