"""Mocap templates: where the markers sit on each object that motion capture identifies by name."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from risc_lab.lab.landmark_catalogue import load_landmark_catalogue
from risc_lab.lab.yaml_reader import load_yaml, package_file
from risc_lab.settings import Name, Settings, Vector, settings_from

VEHICLE, LANDMARK, ATTACHED = KINDS = ("vehicle", "landmark", "attached")


@dataclass(frozen=True, eq=False)
class Template:
    """Marker geometry of one identified object."""

    name: str
    kind: str  # one of KINDS
    marker_names: tuple[str, ...]
    # (n, 3) marker positions [m] from the object's reference point.
    # vehicle: body axes (x nose, y right, z down); landmark, attached: cortex axes as mounted.
    markers_m: np.ndarray


@dataclass(frozen=True)
class Kind(Settings):
    """What an object is, and the name of its geometry."""

    kind: Literal[KINDS]
    geometry: Name


@dataclass(frozen=True)
class TemplateSet(Settings):
    """Content of templates.yaml, or of the section `templates` of a fleet file."""

    geometries: dict[str, dict[str, Vector]] = field(default_factory=dict)  # {name: {marker: place [m]}}, in order
    templates: dict[str, Kind] = field(default_factory=dict)

    def __post_init__(self):
        super().__post_init__()
        for name, item in self.templates.items():
            if item.geometry not in self.geometries:
                known = ", ".join(self.geometries)
                raise ValueError("%s: unknown geometry %r; known are %s" % (name, item.geometry, known))
            if item.kind == VEHICLE:
                _check_rigid(self.geometries[item.geometry], item.geometry)
        for name, markers in self.geometries.items():
            if not markers:
                raise ValueError("geometry %s needs at least one marker" % name)

    def by_name(self):
        """{name: Template}."""
        kinds = self.templates.items()
        return {name: _template(name, item.kind, self.geometries[item.geometry]) for name, item in kinds}


def load_templates(path=None, fleet=None):
    """Templates by name, from `path` or from risc_lab/config/templates.yaml. Raises ValueError.

    The landmarks that the file does not have are added from the laboratory's (config/landmarks.yaml). fleet: a Fleet,
    whose own templates are added.
    """
    path = path or package_file("risc_lab", "config/templates.yaml")
    catalogue = load_landmark_catalogue()
    landmarks = {kind.name: _template(kind.name, LANDMARK, catalogue.markers) for kind in catalogue.landmarks}
    known = settings_from(TemplateSet, load_yaml(path), str(path)).by_name()
    mine = fleet.templates.by_name() if fleet else {}
    return {**known, **landmarks, **known, **mine}  # the landmarks after the others


def attached_bodies(templates):
    """Names of the bodies that hang on vehicles, such as the tip of a pendulum: motion capture sees them, but they
    are not flown.
    """
    return frozenset(name for name, template in templates.items() if template.kind == ATTACHED)


def _template(name, kind, markers):
    markers_m = np.array(list(markers.values()))
    markers_m.setflags(write=False)
    return Template(name, kind, tuple(markers), markers_m)


def _check_rigid(markers, geometry):
    """An attitude needs three markers that are not on one line."""
    markers_m = np.array(list(markers.values())).reshape(-1, 3)
    if len(markers_m) < 3 or np.linalg.svd(markers_m - markers_m.mean(axis=0), compute_uv=False)[1] < 0.02:
        raise ValueError("geometry %s: a vehicle needs at least 3 markers well off one line" % geometry)
