"""What a calibrated camera on a vehicle should see: the reverse direction of thesis 4.4.4. Needs no ROS.

Objects are discs (landmarks) and hulls (vehicles), given in the cortex frame; what comes out is in pixels and angles of
the camera.
"""

import functools
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from risc_lab.camera import bearings_of_rays, cortex_to_camera
from risc_lab.lab.calibration import FRONT_MOUNT, CameraMount
from risc_lab.lab.landmark_catalogue import Disc

_OUTLINE_POINTS = 48
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, _OUTLINE_POINTS, endpoint=False)
LANDMARK, VEHICLE = "landmark", "vehicle"


@dataclass(frozen=True)
class Hull:
    """A vehicle as another one sees it: a flat box with round corners in body axes. Frame of the pose: cortex."""

    name: str
    position_m: tuple[float, float, float]
    R_body_to_cortex: np.ndarray  # (3, 3)
    size_m: tuple[float, float, float] = (0.50, 0.50, 0.07)  # along body x, y, z; AR.Drone with its indoor hull
    corner_m: float = 0.115  # radius of its corners: that of the rotors' shrouds


@dataclass(frozen=True)
class Observer:
    """A camera and where it sits on its vehicle."""

    camera: object  # risc_lab.camera.Camera, or bearings.RectifiedCamera for rectified pictures
    mount: CameraMount = FRONT_MOUNT


class Sighting(NamedTuple):
    """Expected view of one object in one picture."""

    name: str
    kind: str  # LANDMARK or VEHICLE
    azimuth_rad: float  # of the centre, + right
    elevation_rad: float  # of the centre, + up
    distance_m: float
    centre_px: np.ndarray  # (2,) image of the centre; NaN where the camera cannot see
    outline_px: np.ndarray  # (k, 2) convex outline, cut at the border of the picture; k = 0: not in it
    fraction: float  # of the outline that is in the picture; 0 for the back of a disc and what is hidden
    diameter_px: float  # least diameter of the disc in the middle, or of the hull
    obliqueness_rad: float  # between the disc's normal and the line of sight; 0 for a hull

    @property
    def box_px(self):
        """(x0, y0, x1, y1) around the outline."""
        return (*self.outline_px.min(axis=0), *self.outline_px.max(axis=0))


def bearings_of_points(points_cortex, positions_m, R_body_to_cortex, mount):
    """(azimuth, elevation) [rad], each (...), of points (..., 3) [m] as seen by a camera; see `cortex_to_camera`."""
    return bearings_of_rays(cortex_to_camera(points_cortex, positions_m, R_body_to_cortex, mount))


def look(observer, position_m, R_body_to_cortex, targets):
    """List of Sighting, one per target, in their order; also of those that are not in the picture (fraction 0).

    position_m (3,), R_body_to_cortex (3, 3): the observing vehicle's pose. targets: Discs and Hulls, its own hull not
    among them. Nearer targets hide farther ones.
    """
    if not targets:
        return []
    mount = observer.mount
    position_m = np.asarray(position_m, dtype=float)
    eye_m = position_m + R_body_to_cortex @ np.asarray(mount.position_m)
    shapes = [_disc_shape(item, eye_m) if isinstance(item, Disc) else _hull_shape(item) for item in targets]
    points = cortex_to_camera(np.concatenate([shape.points_m for shape in shapes]), position_m, R_body_to_cortex, mount)
    ends = np.cumsum([len(shape.points_m) for shape in shapes])[:-1]
    pixels = np.split(observer.camera.project(points), ends)
    raw = getattr(observer.camera, "raw", None)  # a rectified picture shows nothing that the raw one does not hold
    raw_pixels = pixels if raw is None else np.split(raw.project(points), ends)
    sightings = []
    for item, shape, ours, theirs, place in zip(targets, shapes, pixels, raw_pixels, np.split(points, ends)):
        cut, fraction = _cut(ours[shape.outline], observer.camera)
        if raw is not None and fraction > 0.0:
            fraction = min(fraction, _cut(theirs[shape.outline], raw)[1])
        azimuth, elevation = bearings_of_rays(place[0])
        sightings.append(
            Sighting(
                name=item.name,
                kind=LANDMARK if isinstance(item, Disc) else VEHICLE,
                azimuth_rad=float(azimuth),
                elevation_rad=float(elevation),
                distance_m=float(np.linalg.norm(place[0])),
                centre_px=ours[0],
                outline_px=cut,
                fraction=fraction,
                diameter_px=_least_diameter(ours[shape.core]),
                obliqueness_rad=shape.obliqueness_rad,
            )
        )
    return [
        item._replace(fraction=_not_hidden(item, sightings) if shape.obliqueness_rad < 0.5 * np.pi else 0.0)
        for item, shape in zip(sightings, shapes)
    ]


class _Shape(NamedTuple):
    points_m: np.ndarray  # (n, 3) first the centre
    outline: slice  # which of them are the outline
    core: slice  # those that the least diameter is taken from: the disc in the middle, or the hull
    obliqueness_rad: float


def _disc_shape(disc, eye_m):
    centre = np.array(disc.centre_m, dtype=float)
    towards = eye_m - centre
    towards /= max(np.linalg.norm(towards), 1e-9)
    normal = tuple(towards) if disc.normal is None else disc.normal
    circle = _circle_across(normal) if disc.normal is None else _known_circle_across(normal)
    outline_m, core_m = centre + 0.5 * disc.ring_diameter_m * circle, centre + 0.5 * disc.diameter_m * circle
    ring, core = slice(1, 1 + len(circle)), slice(1 + len(circle), None)
    obliqueness_rad = float(np.arccos(np.clip(towards @ normal, -1.0, 1.0)))
    return _Shape(np.vstack((centre, outline_m, core_m)), ring, core, obliqueness_rad)


def _circle_across(normal):
    """Circle (n, 3) of radius 1 around the origin, in the plane with this normal."""
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    return np.outer(np.cos(_CIRCLE), first) + np.outer(np.sin(_CIRCLE), np.cross(normal, first))


_known_circle_across = functools.lru_cache(maxsize=256)(_circle_across)


def _hull_shape(hull):
    centre = np.array(hull.position_m, dtype=float)
    outline_m = centre + _hull_outline(tuple(hull.size_m), hull.corner_m) @ np.asarray(hull.R_body_to_cortex).T
    return _Shape(np.vstack((centre, outline_m)), slice(1, None), slice(1, None), 0.0)


@functools.lru_cache(maxsize=16)
def _hull_outline(size_m, corner_m):
    """Upper and lower edge (2 n, 3) of a hull in body axes."""
    length, width, height = size_m
    circle = np.column_stack((np.cos(_CIRCLE), np.sin(_CIRCLE)))
    ring = np.sign(np.round(circle, 9)) * (0.5 * length - corner_m, 0.5 * width - corner_m) + corner_m * circle
    return np.vstack([np.column_stack((ring, np.full(len(ring), side * height))) for side in (-0.5, 0.5)])


def _not_hidden(item, sightings):
    """The fraction of an item's outline that is left when nearer things are in front of it."""
    if item.fraction == 0.0:
        return 0.0
    outline = item.outline_px.astype(np.float32)
    area = cv2.contourArea(outline)
    covered = 0.0
    for other in sightings:
        if other is not item and other.distance_m < item.distance_m and len(other.outline_px):
            covered += max(0.0, cv2.intersectConvexConvex(outline, other.outline_px.astype(np.float32))[0])
    return item.fraction * max(0.0, 1.0 - covered / area) if area > 0.0 else 0.0


def _cut(outline_px, camera):
    """(convex outline (k, 2) inside the picture, the fraction [0, 1] of its area that this is)."""
    finite = np.isfinite(outline_px).all(axis=1)
    nothing = np.zeros((0, 2))
    if finite.sum() < 3:
        return nothing, 0.0
    hull = cv2.convexHull(outline_px[finite].astype(np.float32))
    area = cv2.contourArea(hull)
    if area <= 0.0:
        return nothing, 0.0
    if bool(camera.in_picture(outline_px).all()):
        return hull[:, 0].astype(float), 1.0
    right, bottom = camera.width_px - 0.5, camera.height_px - 0.5
    picture = np.array([(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)], dtype=np.float32)
    inside, cut = cv2.intersectConvexConvex(hull, picture)
    if inside <= 0.0 or cut is None:
        return nothing, 0.0
    # points behind the camera have no pixels: of an outline that is partly there, the rest counts
    return cut[:, 0].astype(float), float(min(1.0, inside / area) * finite.mean())


def _least_diameter(outline_px):
    finite = outline_px[np.isfinite(outline_px).all(axis=1)]
    if len(finite) < 3:
        return 0.0
    return float(min(cv2.minAreaRect(finite.astype(np.float32))[1]))
