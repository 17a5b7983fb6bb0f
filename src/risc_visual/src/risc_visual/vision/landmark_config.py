"""What the landmarks look like and how to look for them: config/landmark_detector.yaml. Needs no ROS."""

from dataclasses import dataclass, field, fields

import numpy as np

from risc_lab.lab.landmark_catalogue import LandmarkCatalogue, catalogue_from_section, load_landmark_catalogue
from risc_lab.lab.ranges import check_ranges
from risc_lab.lab.yaml_reader import Section, errors_of, load_yaml, package_file
from risc_visual.vision.colours import HsvRange, check_paints, colours_from_section


@dataclass(frozen=True)
class DetectorParams:
    """Thresholds of the detector; config/landmark_detector.yaml explains and holds the same values."""

    shrink: int = 2
    diameter_min_px: float = 7.0
    aspect_min: float = 0.2
    fill_min: float = 0.80
    ring_min: float = 0.55
    centre_min: float = 0.7
    arc_min: float = 0.45
    bounded_min: float = 0.4
    vivid_min: float = 0.55
    misfit_max: float = 0.03

    def __post_init__(self):
        shares = {item.name: (0.0, 1.0) for item in fields(self)[2:]}
        check_ranges(self, shrink=(1, 8), diameter_min_px=(4.0, np.inf), **shares)


@dataclass(frozen=True)
class LandmarksConfig(LandmarkCatalogue):
    """What to look for, and how."""

    colours: dict[str, HsvRange] = field(default_factory=dict)
    detector: DetectorParams = field(default_factory=DetectorParams)

    def __post_init__(self):
        super().__post_init__()
        for kind in self.landmarks:
            check_paints(self.colours, kind, ("centre", "ring"))

    @property
    def ring_scale(self):
        """Diameter of the ring / of the centre."""
        return self.discs.ring_diameter_m / self.discs.centre_diameter_m


def detector_file():
    """Path of the detector's settings that ship with this package."""
    return package_file("risc_visual", "config/landmark_detector.yaml")


def load_landmarks(path=None):
    """LandmarksConfig of a file, or of risc_visual/config/landmark_detector.yaml. Raises ValueError: file and key."""
    path = detector_file() if path is None else path
    return landmarks_from_dict(load_yaml(path), str(path))


def landmarks_from_dict(content, where="landmarks"):
    """LandmarksConfig from the content of its YAML file. Raises ValueError that names the key.

    A file that lists no landmarks means those of the laboratory.
    """
    root = Section(content, where)
    colours = colours_from_section(root.section("colours"))
    own = {"landmarks", "discs"} & set(root.keys())
    catalogue = catalogue_from_section(root) if own else load_landmark_catalogue()
    root.content("markers", {})  # of the laboratory's file: nothing to see
    detector = root.section("detector", {}).settings(DetectorParams)
    root.done()
    with errors_of(where):
        return LandmarksConfig(colours=colours, detector=detector, **vars(catalogue))
