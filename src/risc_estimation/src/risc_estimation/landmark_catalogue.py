"""The landmarks that vision looks for: what they are called where, and how large they are. Needs no ROS."""

from dataclasses import dataclass
from typing import Dict

from risc_control.lab.yaml_reader import Section, load_yaml, package_file
from risc_estimation.sight import Disc


@dataclass(frozen=True)
class LandmarkCatalogue:
    """What every landmark has in common, and their two names."""

    template_of_region: Dict[str, str]  # name on /land_rois and /angles -> mocap template
    disc_diameter_m: float  # of the disc in the middle
    ring_diameter_m: float  # outer, of the ring

    @property
    def region_of_template(self):
        """Mocap template -> name on /land_rois and /angles."""
        return {template: region for region, template in self.template_of_region.items()}

    def disc(self, name, centre_m, normal=None):
        """sight.Disc of a landmark at a place (cortex frame)."""
        return Disc(name, tuple(centre_m), normal, self.disc_diameter_m, self.ring_diameter_m)


def load_landmark_catalogue(path=None):
    """Read the landmarks' file of risc_visual. Raises ValueError that names the file, the key and what is wrong.

    path: None = config/landmarks.yaml of risc_visual. Its keys that concern detection alone are passed over.
    """
    if path is None:
        path = package_file("risc_visual", "config/landmarks.yaml")
    root = Section(load_yaml(path), str(path))
    discs = root.section("discs")
    return LandmarkCatalogue(
        template_of_region={item.text("roi_name"): item.text("name") for item in root.sections("landmarks")},
        disc_diameter_m=discs.number("centre_diameter_m", minimum=1e-3),
        ring_diameter_m=discs.number("ring_diameter_m", minimum=1e-3),
    )
