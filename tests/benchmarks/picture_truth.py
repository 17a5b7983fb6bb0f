"""True content of rendered pictures, to measure detectors on."""

from dataclasses import dataclass

import cv2
import numpy as np

from risc_lab.camera import bearings_of_rays
from risc_simulator.video.checkerboard_motion import HOLD_S, MOVE_S, POSTURES
from risc_simulator.video.polygons import coverage
from risc_simulator.video.renderer import NEAR_M, Renderer, _convex_hull, to_camera
from risc_simulator.video.scene import CameraPose, Disc, VehiclePose

_TRUTH_RASTER = 128  # cells along the longer side of an outline in which its visible share is counted


@dataclass(frozen=True)
class Truth:
    """True appearance of one object. Pixels as in risc_lab.camera, at the middle of the exposure."""

    name: str
    kind: str  # "landmark" or "vehicle"
    centre_px: tuple[float, float]  # image of the object's centre point: not the middle of its outline
    box_px: tuple[float, float, float, float]  # x0, y0, x1, y1 of the whole outline, also beyond the border
    diameter_px: float  # least diameter: of a landmark's centre disc, of a vehicle's outline
    seen_fraction: float  # of the outline: in the picture and not hidden by something nearer
    azimuth_rad: float  # bearing of the centre in the camera's axes, + right
    elevation_rad: float  # + up
    distance_m: float  # focal point to centre
    obliqueness_rad: float  # landmark: normal to line of sight, 0 = seen from the front. Vehicle: always 0


class LabelledRenderer(Renderer):
    """A Renderer that also gives the truth of its pictures."""

    def truth(self, pose, vehicles=(), boards=()):
        """List of Truth, nearest last: landmarks that face the camera and vehicles whose outline meets the picture.

        Arguments as in `render`. An object that something nearer hides completely is listed with seen_fraction 0.
        A vehicle's outline is convex: what is seen between its rotors counts as vehicle.
        """
        truths, nearer = [], []
        for thing, layers in reversed(self._things(pose, vehicles, boards)):
            is_landmark = isinstance(thing, Disc) and len(layers) == 2  # else it is seen from behind
            if is_landmark or isinstance(thing, VehiclePose):
                outline_m = np.concatenate([layer.outlines[0] for layer in layers[: 1 if is_landmark else None]])
                outline, share = self._outline(outline_m, not is_landmark, pose)
                if self._meets_picture(outline):
                    truth = self._truth_of(thing, outline, share * self._seen_fraction(outline, nearer), pose)
                    truths += [truth] if truth is not None else []
            shapes = [self._outline(shape, layer.is_solid, pose)[0] for layer in layers for shape in layer.outlines]
            nearer += [shape for shape in shapes if len(shape) > 2]
        return truths[::-1]

    def project(self, points_m, pose):
        """Pixels (n, 2) at which points (n, 3) [m], cortex frame, are drawn; NaN where they cannot be seen.

        With a rolling exposure the row decides when a point is seen: this is where `Truth.centre_px` comes from.
        """
        points = to_camera(pose, np.asarray(points_m, dtype=float))
        good = points[:, 0] > NEAR_M
        normalised = points[good, 1:] / points[good, :1]
        good[good] = np.hypot(normalised[:, 0], normalised[:, 1]) <= self._radius_limit
        pixels = np.full((len(points), 2), np.nan)
        pixels[good] = self._pixels(points[good], pose)
        return pixels

    def _outline(self, outline_m, is_solid, pose):
        """(pixels (n, 2) of that part of an outline (k, 3) that is in front of the camera, share of points in it)."""
        points = to_camera(pose, outline_m)
        in_front = points[:, 0] >= NEAR_M
        if not in_front.all():
            return self._cut_outline(points, is_solid, pose), float(in_front.mean())
        pixels = self._pixels(points, pose)
        return (_convex_hull(pixels) if is_solid else pixels), 1.0

    def _meets_picture(self, outline):
        if len(outline) < 3:
            return False
        low, high = outline.min(axis=0), outline.max(axis=0)
        size = self.camera.width_px, self.camera.height_px
        return bool((low < np.array(size) - 0.5).all() and (high > -0.5).all())

    def _truth_of(self, thing, outline, seen_fraction, pose):
        """Truth; None when the centre is where the camera model does not reach."""
        centre_m = np.array(thing.sphere(self.scene)[0], dtype=float)
        centre = self.project(centre_m[None], pose)[0]
        if not np.isfinite(centre).all():
            return None
        low, high = outline.min(axis=0), outline.max(axis=0)
        relative = to_camera(pose, centre_m[None])[0]
        azimuth, elevation = bearings_of_rays(relative)
        obliqueness = 0.0
        is_landmark = isinstance(thing, Disc)
        if is_landmark:
            least = self._disc_diameter(thing, pose)
            sight = np.asarray(pose.position_m) - centre_m
            obliqueness = float(np.arccos(np.clip(sight @ thing.normal / np.linalg.norm(sight), -1.0, 1.0)))
        else:
            least = float(min(cv2.minAreaRect(outline.astype(np.float32))[1]))
        return Truth(
            name=thing.name,
            kind="landmark" if is_landmark else "vehicle",
            centre_px=(float(centre[0]), float(centre[1])),
            box_px=(float(low[0]), float(low[1]), float(high[0]), float(high[1])),
            diameter_px=least,
            seen_fraction=seen_fraction,
            azimuth_rad=float(azimuth),
            elevation_rad=float(elevation),
            distance_m=float(np.linalg.norm(relative)),
            obliqueness_rad=obliqueness,
        )

    def _disc_diameter(self, thing, pose):
        """Least diameter [px] of the ellipse that a landmark's centre disc is seen as."""
        outline_m = thing.outline(thing.centre_diameter_m)
        pixels = self.project(outline_m, pose)
        scale = 1.0
        if not np.isfinite(pixels).all():  # a part is not projected: use its middle
            scale = 0.1
            pixels = self.project(thing.centre_m + scale * (outline_m - thing.centre_m), pose)
        if not np.isfinite(pixels).all():
            return 0.0
        # points spread evenly on a circle have half the squared radius as variance, along each axis of the ellipse
        variance = np.linalg.eigvalsh(np.cov(pixels.T, bias=True))[0]
        return float(2.0 * np.sqrt(2.0 * max(variance, 0.0)) / scale)

    def _seen_fraction(self, pixels, nearer):
        """Share of an outline's area that is in the picture and not covered by outlines nearer to the camera."""
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        scale = _TRUTH_RASTER / max(float((high - low).max()), 1e-6)
        width, height = (np.ceil((high - low) * scale).astype(int) + 1).tolist()
        corners = np.array([(-0.5, -0.5), (self.camera.width_px - 0.5, self.camera.height_px - 0.5)])
        corners = (corners - low) * scale
        frame = np.array([corners[0], (corners[1, 0], corners[0, 1]), corners[1], (corners[0, 0], corners[1, 1])])
        outlines = [(pixels - low) * scale, frame]
        outlines += [
            (other - low) * scale
            for other in nearer
            if (other.min(axis=0) < high).all() and (other.max(axis=0) > low).all()
        ]
        masks = [coverage([outline], (0, 0, width, height)) for outline in outlines]
        whole = float(masks[0].sum())
        seen = masks[0] * masks[1]
        for mask in masks[2:]:
            seen *= 1.0 - mask
        return min(1.0, float(seen.sum()) / whole) if whole > 0.0 else 0.0


def held_s():
    """Times (postures,) [s] within the first round of a moving board in the middle of each hold."""
    return (HOLD_S + MOVE_S) * np.arange(len(POSTURES)) + 0.5 * HOLD_S


def corners_of(board):
    """Inner corners (rows * columns, 3) [m] of a Board, cortex frame, in findChessboardCorners' order."""
    column, row = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
    return board.to_cortex(
        np.stack((column.ravel() - 0.5 * (board.columns - 1), row.ravel() - 0.5 * (board.rows - 1)), axis=1)
    )


def corners_px(motion, camera, time_s):
    """Pixels (rows * columns, 2) of the inner corners of a board that is moved before a camera, row by row."""
    return camera.project(corners_of(motion.board(time_s, CameraPose(np.zeros(3), np.eye(3)))))
