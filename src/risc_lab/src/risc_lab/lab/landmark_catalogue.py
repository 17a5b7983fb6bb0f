"""The landmarks: their names on each topic, their paints and their sizes. Needs no ROS."""

from dataclasses import dataclass, field

from risc_lab.lab.yaml_reader import load_yaml, package_file
from risc_lab.settings import Name, Positive, Settings, Vector, check_different, settings_from


@dataclass(frozen=True)
class Disc:
    """A landmark: a flat disc with a ring around it, painted on one side. Frame: cortex."""

    name: str
    centre_m: tuple[float, float, float]
    normal: tuple[float, float, float] | None = None  # unit vector out of the painted side; None: faces every camera
    diameter_m: float = 0.20  # of the disc in the middle
    ring_diameter_m: float = 0.30  # outer, of the ring


@dataclass(frozen=True)
class LandmarkKind(Settings):
    """One landmark: a disc with a centre of one paint in a ring of another."""

    name: Name  # motion capture template
    roi_name: Name  # name on /land_rois and /angles
    centre: Name  # paint
    ring: Name  # paint

    def __post_init__(self):
        super().__post_init__()
        if self.centre == self.ring:
            raise ValueError("landmark %s: centre and ring have the same colour, %s" % (self.name, self.ring))


@dataclass(frozen=True)
class DiscSizes(Settings):
    """How large all landmarks are."""

    centre_diameter_m: Positive = 0.20
    ring_diameter_m: Positive = 0.30  # outer

    def __post_init__(self):
        super().__post_init__()
        if self.ring_diameter_m <= self.centre_diameter_m:
            raise ValueError(
                "'ring_diameter_m' (%g) must be larger than 'centre_diameter_m' (%g)"
                % (self.ring_diameter_m, self.centre_diameter_m)
            )


@dataclass(frozen=True)
class LandmarkCatalogue(Settings):
    """Content of landmarks.yaml: all landmarks, and what they have in common."""

    landmarks: tuple[LandmarkKind, ...]
    discs: DiscSizes = DiscSizes()
    markers: dict[str, Vector] = field(default_factory=dict)  # [m] from the middle, cortex axes as mounted

    def __post_init__(self):
        super().__post_init__()
        if not self.landmarks:
            raise ValueError("'landmarks' is empty: list at least one")
        for key in ("name", "roi_name"):
            check_different(self.landmarks, key, "landmarks")

    @property
    def template_of_region(self):
        """Name on /land_rois and /angles -> mocap template."""
        return {kind.roi_name: kind.name for kind in self.landmarks}

    @property
    def region_of_template(self):
        """Mocap template -> name on /land_rois and /angles."""
        return {kind.name: kind.roi_name for kind in self.landmarks}

    def disc(self, name, centre_m, normal=None):
        """Disc of a landmark at a place (cortex frame)."""
        return Disc(name, tuple(centre_m), normal, self.discs.centre_diameter_m, self.discs.ring_diameter_m)


def landmarks_file():
    """Path of the laboratory's landmarks."""
    return package_file("risc_lab", "config/landmarks.yaml")


def load_landmark_catalogue(path=None):
    """LandmarkCatalogue of a landmarks' file, None = the laboratory's. Raises ValueError that names file and key."""
    path = path or landmarks_file()
    return settings_from(LandmarkCatalogue, load_yaml(path), str(path))
