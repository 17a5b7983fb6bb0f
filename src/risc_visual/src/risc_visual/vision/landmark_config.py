"""What the landmarks look like and how to look for them: config/landmark_detector.yaml. Needs no ROS."""

from dataclasses import dataclass, field

from risc_lab.lab import landmark_catalogue
from risc_lab.lab.yaml_reader import load_yaml, package_file
from risc_lab.settings import Fraction, Settings, between, settings_from
from risc_visual.vision.colours import HsvRange, check_paints


@dataclass(frozen=True)
class DetectorParams(Settings):
    """Thresholds of the detector (thesis 4.4.5).

    They were set on rendered pictures with distances of 0.7 to 4 m, tilts to 70 degrees, motion blur to 6 px and
    brightness from 0.3 to 2; `./maap bench vision` measures what they do.
    """

    shrink: between(1, 8) = 2  # blobs are searched in a picture this much smaller, and measured in the whole one
    diameter_min_px: between(4.0, 1e4) = 7.0  # of a centre; the original asked for an area of 110 px, some 12 px
    aspect_min: Fraction = 0.2  # minor / major axis of a centre: 0.34 is a disc that is turned by 70 degrees
    fill_min: Fraction = 0.80  # area of a blob / area of the ellipse with its moments; 1 is an ellipse
    ring_min: Fraction = 0.55  # share of the perimeter that must have the ring's colour
    centre_min: Fraction = 0.7  # share of a centre that must have its colour
    arc_min: Fraction = 0.45  # share of a centre's outline that must be found; the rest may be hidden, or outside
    bounded_min: Fraction = 0.4  # share of the perimeter beyond which the ring must end
    vivid_min: Fraction = 0.55  # saturation of the ring's colour / that of the centre's: both stand in the same light
    misfit_max: Fraction = 0.03  # rms distance of a centre's outline from an ellipse / its radius, beside half a pixel


@dataclass(frozen=True)
class LandmarksConfig(landmark_catalogue.LandmarkCatalogue):
    """What to look for, and how."""

    colours: dict[str, HsvRange] = field(kw_only=True)
    detector: DetectorParams = DetectorParams()

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
    path = path or detector_file()
    return landmarks_from_dict(load_yaml(path), str(path))


def landmarks_from_dict(content, where="landmarks"):
    """LandmarksConfig from the content of its YAML file. Raises ValueError that names the key.

    A file that lists no landmarks means those of the laboratory.
    """
    if isinstance(content, dict) and "landmarks" not in content:
        content = {**load_yaml(landmark_catalogue.landmarks_file()), **content}
    return settings_from(LandmarksConfig, content, where)
