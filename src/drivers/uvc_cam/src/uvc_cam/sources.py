"""Sources of pictures: a camera (V4L2, by OpenCV), a video file, a folder of pictures. No ROS.

A source is read in two steps: `wait` returns when the next picture is there (its time is now), `picture` returns it as
(h, w, 3) uint8, blue green red. `SourceError` says in one sentence what is wrong and how to fix it.
"""

import fcntl
import os
import pathlib
import stat
import struct
import time

import cv2

from uvc_cam.settings import FORMATS, CameraSettings, changed_controls

SUFFIXES = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp")

_VIDIOC_S_CTRL = 0xC008561C  # _IOWR('V', 28, struct v4l2_control {u32 id; s32 value})
_V4L2_CID_POWER_LINE_FREQUENCY = 0x00980918
_PROPERTIES = {
    "exposure": cv2.CAP_PROP_AUTO_EXPOSURE,  # before absolute_exposure, which is refused while exposure is automatic
    "absolute_exposure": cv2.CAP_PROP_EXPOSURE,
    "sharpness": cv2.CAP_PROP_SHARPNESS,
    "white_balance_temperature": cv2.CAP_PROP_AUTO_WB,
    "gain": cv2.CAP_PROP_GAIN,
    "saturation": cv2.CAP_PROP_SATURATION,
    "contrast": cv2.CAP_PROP_CONTRAST,
    "brightness": cv2.CAP_PROP_BRIGHTNESS,
}


class SourceError(Exception):
    """There are no pictures; the text says why."""


class NoMorePicturesError(SourceError):
    """A file or folder has been played to its end."""


def open_source(settings):
    """Open the source that `settings.device` names. Raises SourceError."""
    device = settings.device
    if device.isdigit():
        device = "/dev/video" + device
    path = pathlib.Path(device).expanduser()
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise SourceError(
            "there is no %s (%s): plug the camera in, or set the parameter device to a camera, a video file or a folder"
            % (path, error.strerror)
        ) from error
    if stat.S_ISDIR(mode):
        return FolderSource(path, settings)
    if stat.S_ISREG(mode):
        return VideoSource(path, settings)
    return CameraSource(path, settings)


class _Pace:
    """Sleeps from picture to picture; after a late one it does not catch up."""

    def __init__(self, rate_hz):
        self._period_s = 1.0 / rate_hz
        self._due_s = time.monotonic()

    def wait(self):
        now_s = time.monotonic()
        if now_s < self._due_s:
            time.sleep(self._due_s - now_s)
        self._due_s = max(self._due_s, now_s) + self._period_s


class Source:
    """Base class of sources: `wait` for the next picture, then take it; SourceError when none comes."""

    def __init__(self):
        self.notes = []  # sentences to be logged as warnings

    def set_controls(self, controls):
        """Set controls of a camera, a dict of name -> value; does nothing for files."""

    def close(self):
        """Release the source."""


class FolderSource(Source):
    """The pictures of a folder in the order of their names, at the frame rate."""

    def __init__(self, folder, settings):
        super().__init__()
        try:
            entries = sorted(folder.iterdir())
        except OSError as error:
            raise SourceError("cannot read the folder %s: %s" % (folder, error.strerror)) from error
        self._paths = [path for path in entries if path.suffix.lower() in SUFFIXES]
        if not self._paths:
            raise SourceError("no pictures (%s) in the folder %s" % (", ".join(SUFFIXES), folder))
        self._folder, self._loop = folder, settings.loop
        self._pace = _Pace(settings.frame_rate)
        self._next, self._picture = 0, None

    def wait(self):
        self._pace.wait()
        while self._paths:
            if self._next == len(self._paths):
                if not self._loop and self._picture is not None:
                    raise NoMorePicturesError("all %d pictures of %s are shown" % (len(self._paths), self._folder))
                self._next = 0
            path = self._paths[self._next]
            picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
            if picture is not None:
                self._next += 1
                self._picture = picture
                return
            self.notes.append("%s cannot be read as a picture and is left out" % path)
            self._paths.remove(path)
        raise SourceError("none of the pictures in %s can be read (any more)" % self._folder)

    def picture(self):
        return self._picture


class _CaptureSource(Source):
    """Pictures captured by OpenCV. complaint: error text for a picture that cannot be decoded."""

    def __init__(self, path, capture, complaint):
        super().__init__()
        self._path, self._capture, self._complaint = path, capture, complaint

    def picture(self):
        there, picture = self._capture.retrieve()
        if not there or picture is None or not picture.size:
            raise SourceError("%s %s" % (self._path, self._complaint))
        return picture if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)

    def close(self):
        self._capture.release()


class VideoSource(_CaptureSource):
    """A video file, played at the frame rate of the settings, not at its own."""

    def __init__(self, path, settings):
        capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        super().__init__(path, capture, "contains a picture that cannot be decoded: the file is damaged")
        if not capture.isOpened():
            raise SourceError("%s is not a video that OpenCV can read: give it an .avi, .mp4 or .mkv" % path)
        self._loop = settings.loop
        self._pace = _Pace(settings.frame_rate)
        self._read_any = False

    def wait(self):
        self._pace.wait()
        if not self._capture.grab():
            if not self._read_any:
                raise SourceError("the video %s contains no pictures" % self._path)
            if not self._loop:
                raise NoMorePicturesError("the video %s is at its end" % self._path)
            self._capture.release()
            # seeking to the start is not exact in every format
            if not self._capture.open(str(self._path), cv2.CAP_FFMPEG) or not self._capture.grab():
                raise SourceError("the video %s cannot be read any more" % self._path)
        self._read_any = True


class CameraSource(_CaptureSource):
    """A camera by V4L2, at its own rate. Controls that the camera lacks are noted."""

    def __init__(self, path, settings, capture_class=cv2.VideoCapture, ioctl=fcntl.ioctl):
        """capture_class, ioctl: replaced in tests."""
        if not os.access(str(path), os.R_OK | os.W_OK):
            raise SourceError(
                "%s may not be opened by this user: add the user to the group video, then log out and in again" % path
            )
        capture = capture_class(str(path), cv2.CAP_V4L2)
        super().__init__(path, capture, "sent a picture that cannot be decoded: try another format_mode")
        self._ioctl = ioctl
        if not capture.isOpened():
            raise SourceError(
                "%s cannot be opened as a camera: is another program using it, or is it the camera's second device "
                "(v4l2-ctl --list-devices lists them)?" % path
            )
        if FORMATS[settings.format_mode]:
            capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter_fourcc(*FORMATS[settings.format_mode]))
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, settings.width)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, settings.height)
        capture.set(cv2.CAP_PROP_FPS, settings.frame_rate)
        given = tuple(round(capture.get(side)) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if given != (settings.width, settings.height):
            self.notes.append(
                "%s gives %d x %d instead of %d x %d: set width and height to a size that it has "
                "(v4l2-ctl --list-formats-ext)" % (path, *given, settings.width, settings.height)
            )
        self.set_controls(changed_controls(CameraSettings(), settings))

    def wait(self):
        if not self._capture.grab():
            raise SourceError("%s sends no more pictures: is it unplugged?" % self._path)

    def set_controls(self, controls):
        for name in (*_PROPERTIES, "power_line_frequency"):
            if name in controls and not self._set_control(name, controls[name]):
                self.notes.append("%s does not take %s = %r" % (self._path, name, controls[name]))

    def _set_control(self, name, value):
        if name in _PROPERTIES:
            return self._capture.set(_PROPERTIES[name], float(value))
        # OpenCV has no name for this one; a second opening may set controls while the first one streams.
        try:
            fd = os.open(str(self._path), os.O_RDWR | os.O_NONBLOCK)
            try:
                self._ioctl(fd, _VIDIOC_S_CTRL, struct.pack("=Ii", _V4L2_CID_POWER_LINE_FREQUENCY, value))
            finally:
                os.close(fd)
        except OSError:
            return False
        return True
