"""Finds other vehicles in pictures by the two paints of their hulls. Needs no ROS."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from risc_lab.lab.yaml_reader import load_yaml, package_file
from risc_lab.settings import Name, Settings, between, settings_from
from risc_visual.vision.colours import HsvRange, Planes, as_bgr, check_paints

_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))


@dataclass(frozen=True)
class Hull(Settings):
    """Paints of one kind of hull."""

    name: Name
    nose: Name
    tail: Name


@dataclass(frozen=True)
class VehicleParams(Settings):
    """Thresholds of the detector."""

    shrink: between(1, 8) = 2  # vehicles are searched in a picture that is this much smaller
    area_min_px: between(1.0, 1e6) = 80.0  # of both paints together, in the whole picture
    gap: between(0.0, 5.0) = 0.4  # pieces of paint belong together that are closer than this x the larger's longer side
    second_min: between(0.0, 0.5) = 0.03  # share of the weaker paint for a hull that shows both
    alone_area_min_px: between(1.0, 1e6) = 300.0  # a hull that shows only one paint is accepted from this area on ...
    alone_aspect: between(0.0, 100.0) = 1.8  # ... and if it is this many times as wide as high


@dataclass(frozen=True)
class VehiclesConfig(Settings):
    """What hulls look like."""

    colours: dict[str, HsvRange]
    hulls: tuple[Hull, ...]
    detector: VehicleParams = VehicleParams()

    def __post_init__(self):
        super().__post_init__()
        if not self.hulls:
            raise ValueError("'hulls' is empty: list at least one")
        pairs = [frozenset((hull.nose, hull.tail)) for hull in self.hulls]
        for hull, pair in zip(self.hulls, pairs):
            check_paints(self.colours, hull, ("nose", "tail"))
            if pairs.count(pair) > 1:
                raise ValueError("hull %s: another hull has the same two colours" % hull.name)


class VehicleDetection(NamedTuple):
    """One vehicle in a picture. Pixels as in landmark_detector.Detection."""

    name: str
    x: float  # [px] middle of the hull's outline
    y: float
    width: float  # [px] of the rotated rectangle around both paints, as OpenCV's minAreaRect
    height: float
    angle: float  # [deg] of the side `width`, clockwise in the picture
    score: float  # 1: both paints are seen; 0.5: one is, and only one vehicle has it
    partial: bool  # cut by the border of the picture


def load_vehicles(path=None):
    """VehiclesConfig of a file, or of risc_visual/config/vehicles.yaml. Raises ValueError naming file and key."""
    path = path or package_file("risc_visual", "config/vehicles.yaml")
    return settings_from(VehiclesConfig, load_yaml(path), str(path))


class _Blob(NamedTuple):
    """A connected piece of one paint, in pixels of the shrunk picture."""

    paint: str
    area: float
    box: tuple[float, float, float, float]  # x0, y0, x1, y1
    outline: np.ndarray  # (n, 2)


class VehicleDetector:
    """Finds the vehicles of a fleet in single pictures."""

    def __init__(self, config, names):
        """config: VehiclesConfig. names: of all vehicles, in the order of their hulls.

        Raises ValueError when there are more vehicles than hulls.
        """
        if len(names) > len(config.hulls):
            raise ValueError(
                "%d vehicles, but only %d hulls to tell them apart: add hulls to vehicles.yaml"
                % (len(names), len(config.hulls))
            )
        self._limits = config.detector
        self.shrink = config.detector.shrink  # how much smaller the picture of `detect_in` must be
        self._hulls = dict(zip(names, config.hulls))
        paints = sorted({paint for hull in self._hulls.values() for paint in (hull.nose, hull.tail)})
        self._ranges = {paint: config.colours[paint] for paint in paints}

    def detect(self, image, observer=None):
        """List of VehicleDetection, each vehicle at most once, the largest first.

        image: (h, w, 3) uint8 BGR. observer: name of the vehicle that carries the camera: it is not in the picture,
        which can decide whose hull it is when only one of two paints is seen. Raises ValueError if it is no picture.
        """
        bgr = as_bgr(image)
        return [] if bgr is None else self.detect_in(Planes(bgr, self.shrink), observer)

    def detect_in(self, planes, observer=None):
        """As `detect`, from the colours.Planes of the shrunk picture, which other detectors may share."""
        blobs = [blob for paint, limits in self._ranges.items() for blob in self._blobs(planes.mask(limits), paint)]
        hulls = {name: hull for name, hull in self._hulls.items() if name != observer}
        found = {}
        # Groups that show both paints are certain; the largest first, so that its pieces go to no other vehicle.
        candidates = [
            (sum(blob.area for blob in group), name, group)
            for name, hull in hulls.items()
            for group in self._groups([blob for blob in blobs if blob.paint in (hull.nose, hull.tail)])
            if self._shows_both(group)
        ]
        used = set()
        for area, name, group in sorted(candidates, key=lambda item: -item[0]):
            if name not in found and not used.intersection(map(id, group)):
                used.update(map(id, group))
                found[name] = self._detection(name, group, area, 1.0, planes.hue.shape)
        rest = [blob for blob in blobs if id(blob) not in used]
        for paint in self._ranges:
            open_ = [name for name, hull in hulls.items() if paint in (hull.nose, hull.tail) and name not in found]
            groups = self._groups([blob for blob in rest if blob.paint == paint])
            if len(open_) == 1 and groups:  # else its owner is unknown
                group = max(groups, key=lambda blobs: sum(blob.area for blob in blobs))
                area = sum(blob.area for blob in group)
                if self._is_hull(group, area):
                    found[open_[0]] = self._detection(open_[0], group, area, 0.5, planes.hue.shape)
        least = self._limits.area_min_px
        return sorted(
            (item for item, area in found.values() if area >= least), key=lambda item: -item.width * item.height
        )

    def _blobs(self, mask, paint):
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, _CROSS)  # without the specks of noise
        contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        blobs = []
        for contour in contours:
            x, y, width, height = cv2.boundingRect(contour)
            if min(width, height) > 1:
                # the outline through the middles of the outermost pixels lacks about half of these
                area = cv2.contourArea(contour) + 0.5 * cv2.arcLength(contour, True)
                blobs.append(_Blob(paint, area, (x, y, x + width, y + height), contour[:, 0]))
        return blobs

    def _groups(self, blobs):
        """Lists of blobs that are close to each other, for their size: the pieces of one hull."""
        groups, left = [], list(blobs)
        while left:
            group = [left.pop()]
            for member in group:  # grows meanwhile
                near = [blob for blob in left if self._close(member.box, blob.box)]
                left = [blob for blob in left if not any(blob is other for other in near)]
                group += near
            groups.append(group)
        return groups

    def _close(self, a, b):
        gap = math.hypot(max(0.0, a[0] - b[2], b[0] - a[2]), max(0.0, a[1] - b[3], b[1] - a[3]))
        size = max(a[2] - a[0], a[3] - a[1], b[2] - b[0], b[3] - b[1])
        return gap <= self._limits.gap * size + 2.0

    def _shows_both(self, group):
        areas = {}
        for blob in group:
            areas[blob.paint] = areas.get(blob.paint, 0.0) + blob.area
        return len(areas) == 2 and min(areas.values()) >= self._limits.second_min * sum(areas.values())

    def _is_hull(self, group, area):
        """Whether pieces of one paint alone are wide, low and level as a hull that is seen from its nose or tail."""
        x0, y0 = min(blob.box[0] for blob in group), min(blob.box[1] for blob in group)
        x1, y1 = max(blob.box[2] for blob in group), max(blob.box[3] for blob in group)
        wide = x1 - x0 >= self._limits.alone_aspect * (y1 - y0)
        return wide and area * self._limits.shrink**2 >= self._limits.alone_area_min_px

    def _detection(self, name, group, area, score, shape):
        """(VehicleDetection, its paint's area [px] in the whole picture)."""
        points = np.concatenate([blob.outline for blob in group])
        (x, y), (width, height), angle = cv2.minAreaRect(points)
        low, high = points.min(axis=0), points.max(axis=0)
        partial = bool((low <= 1).any() or high[0] >= shape[1] - 2 or high[1] >= shape[0] - 2)
        k = self._limits.shrink
        sides = k * (width + 1.0), k * (height + 1.0)  # to the outer sides of the outermost pixels
        x, y = k * (x + 0.5) - 0.5, k * (y + 0.5) - 0.5
        return VehicleDetection(name, x, y, *sides, float(angle), score, partial), area * k * k
