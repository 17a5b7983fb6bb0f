"""Finds the laboratory's disc landmarks in pictures (thesis 4.4.5): colour, shape, ring, then a sub-pixel centre.

Thresholds in HSV, contours, the shape test by moments against an ellipse, and the comparison of the perimeter's
colours with the ring's give candidates. Of each, the outlines of centre and ring are measured along rays to a fraction
of a pixel, and from both follows where the centre of the disc is seen: a tilted circle's is not in the middle of the
ellipse (3 px beside it for a disc of 0.20 m that is turned by 45 degrees and 1 m away). Needs no ROS.
"""

import functools
import math
from typing import NamedTuple

import cv2
import numpy as np

from risc_visual.vision.colours import Planes, as_bgr
from risc_visual.vision.ellipses import (
    Ellipse,
    centre_covariance,
    circle_centres,
    direct_ellipse,
    ellipse_of_moments,
    fit_ellipse,
    fit_grown,
    unit_circle,
)

_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
_POINTS_MIN = 5  # corners of a contour; a rectangle has 4
_RING_SEEN = 0.15  # area of a ring's paint around a blob / of the rectangle around the blob; whole ones have 1
_BRIGHTER = 3.0  # the brighter of a landmark's two paints / the darker

# Outlines.
_RAYS = 32  # on which they are measured
_RAYS_MIN = 8  # fewer are not used
_RING_RADII = (0.3, 0.45, 0.6, 0.75)  # of the ring's width, from the centre's outline: where its colour is looked at
_CENTRE_RADII = (0.15, 0.35, 0.55, 0.75)
_BEYOND = (1.1, 1.45, 1.8)  # times the reach from the ring's outer edge: where the background is looked at
_REACH_PX = 2.0  # on both sides of an outline that is known roughly
_CONTRAST_MIN = 6.0  # least distance in BGR of two colours between which an edge is measured
_FOREIGN = 0.7  # distance of a colour from the expected one / contrast of the edge; above it, it is another colour
_WHOLE = 0.9  # share of the rays that meet the outline of a disc whose blob is good enough to start with
_ARC_WHOLE = 0.8  # share of the outline that is measured of a disc that nothing hides
_MISFIT_WHOLE = 0.2  # greatest misfit of a disc that nothing hides; beyond it, errors of the points are correlated
_DOUBT = 4.0  # covariance of a disc that is partly hidden or overexposed / that from its outline alone
_SATURATED = 250.0  # above it the profile of an edge may be clipped
_OUTLIER_PX = 1.0  # points farther from a rough outline are not part of it
_MISFIT_PX = 0.5  # allowed for any outline
_SCALE_TOLERANCE = 0.15  # of the ratio of both outlines
_RING_SIGMA_PX = 0.15  # of the middle of the ring's outline

# For a camera that is not known.
_FOCAL = 0.95  # focal length / width of the picture: 56 degrees from side to side
_SHIFT = 0.5  # deviation of a centre's shift from the one by this focal length / (semi-major axis^2 / focal length)

# Slope of the light: expected standard deviations.
_LIGHT_SLOPE = 0.0008  # [1/px] of its slope across the picture
_LIGHT_NOISE = 0.003  # of one sample at least
_LIGHT_FROM_PX = 12.0  # radius of the discs in which it is looked for: it moves smaller ones by 0.01 px at most


class _Outline(NamedTuple):
    """The measured outline of a centre."""

    ellipse: Ellipse
    points: np.ndarray  # (n, 2) [px] on it
    start: Ellipse  # on whose rays they were measured
    directions: np.ndarray  # (n, 2) of these, on the unit circle
    rms_px: float  # distance of the points
    arc: float  # share of it that was found
    misfit: float  # rms distance of the points / what is allowed


class Detection(NamedTuple):
    """One landmark in a picture. Pixels: x right, y down, (0, 0) is the middle of the top left pixel."""

    name: str  # the landmark's ROI name
    x: float  # [px] where the centre of the disc is seen
    y: float
    width: float  # [px] sides of the rotated rectangle around the centre paint, as OpenCV's minAreaRect
    height: float
    angle: float  # [deg] of the side `width`, clockwise in the picture, 0 < angle <= 90
    score: float  # 0..1: how much of the perimeter has the ring's colour, how well the outline is an ellipse
    partial: bool  # cut by the border of the picture, or hidden in part
    outline: Ellipse  # [px] of the centre paint; its middle is not (x, y) for a disc that is seen obliquely
    covariance: tuple[float, float, float] | None  # [px^2] of (x, y): xx, xy, yy; None: not known without a camera


class LandmarkDetector:
    """Finds landmarks in single pictures; keeps no state between them."""

    def __init__(self, config, camera=None):
        """config: LandmarksConfig. camera: risc_lab.camera.Camera that takes the pictures, None if not known.

        With a camera, outlines are undistorted before they are measured, and its focal length tells how far the
        disc's centre is from the middle of its outline; without, the ring and a usual focal length do.
        """
        self._config = config
        self._limits = config.detector
        self.shrink = config.detector.shrink  # how much smaller than the picture its colours.Planes must be
        self._camera = camera
        self._distorted = camera is not None and bool(np.any(camera.D))
        self._scale = config.ring_scale
        self._circle = unit_circle(_RAYS).astype(np.float32)
        # Points (rays, radii, 2) of a disc with radius 1: on the ring, and of the centre.
        self._ring = _on_rays(self._circle, 1.0 + (self._scale - 1.0) * np.array(_RING_RADII))
        self._core = _on_rays(self._circle[::2], np.array(_CENTRE_RADII))

    def detect(self, image, planes=None):
        """List of Detection, the best first; the same landmark can be among them more than once.

        image: (h, w, 3) uint8 BGR; a grey one (h, w) has no colours and hence no landmarks. planes: colours.Planes of
        the shrunk picture, if already computed. Raises ValueError for anything but a picture.
        """
        bgr = as_bgr(image)
        if bgr is None:
            return []
        planes = planes or Planes(bgr, self.shrink)
        kinds, colours = self._config.landmarks, self._config.colours
        masks = {paint: planes.mask(colours[paint]) for kind in kinds for paint in (kind.centre, kind.ring)}
        found = [
            self._examine(bgr, masks, kind, start)
            for kind in kinds
            for start in self._blobs(masks[kind.centre], masks[kind.ring])
        ]
        return sorted(filter(None, found), key=lambda detection: -detection.score)

    def _blobs(self, mask, ring):
        """Ellipses of the blobs of a mask that may be discs, in pixels of the whole picture; ring: mask of its ring."""
        limits = self._limits
        # Noise makes a blob smaller, but not the outline that is measured later: hence 0.6.
        area_min = 0.6 * 0.25 * math.pi * (limits.diameter_min_px / limits.shrink) ** 2
        height, width = mask.shape
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, _CROSS)  # without the specks of noise
        # Outlines of all components, and of their holes (these have a parent): a landmark may be in front of a wall
        # that has its centre's colour.
        contours, hierarchy = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
        for k, contour in enumerate(contours):
            if len(contour) < _POINTS_MIN or hierarchy[0, k, 3] >= 0:
                continue
            x, y, w, h = cv2.boundingRect(contour)
            around = ring[max(0, y - h // 3) : y + h + h // 3, max(0, x - w // 3) : x + w + w // 3]
            if cv2.countNonZero(around) < _RING_SEEN * w * h:
                continue
            moments = cv2.moments(contour)
            if moments["m00"] < 0.4 * area_min:  # of the polygon through the middles of the outermost pixels
                continue
            ellipse = ellipse_of_moments(moments)
            if ellipse is None:
                continue
            if x <= 1 or y <= 1 or x + w >= width - 1 or y + h >= height - 1:
                ellipse = _ellipse_of_cut(contour[:, 0], width, height) or ellipse
            elif moments["m00"] < limits.fill_min * ellipse.area:
                continue
            # to the outer sides of those pixels
            x, y, semi_major, semi_minor, angle_rad = ellipse
            ellipse = Ellipse(x, y, semi_major + 0.5, semi_minor + 0.5, angle_rad)
            if ellipse.semi_minor >= limits.aspect_min * ellipse.semi_major and ellipse.area >= area_min:
                k = limits.shrink
                yield ellipse.grown(k)._replace(x=k * (x + 0.5) - 0.5, y=k * (y + 0.5) - 0.5)

    def _examine(self, bgr, masks, kind, start):
        """Detection of a blob of the right colour if it is this landmark, else None."""
        limits = self._limits
        around, ringed, share, _ = self._ringed(masks[kind.ring], start, bgr.shape)
        if share < 0.6 * limits.ring_min:
            return None
        within = start.at(self._core)
        filled = self._painted(masks[kind.centre], within)
        colours = _sample(bgr, around), _sample(bgr, within)
        ring, core = (cv2.mean(bgr, mask)[:3] for bgr, mask in zip(colours, (ringed, filled)))
        vivid = _vividness(core, ring)
        if vivid < limits.vivid_min:
            return None
        saturated = max(core + ring) > _SATURATED
        ring, core = np.array(ring, np.float32), np.array(core, np.float32)
        light = np.ones((_RAYS, 1), np.float32)
        if start.semi_minor > _LIGHT_FROM_PX:
            light = self._light(colours, (ring, core), (ringed, filled), start.semi_minor)
        inner = self._centre_outline(bgr, start, light * core, light * ring)
        if inner is None or inner.arc < limits.arc_min or inner.misfit > 1.0:
            return None
        ellipse = inner.ellipse
        if ellipse.semi_minor < max(0.5 * limits.diameter_min_px, limits.aspect_min * ellipse.semi_major):
            return None
        _, _, share, count = self._ringed(masks[kind.ring], ellipse, bgr.shape)
        if share < limits.ring_min:
            return None
        filled = self._painted(masks[kind.centre], ellipse.at(self._core))
        if cv2.mean(filled)[0] < 255.0 * limits.centre_min * count / _RAYS:
            return None
        circle = ellipse  # as a camera without distortion would see it
        if self._distorted:
            circle = fit_ellipse(self._ideal(inner.points))[0] or ellipse
        outer, bounded = self._ring_outline(bgr, ellipse, circle, ring)
        if bounded < limits.bounded_min:
            return None
        # Without the outline of the ring the rest must be certain, and the picture's border the reason.
        if outer is None:
            sure = inner.misfit <= 0.5 and vivid >= 0.5 * (1.0 + limits.vivid_min)
            if count == _RAYS or not sure or ellipse.semi_minor < limits.diameter_min_px:
                return None
        (x, y), covariance = self._centre(bgr.shape, inner, circle, outer)
        if not math.isfinite(x + y):  # outside of what the lens model describes
            (x, y), covariance = ellipse[:2], None
        score = share * inner.arc * (1.0 - 0.5 * inner.misfit) * (1.0 if outer is not None else 0.8)
        partial = count < _RAYS or inner.arc < _ARC_WHOLE or inner.misfit > _MISFIT_WHOLE
        if covariance is not None and (partial or saturated):
            doubt = _DOUBT * max(1.0, inner.misfit / _MISFIT_WHOLE) ** 4
            covariance = tuple(doubt * value for value in covariance)
        return Detection(kind.roi_name, x, y, *ellipse.rectangle(), score, partial, ellipse, covariance)

    def _ringed(self, mask, ellipse, shape):
        """Points (rays, radii, 2) around an ellipse, which of them are painted, share of such rays, and of how many.

        The share is that of the rays that end in the picture, 0 when these are too few.
        """
        points = ellipse.at(self._ring)
        painted = self._painted(mask, points)
        inside = _inside(points[:, -1], shape)
        count = np.count_nonzero(inside)
        hits = np.count_nonzero(painted.any(axis=1) & inside)
        return points, painted, hits / count if count >= _RAYS_MIN else 0.0, count

    def _painted(self, mask, points):
        """A mask of the shrunk picture at points (n, m, 2) float32 of the whole one: (n, m), 0 outside."""
        shrink = self._limits.shrink
        points = points * np.float32(1.0 / shrink) + np.float32(0.5 / shrink - 0.5)
        return cv2.remap(mask, points, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)

    def _light(self, colours, means, painted, size_px):
        """(rays, 1) light on a disc at each ray / average light.

        Without it, a brighter half of a disc would look larger. colours, means, painted: of ring and centre: colours
        of their points, mean ones (3,), masks of the points that have them. A disc of a few pixels tells little of the
        light, and neighbours' colours blur into it: uniform light is the prior. Another object of a paint's hue, such
        as a panel in front of the ring, scatters that paint's samples, which then have less weight.
        """
        square, along = np.eye(2) / (_LIGHT_SLOPE * size_px) ** 2, np.zeros(2)
        for places, bgr, mean, mask in zip((self._ring, self._core), colours, means, painted):
            places, seen = places[mask != 0], bgr[mask != 0] @ (mean / (mean @ mean)) - 1.0
            weighted = (places - places.mean(axis=0)) / max(_LIGHT_NOISE**2, seen @ seen / len(seen))
            square += weighted.T @ places
            along += weighted.T @ seen
        return 1.0 + self._circle @ np.linalg.solve(square, along).astype(np.float32)[:, None]

    def _centre_outline(self, bgr, start, core, ring):
        """_Outline of the centre near the ellipse `start`; None if there is none. core, ring: (rays, 3) colours."""
        band = self._scale - 1.0
        points, good = self._edge(bgr, start, min(0.5 * band, max(_REACH_PX / start.semi_minor, 0.15)), core, ring)
        if np.count_nonzero(good) < _WHOLE * _RAYS:  # a part is hidden: the blob is not quite where the disc is
            points, good = self._edge(bgr, start, 0.6 * band, core, ring)
            rough, _ = fit_ellipse(points[good], _OUTLIER_PX, 2.0)
            if rough is None or not 0.5 < rough.area / start.area < 2.0 or rough.semi_minor < 1.0:
                return None
            start = rough
            points, good = self._edge(bgr, start, min(0.5 * band, max(_REACH_PX / start.semi_minor, 0.15)), core, ring)
        ellipse, off_px = fit_ellipse(points[good]) if np.count_nonzero(good) >= _RAYS_MIN else (None, None)
        if ellipse is None or ellipse.semi_minor < 1.0:
            return None
        return _Outline(ellipse, points[good], start, self._circle[good], *self._judged(ellipse, off_px))

    def _ring_outline(self, bgr, inner, circle, ring):
        """(ideal Ellipse of the ring, None where background or neighbours hide it; share of rays with a contrast).

        inner: Ellipse of the centre as it is seen, circle: as a camera without distortion would see it.
        """
        start, reach = inner.grown(self._scale), 0.5 * (self._scale - 1.0) / self._scale
        beyond = start.at(_on_rays(self._circle, 1.0 + reach * np.array(_BEYOND)))
        background = _sample(bgr, beyond).mean(axis=1, dtype=np.float32)
        points, good = self._edge(bgr, start, reach, ring[None], background)
        contrast = np.square(ring - background).sum(axis=1)[_inside(beyond[:, -1], bgr.shape)] > _CONTRAST_MIN**2
        bounded = np.count_nonzero(contrast) / len(contrast) if len(contrast) >= _RAYS_MIN else 1.0
        points = self._ideal(points[good])
        ellipse, off_px = fit_grown(points, circle, self._scale)
        if ellipse is None or abs(ellipse.semi_minor / (circle.semi_minor * self._scale) - 1.0) > _SCALE_TOLERANCE:
            return None, bounded
        _, arc, misfit = self._judged(ellipse, off_px)
        return (None if arc < 0.5 or misfit > 1.0 else ellipse), bounded

    def _judged(self, ellipse, off_px):
        """(rms_px, arc, misfit), as an _Outline has them, of a fit."""
        allowed = self._limits.misfit_max * math.sqrt(ellipse.semi_major * ellipse.semi_minor) + _MISFIT_PX
        near = off_px[np.abs(off_px) <= max(0.5, 2.0 * allowed)]
        rms_px = math.sqrt(float(near @ near) / len(near)) if len(near) else math.inf
        return rms_px, len(near) / _RAYS, rms_px / allowed

    def _edge(self, bgr, ellipse, reach, inside, outside):
        """Where the colour changes from `inside` to `outside` between 1 - reach and 1 + reach times the ellipse.

        inside, outside: (rays, 3) float32 BGR. Returns points (rays, 2) and whether they are good (rays,).
        """
        count = int(min(24, max(8, 1.6 * reach * (ellipse.semi_major + ellipse.semi_minor))))
        steps, averages, ends = _profile(count)
        directions, middle = self._circle @ ellipse.axes().T.astype(np.float32), np.float32((ellipse.x, ellipse.y))
        colours = _sample(bgr, _on_rays(directions, 1.0 + reach * steps) + middle).astype(np.float32)
        contrast = inside - outside
        square = (contrast * contrast).sum(axis=1)
        weights = contrast / np.maximum(square, np.float32(1.0))[:, None]
        share = np.matmul(colours, weights[:, :, None])[:, :, 0] - (outside * weights).sum(axis=1)[:, None]
        first, last, whole = (np.minimum(np.maximum(share, 0.0), 1.0) @ averages).T
        # Beyond the edge must be what is expected there, not a third colour.
        foreign = colours[:, -ends:].sum(axis=1) / np.float32(ends) - outside
        good = (first > 0.55) & (last < 0.45) & ((foreign * foreign).sum(axis=1) < _FOREIGN**2 * square)
        # The area under the profile says where the step is; noise and blur do not move it.
        points = directions * (1.0 - reach + 2.0 * reach * whole.astype(float))[:, None] + (ellipse.x, ellipse.y)
        good &= (square > _CONTRAST_MIN**2) & _inside(points + 0.5 * reach * directions, bgr.shape)
        return points, good

    def _centre(self, shape, inner, circle, ring):
        """((x, y) [px] where the centre of the disc is seen, its covariance as Detection's).

        NaN outside of what the lens model describes. shape: of the picture; inner: _Outline of the centre; circle,
        ring: Ellipses of centre and ring, without distortion; ring may be None.
        """
        if self._camera is None:
            focal_px = _FOCAL * shape[1]
            K = np.array(((focal_px, 0.0, 0.5 * shape[1]), (0.0, focal_px, 0.5 * shape[0]), (0.0, 0.0, 1.0)))
        else:
            K, focal_px = self._camera.K, math.sqrt(self._camera.K[0, 0] * self._camera.K[1, 1])
        found = circle_centres(K.T @ circle.conic() @ K, self._scale)
        centres, rings = (places @ K[:2, :2].T + K[:2, 2] for places in found)
        share = 0.5  # probability of the first
        if ring is not None:
            off = np.square(rings - ring[:2]).sum(axis=1)
            share = 1.0 / (1.0 + math.exp(min(0.5 * (off[0] - off[1]) / _RING_SIGMA_PX**2, 700.0)))
        centre = share * centres[0] + (1.0 - share) * centres[1]
        if self._camera is None:
            if ring is None:
                return circle[:2], None
            # Shifts by perspective and by distortion grow with the square of a circle's size.
            middle, spread_px = np.array(circle[:2]), _SHIFT * circle.semi_major**2 / focal_px
            told = middle + (middle - ring[:2]) / (self._scale**2 - 1.0)
            centre += (told - centre) / (1.0 + (_RING_SIGMA_PX / spread_px) ** 2)
            return centre.tolist(), None
        turn = None  # from pixels without distortion to those of the picture
        if self._distorted:
            right, down = np.linalg.solve(K[:2, :2], (centre + ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)) - K[:2, 2]).T)
            pixels = self._camera.project(np.column_stack((np.ones(3), right, down)))
            centre, turn = pixels[0], (pixels[1:] - pixels[0]).T
        measured = inner.start, inner.directions, inner.rms_px
        return centre.tolist(), centre_covariance(*measured, focal_px, centres[0] - centres[1], share, turn)

    def _ideal(self, points):
        """Points (n, 2) [px] as a camera without distortion would see them."""
        if not self._distorted or not len(points):
            return points
        K = self._camera.K
        return self._camera.undistort(points) @ K[:2, :2].T + K[:2, 2]


def _vividness(core, ring):
    """Saturation of the ring's colour / that of the centre's, which light does not change; 0 if one is far darker.

    core, ring: three numbers, BGR.
    """
    bright, dark = (max(core), max(ring)), (min(core), min(ring))
    if bright[0] <= dark[0] or max(bright) > _BRIGHTER * max(1.0, min(bright)):
        return 0.0
    return (bright[1] - dark[1]) * bright[0] / (bright[1] * (bright[0] - dark[0]))


def _ellipse_of_cut(points, width, height):
    """Ellipse through the contour (n, 2) of a blob that the border of the picture cuts; None if there is none."""
    x, y = points.T
    points = points[(x > 1) & (y > 1) & (x < width - 2) & (y < height - 2)]
    if len(points) < _RAYS_MIN:
        return None
    ellipse = direct_ellipse(points[:: 1 + len(points) // 64].astype(np.float32))
    return ellipse if ellipse is not None and ellipse.semi_major < width + height else None


def _on_rays(circle, radii):
    """(rays, radii, 2) points at these radii."""
    return circle[:, None, :] * radii.astype(np.float32)[:, None]


@functools.lru_cache(maxsize=64)
def _profile(count):
    """Profiles of `count` samples across an edge: (places (count,) in -1..1, averages (count, 3), ends).

    A profile @ averages is the mean of its first, its last `ends`, and of all samples.
    """
    ends = max(1, count // 8)
    averages = np.zeros((count, 3), np.float32)
    averages[:ends, 0] = averages[-ends:, 1] = 1.0 / ends
    averages[:, 2] = 1.0 / count
    return (2.0 * np.arange(count) + (1.0 - count)) / count, averages, ends


def _inside(points, shape):
    """Whether points (n, 2) are in a picture of this shape."""
    x, y = points.T
    return (x > 0.0) & (y > 0.0) & (x < shape[1] - 1.0) & (y < shape[0] - 1.0)


def _sample(bgr, points):
    """The picture at points (n, m, 2) float32, interpolated: (n, m, 3); black outside."""
    return cv2.remap(bgr, points, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
