"""Mocap templates: where the markers sit on each object that motion capture identifies by name."""

from dataclasses import dataclass

import numpy as np

from risc_lab.lab import landmark_catalogue
from risc_lab.lab.yaml_reader import Section, load_yaml, package_file

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

    def __eq__(self, other):
        if not isinstance(other, Template):
            return NotImplemented
        mine, others = ((t.name, t.kind, t.marker_names, t.markers_m.tolist()) for t in (self, other))
        return mine == others


def load_templates(path=None, fleet=None):
    """Templates by name, from `path` or from risc_lab/config/templates.yaml. Raises ValueError.

    The landmarks that the file does not have are added from the laboratory's (config/landmarks.yaml). fleet: a Fleet,
    whose own templates are added.
    """
    if path is None:
        path = package_file("risc_lab", "config/templates.yaml")
    known = templates_from_dict(load_yaml(path), str(path))
    return {**known, **{name: item for name, item in _landmarks().items() if name not in known},
            **(fleet.templates if fleet else {})}  # fmt: skip


def attached_bodies(templates):
    """Names of the bodies that hang on vehicles, such as the tip of a pendulum: motion capture sees them, nobody flies
    them.
    """
    return frozenset(name for name, template in templates.items() if template.kind == ATTACHED)


def templates_from_dict(content, where="templates"):
    """Templates by name from the content of their YAML file. Raises ValueError that names the key."""
    root = Section(content, where)
    geometries = root.section("geometries")
    shapes = {name: _geometry(geometries.section(name)) for name in geometries.keys()}
    objects = root.section("templates")
    root.done()
    return {name: _template(name, objects.section(name), shapes, where) for name in objects.keys()}


def templates_to_dict(templates):
    """The plain dict that their YAML file would hold, each with a geometry of its own name."""
    return {
        "geometries": {
            name: dict(zip(template.marker_names, template.markers_m.tolist())) for name, template in templates.items()
        },
        "templates": {name: {"kind": template.kind, "geometry": name} for name, template in templates.items()},
    }


def _landmarks():
    """Templates of the laboratory's landmarks, which share the places of their markers."""
    path = landmark_catalogue.landmarks_file()
    root = Section(load_yaml(path), str(path))
    markers = _geometry(root.section("markers"))
    kinds = landmark_catalogue.catalogue_from_section(root).landmarks
    return {kind.name: Template(kind.name, "landmark", *markers) for kind in kinds}


def _template(name, section, shapes, where):
    kind, geometry = section.text("kind"), section.text("geometry")
    section.done()
    if kind not in KINDS:
        raise ValueError("%s, %s: 'kind' must be one of %s, found %r" % (where, name, ", ".join(KINDS), kind))
    if geometry not in shapes:
        raise ValueError("%s, %s: unknown geometry %r; known are %s" % (where, name, geometry, ", ".join(shapes)))
    marker_names, markers_m = shapes[geometry]
    if kind == VEHICLE:
        _check_rigid(markers_m, "%s, geometry %s" % (where, geometry))
    return Template(name, kind, marker_names, markers_m)


def _geometry(section):
    names = tuple(section.keys())
    if not names:
        raise ValueError("a geometry needs at least one marker")
    markers_m = np.array([section.vector(name, 3) for name in names])
    markers_m.setflags(write=False)
    return names, markers_m


def _check_rigid(markers_m, where):
    """An attitude needs three markers that are not on one line."""
    spread_m = np.linalg.svd(markers_m - markers_m.mean(axis=0), compute_uv=False)
    if len(markers_m) < 3 or spread_m[1] < 0.02:
        raise ValueError("%s: a vehicle needs at least 3 markers well off one line" % where)
