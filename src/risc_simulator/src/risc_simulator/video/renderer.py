"""Pictures of the scene as a moving camera takes them.

A picture is made in three steps: the room, drawn straight into the distorted picture; the things in it (landmarks,
vehicles, boards), from far to near, each blended in by the exact share of every pixel that it covers; the sensor
(lens blur, vignette, light, noise). Motion blur is the mean over several moments of the exposure: every thing is
drawn at as many as its motion needs; the room at few, and the rest of its motion is a shift common to all pixels.
Brightness is linear in the pixel values, which saturate at 255.

Simplifications: the net is behind everything (cameras are inside it); things do not cast shadows; other vehicles'
own motion does not blur.
"""

import cv2
import numpy as np

from risc_simulator.video.polygons import clip_polygons, coverage
from risc_simulator.video.scene import room_layers

NEAR_M = 0.05  # nothing is drawn nearer to the focal plane than this
_MARGIN = 0.1  # of the picture's size in normalised coordinates: how far things are drawn beyond its border
_SHIFT = 6  # fractional bits of pixel coordinates for OpenCV's drawing functions
_FURTHEST_PX = 16000.0  # their coordinates are 16 bit in places
_THING_STEP_PX = 1.0  # motion between two moments at which things are drawn; a pixel's own width hides it
_MAX_THING_MOMENTS = 24
_ROOM_STEP_PX = 1.5  # the same for the room, for that part of the motion that differs across the picture
_MAX_ROOM_MOMENTS = 4
_MAX_SHIFT_LEVELS = 5
_STRIP_ROWS = 60  # of the picture that the sensor processes at once: they stay in the processor's cache
_PLANCK_K = 0.014388  # second radiation constant [m K]
_WAVELENGTHS_M = np.array([460e-9, 540e-9, 610e-9])  # of a sensor's blue, green and red
_DAYLIGHT_K = 6500.0


def noise_tile(seed=0, width_px=1024, height_px=512):
    """White noise (h, w, 3) of unit deviation, larger than any picture; each picture takes a random part of it."""
    return np.random.default_rng(seed).standard_normal((height_px, width_px, 3), dtype=np.float32)


class Renderer:
    """One camera in one scene. The same arguments and the same calls give the same pictures, bit for bit."""

    def __init__(self, camera, scene, seed=0, noise=None):
        """camera: risc_lab.camera.Camera. scene: Scene. seed: int or SeedSequence.

        noise: tile that several renderers share; None makes one.
        """
        self.camera = camera
        self.scene, self.imaging = scene, scene.style.imaging
        self._rng = np.random.default_rng(seed)
        size = camera.width_px, camera.height_px
        if noise is None:
            noise = noise_tile(self._rng.integers(2**32), size[0] + 256, size[1] + 128)
        self._noise = noise
        self._light = _light_map(size, self.imaging)
        self._gain, self._brightness = 1.0, self._light
        # reused for all pictures: allocating memory of this size costs as much as the work in it
        self._canvas, self._paint = (np.empty((size[1], size[0], 3), np.uint8) for _ in range(2))
        self._exposed, self._grain = (np.zeros((_STRIP_ROWS, size[0], 3), np.float32) for _ in range(2))

        border = camera.undistort(_border(size))
        low, high = border.min(axis=0), border.max(axis=0)
        room = _MARGIN * (high - low)
        (left, up), (right, down) = low - room, high + room
        # in camera axes; the near plane comes first so that all others see points in front of the camera only
        self._frustum = np.array(
            [
                (1.0, 0.0, 0.0, -NEAR_M),
                (-left, 1.0, 0.0, 0.0),
                (right, -1.0, 0.0, 0.0),
                (-up, 0.0, 1.0, 0.0),
                (down, 0.0, -1.0, 0.0),
            ]
        )
        self._frustum /= np.linalg.norm(self._frustum[:, :3], axis=1, keepdims=True)
        # points beyond this radius, outside the picture, are moved to it: the distortion might fold them back
        reach = np.linalg.norm(border, axis=1).max()
        self._radius_limit = min((1.0 + 2.0 * _MARGIN) * reach, 0.999 * camera.radius_limit)
        grid = np.stack(np.meshgrid(np.linspace(0, size[0] - 1, 4), np.linspace(0, size[1] - 1, 3)), axis=-1)
        self._probe_rays = camera.rays(grid.reshape(-1, 2))

        self._behind_all = scene.style.room.shaded(scene.style.room.walls.front)
        self._room_layers = room_layers(scene.style.room, scene.arena)
        outlines = [outline for layer in self._room_layers for outline in layer.outlines]
        self._room_points = np.concatenate(outlines)
        self._room_counts = np.array([len(outline) for outline in outlines])

    def render(self, pose, vehicles=(), boards=(), gain=1.0):
        """Picture (h, w, 3) uint8 BGR.

        pose: CameraPose in the middle of the exposure (and of the middle row's). vehicles: of VehiclePose.
        boards: of Board. gain: brightness, 1 = the room's normal light.
        """
        picture = self._draw_room(pose)
        self._draw_things(picture, pose, self._things(pose, vehicles, boards))
        return self._expose(picture, gain)

    # the room

    def _draw_room(self, pose):
        flow = self._room_flow(pose)
        mean = flow.mean(axis=0)
        spread = np.linalg.norm(flow - mean, axis=1).max()
        moments = int(min(max(np.ceil(spread / _ROOM_STEP_PX), 1), _MAX_ROOM_MOMENTS))
        picture = self._canvas
        for number, time_s in enumerate(self._moments(moments)):
            if number == 0:
                self._draw_room_at(picture, pose, time_s)
            else:
                part = np.empty_like(picture)
                self._draw_room_at(part, pose, time_s)
                share = 1.0 / (number + 1)
                cv2.addWeighted(picture, 1.0 - share, part, share, 0.0, dst=picture)
        return _smear(picture, mean / moments)

    def _draw_room_at(self, picture, pose, time_s):
        _fill(picture, self._behind_all)  # nothing of it stays uncovered
        points = to_camera(pose, self._room_points, time_s)
        points, counts = clip_polygons(points, self._room_counts, self._frustum)
        pixels = _fixed_point(self._pixels(points, pose))
        stops, counts, first = np.cumsum(counts).tolist(), counts.tolist(), 0
        for layer in self._room_layers:
            last = first + len(layer.outlines)
            shapes = [pixels[stops[k] - counts[k] : stops[k]] for k in range(first, last) if counts[k]]
            first = last
            if layer.are_lines:
                cv2.polylines(picture, [line[:2] for line in shapes], False, layer.bgr, 1, cv2.LINE_AA, _SHIFT)
            elif shapes:
                cv2.fillPoly(picture, shapes, layer.bgr, cv2.LINE_AA, _SHIFT)

    def _room_flow(self, pose):
        """Motion (n, 2) [px] of the room during the exposure, at places all over the picture."""
        if not self._is_moving(pose):
            return np.zeros((1, 2))
        rays = self._probe_rays @ np.asarray(pose.R_camera_to_cortex).T
        room = self.scene.style.room
        low = np.array([-room.half_x_m, -room.half_y_m, 0.0])
        high = np.array([room.half_x_m, room.half_y_m, room.height_m])
        position = np.asarray(pose.position_m, dtype=float)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.where(rays > 0.0, (high - position) / rays, (low - position) / rays)
        distance = np.clip(np.nanmin(distance, axis=1), 0.3, 20.0)
        return self._flow(position + distance[:, None] * rays, pose)

    # things

    def _things(self, pose, vehicles, boards):
        """[(thing, its Layers)] of the things that may be visible, from far to near."""
        things = [*self.scene.discs, *self.scene.props, *vehicles, *boards]
        if not things:
            return []
        centres, radii = zip(*(thing.sphere(self.scene) for thing in things))
        centres = to_camera(pose, np.array(centres, dtype=float))
        side = centres @ self._frustum[:, :3].T + self._frustum[:, 3]
        may_be_seen = side.min(axis=1) > -np.array(radii)
        near_last = np.argsort(-np.einsum("ij,ij->i", centres, centres), kind="stable")
        eye_m = np.asarray(pose.position_m, dtype=float)
        return [(things[k], things[k].layers(self.scene, eye_m)) for k in near_last.tolist() if may_be_seen[k]]

    def _draw_things(self, picture, pose, things):
        outlines = [(layer, outline) for _, layers in things for layer in layers for outline in layer.outlines]
        if not outlines:
            return
        moments = 1
        if self._is_moving(pose):
            centres = np.array([thing.sphere(self.scene)[0] for thing, _ in things])
            flow = np.linalg.norm(self._flow(centres, pose), axis=1)
            moments = int(min(max(np.ceil(flow.max() / _THING_STEP_PX), 1), _MAX_THING_MOMENTS))
        stops = np.cumsum([len(outline) for _, outline in outlines]).tolist()
        world = np.concatenate([outline for _, outline in outlines])
        points = np.stack([to_camera(pose, world, time_s) for time_s in self._moments(moments)])
        pixels = self._pixels(points.reshape(-1, 3), pose).reshape(moments, -1, 2)
        is_near = (points[..., 0] < NEAR_M).any(axis=0)
        polygons = []
        for number, (layer, outline) in enumerate(outlines):
            part = slice(stops[number] - len(outline), stops[number])
            if is_near[part].any():
                polygons += [self._cut_outline(moment[part], layer.is_solid, pose) for moment in points]
            elif layer.is_solid:
                polygons += [_convex_hull(moment[part]) for moment in pixels]
            else:
                polygons += list(pixels[:, part])
            if number + 1 == len(outlines) or outlines[number + 1][0] is not layer:
                self._blend(picture, [polygon for polygon in polygons if len(polygon) > 2], 1.0 / moments, layer)
                polygons = []

    def _blend(self, picture, polygons, weight, layer):
        """Paint a Layer, whose polygons [px] at all moments are these, into a picture."""
        if not polygons:
            return
        corners = np.concatenate(polygons)
        low = np.maximum(np.floor(corners.min(axis=0) + 0.5), 0.0)
        high = np.minimum(np.floor(corners.max(axis=0) + 1.5), picture.shape[1::-1])
        if (low >= high).any():
            return
        (x0, y0), (x1, y1) = low.astype(int).tolist(), high.astype(int).tolist()
        mask, below = coverage(polygons, (x0, y0, x1, y1), weight), picture[y0:y1, x0:x1]
        if layer.ground_bgr is None:
            paint = self._paint[: y1 - y0, : x1 - x0]
            _fill(paint, layer.bgr)
            cv2.blendLinear(paint, below, mask, 1.0 - mask, dst=below)
        else:  # not blended: the part of a pixel that it covers was its ground, whatever the rest of the pixel is
            change = mask[:, :, None] * np.subtract(layer.bgr, layer.ground_bgr).astype(np.float32)
            cv2.add(below, change, dst=below, dtype=cv2.CV_8U)

    def _cut_outline(self, points, is_solid, pose):
        """Pixels (n, 2) of that part of an outline in camera axes, or of a solid's points, that is in front."""
        if is_solid:
            points = points[points[:, 0] >= NEAR_M]
            return _convex_hull(self._pixels(points, pose)) if len(points) > 2 else points[:, 1:]
        points, _ = clip_polygons(points, np.array([len(points)]), self._frustum[:1])
        return self._pixels(points, pose) if len(points) else points[:, 1:]

    # the sensor

    def _expose(self, picture, gain):
        imaging = self.imaging
        if imaging.defocus_px > 0.0:
            reach = 2 * int(np.ceil(2.0 * imaging.defocus_px)) + 1
            picture = cv2.GaussianBlur(picture, (reach, reach), imaging.defocus_px, dst=self._paint)
        if gain != self._gain:
            self._gain, self._brightness = gain, self._light * np.float32(gain)
        height, width = picture.shape[:2]
        noisy = imaging.read_noise > 0.0 or imaging.shot_noise > 0.0
        if noisy:
            tile = self._noise
            y = int(self._rng.integers(tile.shape[0] - height + 1))
            x = int(self._rng.integers(tile.shape[1] - width + 1))
            tile = tile[y : y + height, x : x + width]
        result = np.empty_like(picture)
        for first in range(0, height, _STRIP_ROWS):
            rows = slice(first, min(first + _STRIP_ROWS, height))
            light, grain = self._exposed[: rows.stop - first], self._grain[: rows.stop - first]
            np.copyto(light, picture[rows])
            cv2.multiply(light, self._brightness[rows], dst=light)
            if noisy:
                np.multiply(light, np.float32(imaging.shot_noise**2), out=grain)
                np.add(grain, np.float32(imaging.read_noise**2), out=grain)
                cv2.sqrt(grain, dst=grain)
                cv2.multiply(grain, tile[rows], dst=grain)
            cv2.add(light, grain, dst=result[rows], dtype=cv2.CV_8U)  # rounds and saturates
        return result

    # geometry

    def _moments(self, count):
        """Times (count,) [s] from the middle of the exposure, each in the middle of its share."""
        return (((np.arange(count) + 0.5) / count) - 0.5) * self.imaging.exposure_s

    def _is_moving(self, pose):
        return self.imaging.exposure_s > 0.0 and _moves(pose)

    def _flow(self, points_m, pose):
        """Motion (n, 2) [px] of points (n, 3), cortex frame, during the exposure."""
        half_s = 0.5 * self.imaging.exposure_s
        ends = [
            self._pixels(np.maximum(to_camera(pose, points_m, time_s), (NEAR_M, -np.inf, -np.inf)), pose)
            for time_s in (-half_s, half_s)
        ]
        return ends[1] - ends[0]

    def _pixels(self, points, pose):
        """Pixels (n, 2) of points (n, 3) in camera axes in front of the near plane; far outside ones are limited.

        The same model as Camera.project, without OpenCV's derivatives, which take most of its time.
        """
        pixels = self._distorted(points)
        if self.imaging.rolling_s > 0.0 and _moves(pose):
            height = self.camera.height_px
            for _ in range(2):  # the row depends on the time and the time on the row: converges at once
                row = np.clip(pixels[:, 1], -0.5 * height, 1.5 * height)
                time_s = (row / (height - 1.0) - 0.5) * self.imaging.rolling_s
                pixels = self._distorted(_moved(points, pose, time_s))
        return pixels

    def _distorted(self, points):
        K = self.camera.K
        k1, k2, p1, p2, k3 = self.camera.D
        depth = np.maximum(points[:, 0], 1e-3)
        x, y = points[:, 1] / depth, points[:, 2] / depth
        square = x * x + y * y
        beyond = square > self._radius_limit**2
        if beyond.any():
            shrink = np.where(beyond, self._radius_limit / np.sqrt(np.maximum(square, 1e-12)), 1.0)
            x, y = x * shrink, y * shrink
            square = x * x + y * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        product = 2.0 * x * y
        pixels = np.empty((len(points), 2))
        pixels[:, 0] = K[0, 0] * (x * radial + p1 * product + p2 * (square + 2.0 * x * x)) + K[0, 2]
        pixels[:, 1] = K[1, 1] * (y * radial + p2 * product + p1 * (square + 2.0 * y * y)) + K[1, 2]
        return pixels


def _moves(pose):
    return bool(np.any(pose.velocity_m_s) or np.any(pose.rate_rad_s))


def to_camera(pose, points_m, time_s=0.0):
    """Points (n, 3) [m] from the cortex frame into camera axes, time_s [s] after the middle of the exposure."""
    R = np.asarray(pose.R_camera_to_cortex, dtype=float)
    position = np.asarray(pose.position_m, dtype=float)
    if time_s:
        position = position + np.asarray(pose.velocity_m_s) * time_s
        R = R @ cv2.Rodrigues(np.asarray(pose.rate_rad_s, dtype=float) * time_s)[0]
    return (points_m - position) @ R


def _moved(points, pose, time_s):
    """Points (n, 3) in camera axes as they are time_s (n,) [s] later, by the camera's own motion."""
    velocity = np.asarray(pose.velocity_m_s, dtype=float) @ np.asarray(pose.R_camera_to_cortex)  # camera axes
    rate = np.asarray(pose.rate_rad_s, dtype=float)
    moved = points - time_s[:, None] * velocity
    speed = np.linalg.norm(rate)
    if speed > 0.0:  # turned back by the angle that the camera turned: Rodrigues' formula
        axis = rate / speed
        angle = (-speed * time_s)[:, None]
        along = (moved @ axis)[:, None] * axis
        moved = along + np.cos(angle) * (moved - along) + np.sin(angle) * np.cross(axis, moved)
    return moved


def _fill(picture, bgr):
    """Paint all of picture (h, w, 3) in one colour; many times quicker than by numpy."""
    cv2.rectangle(picture, (0, 0), (picture.shape[1], picture.shape[0]), bgr, cv2.FILLED)


def _convex_hull(pixels):
    """Corners (n, 2) of the convex hull."""
    return cv2.convexHull(pixels.astype(np.float32))[:, 0].astype(float)


def _fixed_point(pixels):
    """Pixels (n, 2) as int32, as OpenCV's drawing functions take them with _SHIFT."""
    return np.round(np.clip(pixels, -_FURTHEST_PX, _FURTHEST_PX) * (1 << _SHIFT)).astype(np.int32)


def _smear(picture, motion_px):
    """Mean of the picture over a straight motion (2,) [px]: pairs of shifted copies, each half as far as the last."""
    levels = int(min(max(np.ceil(np.log2(max(np.abs(motion_px).max(), 1e-9))), 0), _MAX_SHIFT_LEVELS))
    height, width = picture.shape[:2]
    off = np.zeros(2)  # how far whole pixels have moved the picture so far
    for level in range(1, levels + 1):
        apart = np.round(motion_px / 2.0**level)
        first_by = np.round(0.5 * apart - off)
        off += first_by - 0.5 * apart
        (dx, dy), (x0, y0) = apart.astype(int).tolist(), first_by.astype(int).tolist()
        if (dx or dy) and abs(dx) < width and abs(dy) < height:
            # one copy moves by half of it to the one side, one to the other
            margin_x, margin_y = abs(dx) + 1, abs(dy) + 1
            padded = cv2.copyMakeBorder(picture, margin_y, margin_y, margin_x, margin_x, cv2.BORDER_REPLICATE)
            first = padded[margin_y + y0 :, margin_x + x0 :][:height, :width]
            second = padded[margin_y + y0 - dy :, margin_x + x0 - dx :][:height, :width]
            picture = cv2.addWeighted(first, 0.5, second, 0.5, 0.0)
    return picture


def _border(size_px):
    """Pixels (n, 2) along the border of the picture."""
    width, height = size_px
    x, y = np.linspace(-0.5, width - 0.5, 33), np.linspace(-0.5, height - 0.5, 17)
    sides = [(x, np.full(33, y[0])), (x, np.full(33, y[-1])), (np.full(17, x[0]), y), (np.full(17, x[-1]), y)]
    return np.concatenate([np.stack(side, axis=1) for side in sides])


def _light_map(size_px, imaging):
    """Factors (h, w, 3) float32 of the pixels' values: vignette and colour of the light."""
    width, height = size_px
    x, y = np.meshgrid(np.arange(width) - 0.5 * (width - 1), np.arange(height) - 0.5 * (height - 1))
    radius = (x * x + y * y) / (0.25 * (width * width + height * height))
    light = (1.0 - imaging.vignette * radius)[:, :, None] * light_colour(imaging.temperature_k)
    return np.ascontiguousarray(light, dtype=np.float32)


def light_colour(temperature_k):
    """Factors (3,) of blue, green and red in light of a temperature relative to 6500 K; green: 1 (Planck's law)."""
    radiance = np.expm1(_PLANCK_K / (_WAVELENGTHS_M * _DAYLIGHT_K)) / np.expm1(
        _PLANCK_K / (_WAVELENGTHS_M * temperature_k)
    )
    return radiance / radiance[1]
