"""Masks by colour for tuning the thresholds of a paint, and saving these in a landmarks file. Needs no ROS."""

import os
import pathlib
import re
from dataclasses import dataclass

import cv2
import numpy as np
from ruamel.yaml import YAML, YAMLError
from ruamel.yaml.comments import CommentedMap

from risc_lab.settings import Settings, between
from risc_visual.vision.colours import HUES, HsvRange, Planes
from risc_visual.vision.landmark_config import detector_file, load_landmarks

_SIGMA_PX = 2.0  # of the blur, as in the original release


@dataclass(frozen=True)
class MaskSettings(Settings):
    """Thresholds of one paint, inclusive; the defaults are those of the original release's green."""

    hue_high: int = 78
    hue_low: int = 54  # above hue_high: the range wraps through red
    saturation_high: int = 196
    saturation_low: int = 26
    value_high: int = 255
    value_low: int = 84
    kernel: between(0, 20) = 1  # [px] radius of the kernel that closes holes in the mask
    blur: between(0, 100) = 1  # [px] radius of the blur of the mask
    colour: str = "green"  # whose thresholds `save` writes
    file: str = ""  # landmarks file that `save` writes

    def __post_init__(self):
        super().__post_init__()
        self.paint()

    def paint(self):
        """HsvRange of the thresholds. The sliders go to 180 as the original's, the hue of a picture only to 179."""
        hue = min(self.hue_low, HUES - 1), min(self.hue_high, HUES - 1)
        return HsvRange(hue, (self.saturation_low, self.saturation_high), (self.value_low, self.value_high))


def make_mask(bgr, settings):
    """(h, w) uint8, 255 where the picture (h, w, 3) has the paint, holes closed and borders blurred."""
    mask = Planes(bgr).mask(settings.paint())
    if settings.kernel:
        size = 2 * settings.kernel + 1
        mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    if settings.blur:
        size = 2 * settings.blur + 1
        mask = cv2.GaussianBlur(mask, (size, size), _SIGMA_PX)
    return mask


def draw_mask(bgr, mask):
    """The picture, grey where the mask is 0, with the outlines of the mask."""
    grey = cv2.cvtColor(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR) // 2
    painted = mask > 127
    drawn = np.where(painted[:, :, None], bgr, grey)
    outlines, _ = cv2.findContours(painted.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
    cv2.drawContours(drawn, outlines, -1, (255, 255, 255), 1)
    return drawn


def save_colour(path, name, paint):
    """Write an HsvRange into a landmarks file; its other content and comments stay. A new file copies the package's.

    Returns the absolute path: a node that roslaunch starts is not in the user's folder. Raises ValueError with cause
    and remedy; the file is unchanged then.
    """
    if not str(path):
        raise ValueError("no file to write: give the parameter ~file, e.g. _file:=my_landmarks.yaml")
    if not re.fullmatch(r"\w+", name):
        raise ValueError("%r is not a valid colour name: use letters, digits and _" % name)
    path = pathlib.Path(path).expanduser().absolute()
    source = path if path.exists() else detector_file()
    load_landmarks(source)  # raises ValueError if it is not such a file
    limits = CommentedMap((key, list(getattr(paint, key))) for key in ("hue", "saturation", "value"))
    limits.fa.set_flow_style()
    file = YAML()
    file.width = 1000  # wraps no line
    try:
        content = file.load(source)
        content["colours"][name] = limits
        # Under another name first: a full disk must not leave half a file.
        new = path.with_name(path.name + ".new")
        file.dump(content, new)
        os.replace(new, path)
    except (OSError, YAMLError) as error:
        raise ValueError("cannot write %s: %s" % (path, error)) from error
    return path
