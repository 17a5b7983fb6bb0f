"""The landmarks: what they are called where, how they are painted, and how large they are. Needs no ROS."""

from dataclasses import dataclass, fields

from risc_lab.lab.ranges import check_different
from risc_lab.lab.yaml_reader import Section, errors_of, load_yaml, package_file


@dataclass(frozen=True)
class Disc:
    """A landmark: a flat disc with a ring around it, painted on one side. Frame: cortex."""

    name: str
    centre_m: tuple[float, float, float]
    normal: tuple[float, float, float] | None = None  # unit vector out of the painted side; None: always faces us
    diameter_m: float = 0.20  # of the disc in the middle
    ring_diameter_m: float = 0.30  # outer, of the ring


@dataclass(frozen=True)
class LandmarkKind:
    """One landmark: a disc with a centre of one paint in a ring of another."""

    name: str  # motion capture template
    roi_name: str  # name on /land_rois and /angles
    centre: str  # paint
    ring: str  # paint


@dataclass(frozen=True)
class LandmarkCatalogue:
    """All landmarks, and what they have in common."""

    landmarks: tuple[LandmarkKind, ...]
    centre_diameter_m: float = 0.20
    ring_diameter_m: float = 0.30  # outer

    def __post_init__(self):
        if not 0.0 < self.centre_diameter_m < self.ring_diameter_m:
            raise ValueError(
                "'ring_diameter_m' (%g) must be larger than 'centre_diameter_m' (%g), and both positive"
                % (self.ring_diameter_m, self.centre_diameter_m)
            )
        if not self.landmarks:
            raise ValueError("'landmarks' is empty: list at least one")
        for key in ("name", "roi_name"):
            check_different(self.landmarks, key, "landmarks")
        for kind in self.landmarks:
            if kind.centre == kind.ring:
                raise ValueError("landmark %s: centre and ring have the same colour, %s" % (kind.name, kind.ring))

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
        return Disc(name, tuple(centre_m), normal, self.centre_diameter_m, self.ring_diameter_m)


def landmarks_file():
    """Path of the laboratory's landmarks."""
    return package_file("risc_lab", "config/landmarks.yaml")


def load_landmark_catalogue(path=None):
    """Read a landmarks' file, None = the laboratory's; its keys that concern others alone are passed over.

    Raises ValueError that names the file, the key and what is wrong.
    """
    path = landmarks_file() if path is None else path
    return catalogue_from_section(Section(load_yaml(path), str(path)))


def catalogue_from_section(root):
    """LandmarkCatalogue of a landmarks' file, of which this reads `landmarks` and `discs`. Raises ValueError."""
    kinds = []
    for section in root.sections("landmarks"):
        kinds.append(LandmarkKind(*[section.text(item.name) for item in fields(LandmarkKind)]))
        section.done()
    discs = root.section("discs", {})
    sizes = {
        key: discs.number(key, getattr(LandmarkCatalogue, key)) for key in ("centre_diameter_m", "ring_diameter_m")
    }
    discs.done()
    with errors_of(root.where):
        return LandmarkCatalogue(tuple(kinds), **sizes)
