"""What the landmarks look like and how to look for them: config/landmarks.yaml. Needs no ROS."""

from dataclasses import dataclass, field, fields
from typing import Dict, Tuple

from risc_control.lab.yaml_reader import Section, load_yaml, package_file
from risc_visual.colours import HsvRange, colours_from_section, whole

CONFIG = "config/landmarks.yaml"  # of package risc_visual


@dataclass(frozen=True)
class LandmarkKind:
    """One landmark: a disc with a centre of one paint in a ring of another."""

    name: str  # motion capture template
    roi_name: str  # name in Observed_rois
    centre: str  # paint
    ring: str  # paint


@dataclass(frozen=True)
class DetectorParams:
    """Thresholds of the detector; config/landmarks.yaml explains and holds the same values."""

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
        if not 1 <= self.shrink <= 8:
            raise ValueError("'shrink' must be in 1..8, found %r" % (self.shrink,))
        if self.diameter_min_px < 4.0:
            raise ValueError("'diameter_min_px' must be at least 4, found %r" % (self.diameter_min_px,))
        for item in fields(self)[2:]:
            if not 0.0 <= getattr(self, item.name) <= 1.0:
                raise ValueError("'%s' must be in [0, 1], found %r" % (item.name, getattr(self, item.name)))


@dataclass(frozen=True)
class LandmarksConfig:
    """What to look for, and how."""

    colours: Dict[str, HsvRange]
    landmarks: Tuple[LandmarkKind, ...]
    centre_diameter_m: float = 0.20
    ring_diameter_m: float = 0.30
    detector: DetectorParams = field(default_factory=DetectorParams)

    def __post_init__(self):
        if not 0.0 < self.centre_diameter_m < self.ring_diameter_m:
            raise ValueError(
                "'ring_diameter_m' (%g) must be larger than 'centre_diameter_m' (%g), and both positive"
                % (self.ring_diameter_m, self.centre_diameter_m)
            )
        if not self.landmarks:
            raise ValueError("'landmarks' is empty: list at least one")
        for key in ("name", "roi_name"):
            names = [getattr(kind, key) for kind in self.landmarks]
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise ValueError("two landmarks have the same %s: %s" % (key, ", ".join(twice)))
        for kind in self.landmarks:
            for key in ("centre", "ring"):
                paint = getattr(kind, key)
                if paint not in self.colours:
                    raise ValueError(
                        "landmark %s: '%s' is %r, which is no colour; known are %s"
                        % (kind.name, key, paint, ", ".join(self.colours))
                    )
            if kind.centre == kind.ring:
                raise ValueError("landmark %s: centre and ring have the same colour, %s" % (kind.name, kind.ring))

    @property
    def ring_scale(self):
        """Diameter of the ring / of the centre."""
        return self.ring_diameter_m / self.centre_diameter_m


def load_landmarks(path=None):
    """LandmarksConfig of a file, or of risc_visual/config/landmarks.yaml. Raises ValueError naming file and key."""
    path = package_file("risc_visual", CONFIG) if path is None else path
    return landmarks_from_dict(load_yaml(path), str(path))


def landmarks_from_dict(content, where="landmarks"):
    """LandmarksConfig from the content of its YAML file. Raises ValueError that names the key."""
    root = Section(content, where)
    colours = colours_from_section(root.section("colours"), where + ", colours")
    kinds = []
    for section in root.sections("landmarks"):
        kinds.append(LandmarkKind(*[section.text(item.name) for item in fields(LandmarkKind)]))
        section.done()
    discs = root.section("discs", {})
    sizes = {
        key: discs.number(key, getattr(LandmarksConfig, key), 0.0, 100.0)
        for key in ("centre_diameter_m", "ring_diameter_m")
    }
    discs.done()
    thresholds = root.section("detector", {})
    try:
        values = {item.name: thresholds.number(item.name, item.default) for item in fields(DetectorParams)}
        values["shrink"] = whole(values["shrink"], "shrink")
        thresholds.done()
        root.done()
        return LandmarksConfig(colours, tuple(kinds), detector=DetectorParams(**values), **sizes)
    except ValueError as error:
        text = str(error)
        raise ValueError(text if text.startswith(where) else "%s: %s" % (where, text)) from error
