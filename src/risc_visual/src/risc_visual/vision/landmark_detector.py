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

from risc_visual.vision.colours import Planes, as_bgr, shrunk
from risc_visual.vision.ellipses import (
    Ellipse,
    centre_covariance,
    circle_centres,
    direct_ellipse,
    distances,
    ellipse_of_moments,
    fit_ellipse,
    fit_grown,
    harmonics,
    unit_circle,
)

_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
_POINTS_MIN = 5  # corners of a contour; a rectangle has 4
_FEW = 3  # blobs that are examined without a quick look at them all
_BRIGHTER = 3.0  # the brighter of a landmark's two paints / the darker

# Outlines.
_RAYS = 32  # on which they are measured
_RAYS_MIN = 8  # with which something can be said
_BEYOND = (1.1, 1.45, 1.8)  # times the reach from the ring's outer edge: where the background is looked at
_REACH_PX = 2.0  # on both sides of an outline that is known roughly
_CONTRAST_MIN = 6.0  # least distance in BGR of two colours between which an edge is measured
_FOREIGN = 0.7  # distance of a colour from the expected one / contrast of the edge, from which it is another
_WHOLE = 0.9  # share of the rays that meet the outline of a disc whose blob is good enough to start with
_ARC_WHOLE = 0.8  # share of the outline that is measured of a disc that nothing hides
_MISFIT_WHOLE = 0.2  # greatest misfit of a disc that nothing hides; beyond it, errors of the points go together
_DOUBT = 4.0  # covariance of what is hidden in part, or overexposed / what its outline alone would say
_SATURATED = 250.0  # from which on the profile of an edge may be cut off at the top
_OUTLIER_PX = 1.0  # what is farther from a rough outline is none of it
_MISFIT_PX = 0.5  # that any outline may have
_SCALE_TOLERANCE = 0.15  # of the ratio of both outlines

# Slope of the light: deviations that are expected.
_LIGHT_SLOPE = 0.0008  # [1/px] of its slope across the picture
_LIGHT_NOISE = 0.03  # of one sample
_LIGHT_FROM_PX = 12.0  # radius of the discs in which it is looked for: it moves smaller ones by 0.01 px at most

# Where the centre of a disc is seen.
_SIGMA_PX = 0.15  # of the middle of a measured outline
_NOMINAL_FOCAL = 0.95  # focal length / width of the picture of a camera that is not known: 56 degrees from side to side
_LONGER, _ASIDE = 0.5, 0.35  # deviation of the shift of a ring from the expected one, for a camera that is not known
_DISTORTED = 0.3  # deviation of the shift by distortion / (size^2 / width of the picture)


class _Outline(NamedTuple):
    """A measured outline."""

    ellipse: Ellipse
    points: np.ndarray  # (n, 2) [px] on it
    rms_px: float  # distance of the points
    arc: float  # share of it that was found
    misfit: float  # rms distance of the points / what is allowed
    start: Ellipse | None = None  # on whose rays the points were measured,
    rays: np.ndarray | None = None  # (rays,) and on which of them


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
    """Finds landmarks in single pictures; remembers nothing from one to the next."""

    def __init__(self, config, camera=None):
        """config: LandmarksConfig. camera: risc_lab.camera.Camera that takes the pictures, None if not known.

        With a camera, outlines are undistorted before they are measured, and its focal length tells how far the
        disc's centre is from the middle of its outline; without, only the ring does.
        """
        self._config = config
        self._limits = config.detector
        self._camera = camera
        self._distorted = camera is not None and bool(np.any(camera.D))
        self._scale = config.ring_scale
        self._circle = unit_circle(_RAYS).astype(np.float32)
        band = self._scale - 1.0
        # Points (rays, radii, 2) of a disc with radius 1: on the ring, then of the centre.
        self._ring = _on_rays(self._circle, 1.0 + band * np.array([0.3, 0.45, 0.6, 0.75]))
        centre = _on_rays(self._circle[::2], np.array([0.15, 0.35, 0.55, 0.75]))
        self._disc = np.concatenate((self._ring, centre))
        self._rows = np.column_stack((self._disc.reshape(-1, 2), np.ones(self._disc[..., 0].size, np.float32)))
        self._harmonics = harmonics(self._circle)
        self._by_centre = {}
        for kind in config.landmarks:
            self._by_centre.setdefault(kind.centre, []).append(kind)

    @property
    def shrink(self):
        """How much smaller than the picture its colours.Planes must be."""
        return self._limits.shrink

    def detect(self, image, planes=None):
        """List of Detection, the best first; the same landmark can be among them more than once.

        image: (h, w, 3) uint8 BGR; a grey one (h, w) has no colours and hence no landmarks. planes: colours.Planes of
        the shrunk picture, when somebody else needed them, too. Raises ValueError for what is no picture.
        """
        bgr = as_bgr(image)
        if bgr is None:
            return []
        if planes is None:
            planes = Planes(shrunk(bgr, self._limits.shrink))
        masks = {}
        found = []
        for paint, kinds in self._by_centre.items():
            for name in [paint] + [kind.ring for kind in kinds]:
                if name not in masks:
                    masks[name] = planes.mask(self._config.colours[name])
            blobs = list(self._blobs(masks[paint]))
            for kind in kinds:
                for start in self._ringed(blobs, masks[kind.ring]):
                    detection = self._examine(bgr, masks, kind, start)
                    if detection is not None:
                        found.append(detection)
        return sorted(found, key=lambda detection: -detection.score)

    def _blobs(self, mask):
        """Ellipses of the blobs of a mask that may be discs, in pixels of the whole picture."""
        limits = self._limits
        # What noise eats of a blob, the measured outline will not lack.
        area_min = 0.6 * 0.25 * math.pi * (limits.diameter_min_px / limits.shrink) ** 2
        height, width = mask.shape
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, _CROSS)  # without the specks of noise
        # Outlines of all components, and of their holes (these have a parent): a landmark may be in front of a wall
        # that has its centre's colour.
        contours, hierarchy = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
        for k, contour in enumerate(contours):
            if len(contour) < _POINTS_MIN or hierarchy[0, k, 3] >= 0:
                continue
            moments = cv2.moments(contour)
            if moments["m00"] < 0.4 * area_min:  # of the polygon through the middles of the outermost pixels
                continue
            ellipse = ellipse_of_moments(moments)
            if ellipse is None:
                continue
            x, y, w, h = cv2.boundingRect(contour)
            if x <= 1 or y <= 1 or x + w >= width - 1 or y + h >= height - 1:
                ellipse = _ellipse_of_cut(contour[:, 0], width, height) or ellipse
            elif moments["m00"] < limits.fill_min * ellipse.area:
                continue
            # to the outer sides of those pixels
            ellipse = ellipse._replace(semi_major=ellipse.semi_major + 0.5, semi_minor=ellipse.semi_minor + 0.5)
            if ellipse.semi_minor >= limits.aspect_min * ellipse.semi_major and ellipse.area >= area_min:
                yield _enlarged(ellipse, limits.shrink)

    def _ringed(self, ellipses, mask):
        """Those around which there may be a ring, from a quick look at all of them; mask: of the ring's colour."""
        if len(ellipses) <= _FEW:
            return ellipses
        axes = np.array([ellipse.axes() for ellipse in ellipses])
        middles = np.array([ellipse[:2] for ellipse in ellipses])
        pattern = self._ring[::3]
        points = np.matmul(pattern.reshape(-1, 2), axes.transpose(0, 2, 1)) + middles[:, None]
        painted = _sample_mask(mask, points.astype(np.float32), self._limits.shrink)
        hits = painted.reshape(len(ellipses), *pattern.shape[:2]).any(axis=2).sum(axis=1)
        return [
            ellipse for ellipse, count in zip(ellipses, hits) if count >= 0.3 * self._limits.ring_min * len(pattern)
        ]

    def _examine(self, bgr, masks, kind, start):
        """Detection of a blob of the right colour if it is this landmark, else None."""
        limits = self._limits
        points = _at(start, self._disc)
        around = points[:_RAYS]
        painted = _sample_mask(masks[kind.ring], around, limits.shrink)
        if self._share(painted, around, start, bgr.shape)[0] < 0.6 * limits.ring_min:
            return None
        colours = _sample(bgr, points)
        core, ring = cv2.mean(colours[_RAYS:])[:3], cv2.mean(colours[:_RAYS], painted)[:3]
        vivid = _vividness(core, ring)
        if vivid < limits.vivid_min:
            return None
        core, ring = np.array(core, dtype=np.float32), np.array(ring, dtype=np.float32)
        light = None
        if start.semi_minor > _LIGHT_FROM_PX:
            pure = _sample_mask(masks[kind.centre], points[_RAYS:], limits.shrink)
            slopes = (
                _slope_of_light(colours[_RAYS:], core, pure, self._rows[4 * _RAYS :], start.semi_minor),
                _slope_of_light(colours[:_RAYS], ring, painted, self._rows[: 4 * _RAYS], start.semi_minor),
            )
            light = self._circle @ np.stack(slopes, axis=1)
        inner = self._centre_outline(bgr, start, core, ring, light)
        if inner is None or inner.arc < limits.arc_min or inner.misfit > 1.0:
            return None
        ellipse = inner.ellipse
        if ellipse.semi_minor < max(0.5 * limits.diameter_min_px, limits.aspect_min * ellipse.semi_major):
            return None
        points = _at(ellipse, self._disc)
        painted = _sample_mask(masks[kind.ring], points[:_RAYS], limits.shrink)
        share, inside = self._share(painted, points, ellipse, bgr.shape)
        if share < limits.ring_min:
            return None
        pure = cv2.mean(_sample_mask(masks[kind.centre], points[_RAYS:], limits.shrink))[0]
        if pure < 255.0 * limits.centre_min * inside:
            return None
        circle = self._ideal_circle(inner)
        outer, bounded = self._ring_outline(bgr, ellipse, circle, ring)
        if bounded < limits.bounded_min:
            return None
        # Without the outline of the ring the rest must be beyond doubt, and the picture's border the reason.
        if outer is None:
            sure = inner.misfit <= 0.5 and vivid >= 0.5 * (1.0 + limits.vivid_min)
            if inside == 1.0 or not sure or ellipse.semi_minor < limits.diameter_min_px:
                return None
        (x, y), covariance = self._centre(bgr.shape[1], bgr.shape[0], inner, circle, outer)
        if not math.isfinite(x + y):  # outside of what the lens model describes
            (x, y), covariance = ellipse[:2], None
        width, height, angle = ellipse.rectangle()
        score = share * inner.arc * (1.0 - 0.5 * inner.misfit) * (1.0 if outer is not None else 0.8)
        partial = inside < 1.0 or inner.arc < _ARC_WHOLE or inner.misfit > _MISFIT_WHOLE
        saturated = max(core.max(), ring.max()) > _SATURATED
        if covariance is not None and (partial or saturated):
            doubt = _DOUBT * max(1.0, inner.misfit / _MISFIT_WHOLE) ** 4
            covariance = tuple(doubt * value for value in covariance)
        return Detection(kind.roi_name, x, y, width, height, angle, score, partial, ellipse, covariance)

    def _share(self, painted, points, ellipse, shape):
        """(share of the perimeter that has the ring's colour, of what is in the picture; share that is in it).

        painted: (rays, radii) mask; points: (rays.., radii, 2) of it, around the ellipse.
        """
        hits = painted.any(axis=1)
        if _well_inside(ellipse, self._scale, shape):
            return np.count_nonzero(hits) / _RAYS, 1.0
        inside = _inside(points[:_RAYS, -1], shape)
        count = np.count_nonzero(inside)
        if count < _RAYS_MIN:
            return 0.0, count / _RAYS
        return np.count_nonzero(hits & inside) / count, count / _RAYS

    def _centre_outline(self, bgr, start, core, ring, light):
        """_Outline of the centre near the ellipse `start`; None if there is none."""
        band = self._scale - 1.0
        reach = min(0.5 * band, max(_REACH_PX / start.semi_minor, 0.15))
        points, good, _ = self._edge(bgr, start, reach, core, ring, light)
        if np.count_nonzero(good) < _WHOLE * _RAYS:  # a part is hidden: the blob is not quite where the disc is
            points, good, _ = self._edge(bgr, start, 0.6 * band, core, ring, light)
            start = _rough_ellipse(points[good], start)
            if start is None:
                return None
            reach = min(0.5 * band, max(_REACH_PX / start.semi_minor, 0.15))
            points, good, _ = self._edge(bgr, start, reach, core, ring, light)
        outline = self._outline(points[good])
        return outline and outline._replace(start=start, rays=good)

    def _ring_outline(self, bgr, inner, circle, ring):
        """(ideal Ellipse of the ring, None where background or neighbours hide it; share of rays with a contrast).

        inner: Ellipse of the centre as it is seen, circle: as a camera without distortion would see it.
        """
        start, reach = inner.grown(self._scale), 0.5 * (self._scale - 1.0) / self._scale
        points, good, contrast = self._edge(bgr, start, reach, ring)
        furthest = 1.0 + reach * _BEYOND[-1]
        if not _well_inside(start, furthest, bgr.shape):
            visible = _inside(self._circle @ (furthest * _turned(start)) + (start.x, start.y), bgr.shape)
            contrast = contrast[visible]
        bounded = np.count_nonzero(contrast) / len(contrast) if len(contrast) >= _RAYS_MIN else 1.0
        points = self._ideal(points[good])
        ellipse, off_px = fit_grown(points, circle, self._scale)
        if ellipse is None or abs(ellipse.semi_minor / (circle.semi_minor * self._scale) - 1.0) > _SCALE_TOLERANCE:
            return None, bounded
        outline = self._judged(ellipse, points, off_px)
        return (None if outline.arc < 0.5 or outline.misfit > 1.0 else ellipse), bounded

    def _outline(self, points):
        """_Outline through edge points; None if there is none."""
        if len(points) < _RAYS_MIN:
            return None
        ellipse, distances = fit_ellipse(points)
        if ellipse is None or ellipse.semi_minor < 1.0:
            return None
        return self._judged(ellipse, points, distances)

    def _judged(self, ellipse, points, distances):
        """_Outline of a fit."""
        allowed = self._limits.misfit_max * math.sqrt(ellipse.semi_major * ellipse.semi_minor) + _MISFIT_PX
        spread = np.abs(distances)
        near = distances[spread <= max(0.5, 2.0 * allowed)]
        rms_px = math.sqrt(float(near @ near) / len(near)) if len(near) else math.inf
        return _Outline(ellipse, points, rms_px, len(near) / _RAYS, rms_px / allowed)

    def _edge(self, bgr, ellipse, reach, inside, outside=None, light=None):
        """Where the colour changes from `inside` to `outside` between 1 - reach and 1 + reach times the ellipse.

        inside, outside: (3,) float32 BGR; None: what is beyond on each ray. light: (rays, 2) by which share it is
        brighter there on each of both; None: no difference.
        Returns points (rays, 2), whether they are good (rays,), whether the two colours differ (rays,) or ().
        """
        count = int(min(24, max(8, 1.6 * reach * (ellipse.semi_major + ellipse.semi_minor))))
        steps, averages, ends = _profile(count, outside is None)
        directions = self._circle @ _turned(ellipse)
        points = directions[:, None, :] * (1.0 + np.float32(reach) * steps)
        points += np.array((ellipse.x, ellipse.y), dtype=np.float32)
        colours = _sample(bgr, points).astype(np.float32)
        if outside is None:
            outside = colours[:, count:].sum(axis=1) / np.float32(len(_BEYOND))
            colours = colours[:, :count]
            contrast = inside - outside
            square = (contrast * contrast).sum(axis=1)
            weights = contrast / np.maximum(square, np.float32(1.0))[:, None]
            share = np.matmul(colours, weights[:, :, None])[:, :, 0]
            share -= (outside * weights).sum(axis=1)[:, None]
        else:
            contrast = inside - outside
            square = contrast @ contrast
            weights = contrast / max(1.0, square)
            share = cv2.transform(colours, np.append(weights, -(outside @ weights))[None])
            if light is not None:
                low, high = light[:, 1] * (outside @ weights), 1.0 + light[:, 0] * (inside @ weights)
                share = (share - low[:, None]) / (high - low)[:, None]
        np.maximum(share, 0.0, out=share)
        np.minimum(share, 1.0, out=share)
        first, last, whole = (share @ averages).T
        differs = square > _CONTRAST_MIN**2
        # Beyond the edge must be what is expected there, not a third colour.
        end = colours[:, -ends:].sum(axis=1) / np.float32(ends) - outside
        good = (first > 0.55) & (last < 0.45) & ((end * end).sum(axis=1) < _FOREIGN**2 * square) & differs
        # The area under the profile says where the step is; noise and blur do not move it.
        points = directions * (1.0 - reach + 2.0 * reach * whole.astype(float))[:, None]
        points += (ellipse.x, ellipse.y)
        if not _well_inside(ellipse, 1.0 + reach, bgr.shape):
            good &= _inside(points + directions * (0.5 * reach), bgr.shape)
        return points, good, differs

    def _centre(self, width, height, inner, circle, ring):
        """((x, y) [px] where the centre of the disc is seen, its covariance as Detection's).

        NaN outside of what the lens model describes. inner: _Outline of the centre; circle, ring: Ellipses of centre
        and ring, without distortion; ring may be None.
        """
        if self._camera is None:
            focal = _NOMINAL_FOCAL * width
            K = np.array([[focal, 0.0, 0.5 * (width - 1)], [0.0, focal, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])
        else:
            K = self._camera.K
        (fx, skew, cx), (_, fy, cy), _ = K.tolist()
        hypotheses = [
            [(fx * x + skew * y + cx, fy * y + cy) for x, y in pair]
            for pair in circle_centres(K.T @ circle.conic() @ K, self._scale)
        ]
        share = 0.5  # of the first hypothesis
        if not hypotheses:
            x, y = circle.x, circle.y
        elif self._camera is not None:
            share = 0.5 if ring is None else _share_of_first(hypotheses, ring)
            x, y = _between(hypotheses, share)
        elif ring is None:
            x, y = circle.x, circle.y
        else:
            spread_px = _DISTORTED * circle.semi_major**2 / width
            x, y = _of_unknown(circle, hypotheses, ring, spread_px, 1.0 / (self._scale**2 - 1.0))
        turn = None  # from pixels without distortion to those of the picture
        if self._distorted:
            ideal = np.array([(x, y), (x + 1.0, y), (x, y + 1.0)]) - (cx, cy)
            right, down = (ideal[:, 0] - skew / fy * ideal[:, 1]) / fx, ideal[:, 1] / fy
            pixels = self._camera.project(np.column_stack((np.ones(3), right, down)))
            x, y = pixels[0].tolist()
            turn = (pixels[1:] - pixels[0]).T
        if self._camera is None or not hypotheses:
            return (x, y), None
        (first, _), (second, _) = hypotheses
        apart, rows = (first[0] - second[0], first[1] - second[1]), self._harmonics[inner.rays]
        return (x, y), centre_covariance(inner.start, rows, inner.rms_px, math.sqrt(fx * fy), apart, share, turn)

    def _ideal(self, points):
        """Where a camera without distortion would see what is at points (n, 2) px."""
        if not self._distorted or not len(points):
            return points
        K = self._camera.K
        return self._camera.undistort(points) @ K[:2, :2].T + K[:2, 2]

    def _ideal_circle(self, inner):
        """Ellipse of an _Outline as a camera without distortion would see it."""
        if not self._distorted:
            return inner.ellipse
        return fit_ellipse(self._ideal(inner.points))[0] or inner.ellipse


def _between(hypotheses, share):
    """Mean of the centres of two hypotheses; share: weight of the first."""
    ((x, y), _), ((u, v), _) = hypotheses
    return share * x + (1.0 - share) * u, share * y + (1.0 - share) * v


def _share_of_first(hypotheses, ring):
    """Which of the two tilts is it? Probability of the first; 0.5 where the ring does not tell."""
    first, second = [(x - ring.x) ** 2 + (y - ring.y) ** 2 for _, (x, y) in hypotheses]
    return 1.0 / (1.0 + math.exp(min(0.5 * (first - second) / _SIGMA_PX**2, 700.0)))


def _of_unknown(circle, hypotheses, ring, spread_px, least):
    """Same for a camera whose focal length and distortion are not known: the ring tells how large the shift is, too.

    Shifts by perspective and by distortion grow with the square of a circle's size, hence both outlines together tell
    the shift of the disc's centre. What they tell is weighed against what is to be expected: a ring that is measured
    to _SIGMA_PX says little where shifts are smaller than that. spread_px: deviation of shifts by distortion.
    least: shift of the centre / of the ring for small shifts.
    """
    total = shift_x = shift_y = 0.0
    noise = _SIGMA_PX**2
    for (x, y), (u, v) in hypotheses:
        x, y, u, v = x - circle.x, y - circle.y, u - circle.x, v - circle.y
        size = math.hypot(u, v)
        if size < 1e-9:  # from the front
            u, v, size = 1e-9, 0.0, 1e-9
        u, v = u / size, v / size  # direction of the ring's shift
        off_x, off_y = ring.x - circle.x - size * u, ring.y - circle.y - size * v
        along, across = u * off_x + v * off_y, u * off_y - v * off_x
        along_var, across_var = (_LONGER * size) ** 2 + spread_px**2, (_ASIDE * size) ** 2 + spread_px**2
        likely = math.exp(-0.5 * (along**2 / (along_var + noise) + across**2 / (across_var + noise)))
        along = size + along * along_var / (along_var + noise)
        across *= across_var / (across_var + noise)
        share = math.hypot(x, y) / size if size > 1e-6 else least
        shift_x += likely * share * (along * u - across * v)
        shift_y += likely * share * (along * v + across * u)
        total += likely
    if total == 0.0:
        return circle.x, circle.y
    return circle.x - shift_x / total, circle.y - shift_y / total


def _slope_of_light(colours, mean, painted, rows, size_px):
    """By which share (2,) the light on a paint grows per radius of a disc, to the right and downwards in its plane.

    Without it, a brighter half of a disc would look larger. colours: of one paint where it is `painted`; mean: (3,) of
    these; rows: (n, 3) of the points' places on a disc with radius 1, and 1. Small discs tell little of the light, and
    neighbours' colours blur into them: a flat light is expected.
    """
    seen = colours.reshape(-1, 3).astype(np.float32) @ (mean / (mean @ mean)) - np.float32(1.0)
    weighted = rows * (painted.reshape(-1, 1) * np.float32(1.0 / 255.0))
    square = weighted.T @ rows
    square[[0, 1], [0, 1]] += (_LIGHT_NOISE / (_LIGHT_SLOPE * size_px)) ** 2
    return cv2.solve(square, weighted.T @ seen, flags=cv2.DECOMP_CHOLESKY)[1][:2, 0]


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


def _rough_ellipse(points, near):
    """Ellipse through edge points (n, 2) px, outliers left out; None if there is none like the ellipse `near`."""
    if len(points) < _RAYS_MIN:
        return None
    ellipse = direct_ellipse(points.astype(np.float32))
    if ellipse is None or ellipse.semi_minor < 1.0:
        return None
    off = np.abs(distances(points, ellipse))
    keep = off <= max(_OUTLIER_PX, 3.0 * float(np.median(off)))
    if _RAYS_MIN <= keep.sum() < len(points):
        ellipse = direct_ellipse(points[keep].astype(np.float32))
    if ellipse is None or not 0.5 < ellipse.area / near.area < 2.0 or ellipse.semi_minor < 1.0:
        return None
    return ellipse


def _enlarged(ellipse, factor):
    """From pixels of the shrunk picture to those of the whole one."""
    x, y = factor * (ellipse.x + 0.5) - 0.5, factor * (ellipse.y + 0.5) - 0.5
    return Ellipse(x, y, factor * ellipse.semi_major, factor * ellipse.semi_minor, ellipse.angle_rad)


def _on_rays(circle, radii):
    """(rays, radii, 2) points at these radii."""
    return (circle[:, None, :] * radii[:, None]).astype(np.float32)


def _turned(ellipse):
    """(2, 2) float32: points (n, 2) of a circle with radius 1 @ this are those of the ellipse, about its middle."""
    c, s = math.cos(ellipse.angle_rad), math.sin(ellipse.angle_rad)
    a, b = ellipse.semi_major, ellipse.semi_minor
    return np.array(((a * c, a * s), (-b * s, b * c)), dtype=np.float32)


def _at(ellipse, pattern):
    """Points (n, m, 2) float32 of a disc with radius 1, on the disc whose outline this ellipse is."""
    points = pattern.reshape(-1, 2) @ _turned(ellipse)
    points += np.array((ellipse.x, ellipse.y), dtype=np.float32)
    return points.reshape(pattern.shape)


@functools.lru_cache(maxsize=64)
def _profile(count, beyond):
    """Profiles of `count` samples across an edge: (places (count, 1) in -1..1, averages (count, 3), ends).

    A profile @ averages is the mean of its first, its last `ends`, and of all samples. beyond: places also has those
    of _BEYOND, at its end.
    """
    ends = max(1, count // 8)
    averages = np.zeros((count, 3), np.float32)
    averages[:ends, 0] = averages[-ends:, 1] = 1.0 / ends
    averages[:, 2] = 1.0 / count
    steps = (2.0 * np.arange(count) + (1.0 - count)) / count
    steps = np.append(steps, _BEYOND) if beyond else steps
    return steps.astype(np.float32)[:, None], averages, ends


def _well_inside(ellipse, factor, shape):
    """Whether all of an ellipse `factor` times as large is in a picture of this shape."""
    c, s = math.cos(ellipse.angle_rad), math.sin(ellipse.angle_rad)
    x = factor * math.hypot(ellipse.semi_major * c, ellipse.semi_minor * s)
    y = factor * math.hypot(ellipse.semi_major * s, ellipse.semi_minor * c)
    return x < ellipse.x < shape[1] - 1.0 - x and y < ellipse.y < shape[0] - 1.0 - y


def _inside(points, shape):
    """Whether points (..., 2) are in a picture of this shape."""
    x, y = points[..., 0], points[..., 1]
    return (x > 0.0) & (y > 0.0) & (x < shape[1] - 1.0) & (y < shape[0] - 1.0)


def _sample(bgr, points):
    """The picture at points (n, m, 2) float32, interpolated: (n, m, 3); black outside."""
    return cv2.remap(bgr, points, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)


def _sample_mask(mask, points, shrink):
    """A mask of the shrunk picture at points (n, m, 2) float32 of the whole one: (n, m), 0 outside."""
    if shrink != 1:
        points = points * np.float32(1.0 / shrink) + np.float32(0.5 / shrink - 0.5)
    return cv2.remap(mask, points, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
