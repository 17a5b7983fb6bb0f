"""A screen without a monitor: programs that open windows run on it, and its content is a numpy array.

For pictures without a desktop (`./maap screenshot`) and for tests that use a mouse as a person would:

    with VirtualScreen(1280, 900) as screen:
        screen.start(["rviz", "-s", "", "-d", "view.rviz"], log=folder / "rviz.log")
        picture = screen.steady_picture()                     # (900, 1280, 3) uint8, RGB
        save_picture(folder / "view.png", picture)
        subprocess.run(["xdotool", "mousemove", "640", "450", "click", "1"], env=screen.environment(), check=True)

What was started ends with the screen, and when the program that started it dies. There is no window manager: windows
stand where their programs put them, and none has a frame. Drawing is in software and takes a core, so do not measure a
flight beside it.
"""

import contextlib
import os
import pathlib
import shutil
import signal
import subprocess
import tempfile
import time

import cv2
import numpy as np
from PIL import ImageGrab

from risc_lab.mortal import mortal

_END_PATIENCE_S = 10.0
_POLL_S = 0.2
_LOG_LINES = 15
_COLOURS = 16  # fewer: an empty window and its frame


class ScreenError(RuntimeError):
    """A virtual screen or a program on it does not work; the text says why and what to do."""


def missing_programs(*programs):
    """Those of the programs, and of what a virtual screen itself needs, that are not installed."""
    return [name for name in ("Xvfb", *programs) if shutil.which(name) is None]


def shows_something(picture):
    """Whether a picture (height, width, 3) has more than an empty window."""
    packed = picture.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], dtype=np.uint32)
    return len(np.unique(packed)) >= _COLOURS


def save_picture(path, picture):
    """Write a picture (height, width, 3), uint8, RGB, as PNG. Raises OSError when the file cannot be written."""
    encoded = cv2.imencode(".png", picture[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
    pathlib.Path(path).write_bytes(encoded.tobytes())


class VirtualScreen(contextlib.ExitStack):
    """Xvfb on a display of its own, and the programs that run on it. Use as a context manager, in the main thread.

    At its end the programs are ended, the youngest first, and the screen.
    """

    def __init__(self, width_px=1280, height_px=900):
        """Raises ScreenError when Xvfb is missing or does not start."""
        super().__init__()
        self._programs = []  # (command, process, log)
        self._folder = pathlib.Path(self.enter_context(tempfile.TemporaryDirectory(prefix="screen-")))
        self.display = None
        command = ["Xvfb", "-displayfd", "1", "-screen", "0", "%dx%dx24" % (width_px, height_px)]
        command += ["-noreset", "-nocursor", "-nolisten", "tcp", "+extension", "GLX"]
        try:
            with self.start(command, stdout=subprocess.PIPE).stdout as pipe:
                number = pipe.readline().strip()  # comes when the server is ready; nothing when it has ended
            if not number:
                raise ScreenError("Xvfb did not start: %s" % _tail(self._programs[0][2]))
        except ScreenError:
            self.close()
            raise
        self.display = ":" + number.decode()

    def environment(self, **more):
        """Environment for a program that is to use this screen; `more` overrides it."""
        ours = {
            "DISPLAY": self.display or "",
            "LIBGL_ALWAYS_SOFTWARE": "1",
            "QT_QPA_PLATFORM": "xcb",
            "QT_X11_NO_MITSHM": "1",
            "NO_AT_BRIDGE": "1",  # else GTK and Qt look for a desktop's accessibility service
            "XDG_RUNTIME_DIR": str(self._folder),
        }
        return dict(os.environ, **ours, **more)

    def start(self, command, log=None, stdout=None, **environment):
        """Start a program on this screen; returns its Popen. log: file for what it prints; environment: more variables.

        Raises ScreenError when it is not installed.
        """
        if shutil.which(command[0]) is None:
            raise ScreenError("%s is not installed: './maap screenshot' installs what pictures need" % command[0])
        log = pathlib.Path(log or self._folder / ("%d.log" % len(self._programs)))
        with log.open("wb") as output:
            process = subprocess.Popen(
                mortal("TERM", command),
                stdin=subprocess.DEVNULL,
                stdout=stdout or output,
                stderr=output,
                env=self.environment(**environment),
                start_new_session=True,  # a Ctrl-C at the terminal must not reach it
            )
        self.callback(_end, process)
        self._programs.append((command, process, log))
        return process

    def picture(self):
        """What is on the screen now: (height, width, 3), uint8, RGB."""
        try:
            return np.asarray(ImageGrab.grab(xdisplay=self.display).convert("RGB"))
        except OSError as error:
            raise ScreenError("the virtual screen %s does not answer: %s" % (self.display, error)) from None

    def steady_picture(self, accept=shows_something, steady_s=2.0, timeout_s=300.0):
        """The picture as soon as it has not changed for `steady_s` and accept(picture) holds.

        It must also be the same at a number of looks, so on a busy computer, where all is late, it takes longer.
        Raises ScreenError when a program that was started here has ended, or when it takes longer than `timeout_s`.
        """
        deadline = time.monotonic() + timeout_s
        last, since, looks = None, time.monotonic(), 0
        while True:
            self.check_programs()
            picture, now = self.picture(), time.monotonic()
            if last is None or not np.array_equal(picture, last):
                last, since, looks = picture, now, 0
            looks += 1
            steady = now - since >= steady_s and looks > steady_s / _POLL_S
            if steady and accept(picture):
                return picture
            if now > deadline:
                why = "shows nothing that it should" if steady else "keeps changing"
                tails = "\n".join(_tail(log) for _, _, log in self._programs)
                raise ScreenError("the picture %s, after %g s:\n%s" % (why, timeout_s, tails))
            time.sleep(_POLL_S)

    def check_programs(self):
        """Raises ScreenError when a program that was started here has ended."""
        for command, process, log in self._programs:
            if process.poll() is not None:
                raise ScreenError("%s has ended (exit code %d):\n%s" % (command[0], process.returncode, _tail(log)))


def _end(process):
    """End a program and its children, first by SIGTERM: Xvfb removes its socket then."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(_END_PATIENCE_S)
            return


def _tail(log):
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    return "\n".join(lines[-_LOG_LINES:])
