"""Pictures of the scene as a moving camera takes them.

A picture is made in three steps: the room, drawn straight into the distorted picture; the things in it (landmarks,
vehicles, boards), from far to near, each blended in by the exact share of every pixel that it covers; the sensor
(lens blur, vignette, light, noise). Motion blur is the mean over several moments of the exposure: every thing is
drawn at as many as its motion needs; the room at few, and the rest of its motion is a shift that all pixels share.
Brightness is linear in the pixel values, which saturate at 255.

Simplifications: the net is behind everything (cameras are inside it); things do not cast shadows; other vehicles'
own motion does not blur.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

from risc_simulator.video.clipping import clip_polygons, clip_segments
from risc_simulator.video.coverage import coverage
from risc_simulator.video.scene import bgr_of_hsv, board_layers, room_geometry

NEAR_M = 0.05  # nothing is drawn nearer to the focal plane than this
_MARGIN = 0.1  # of the picture's size in normalised coordinates: how far things are drawn beyond its border
_SHIFT = 6  # binary digits of a pixel that OpenCV's drawing functions get
_FURTHEST_PX = 16000.0  # their coordinates are 16 bit in places
_THING_STEP_PX = 1.0  # motion between two moments at which things are drawn; a pixel's own width hides it
_MAX_THING_MOMENTS = 24
_ROOM_STEP_PX = 1.5  # the same for the room, for that part of the motion that differs across the picture
_MAX_ROOM_MOMENTS = 4
_MAX_SHIFT_LEVELS = 5
_STRIP_ROWS = 60  # of the picture that the sensor works on at once: they stay in the processor's cache
_PLANCK_K = 0.014388  # second radiation constant [m K]
_WAVELENGTHS_M = np.array([460e-9, 540e-9, 610e-9])  # of a sensor's blue, green and red
_DAYLIGHT_K = 6500.0


class NoiseTile:
    """White noise of unit deviation, larger than any picture, of which each picture takes another part."""

    def __init__(self, seed=0, width_px=1024, height_px=512):
        rng = np.random.default_rng(seed)
        self.values = rng.standard_normal((height_px, width_px, 3), dtype=np.float32)


class Renderer:
    """One camera in one scene. The same arguments and the same calls give the same pictures, bit for bit."""

    def __init__(self, camera, scene, seed=0, noise=None):
        """camera: risc_lab.camera.Camera. scene: Scene. seed: int or SeedSequence.

        noise: NoiseTile that several renderers share; None makes one. Raises ValueError for a tile that is too small.
        """
        self.camera = camera
        self.scene, self.imaging = scene, scene.style.imaging
        self._rng = np.random.default_rng(seed)
        size = camera.width_px, camera.height_px
        if noise is None:
            noise = NoiseTile(self._rng.integers(2**32), size[0] + 256, size[1] + 128)
        if noise.values.shape[1] < size[0] or noise.values.shape[0] < size[1]:
            raise ValueError("the noise tile is %dx%d, the picture %dx%d" % (noise.values.shape[1::-1] + size))
        self._noise = noise
        self._light = _light_map(size, self.imaging)
        self._gain, self._brightness = 1.0, self._light
        # kept from picture to picture: new memory of this size costs as much as the work in it
        self._canvas, self._paint = (np.empty((size[1], size[0], 3), np.uint8) for _ in range(2))
        self._exposed, self._grain = (np.zeros((_STRIP_ROWS, size[0], 3), np.float32) for _ in range(2))
        self._hull_parts = {}
        self._prop_things = [_prop_thing(prop) for prop in self.scene.props]
        self._disc_things = [_disc_things(disc, bgr_of_hsv(scene.style.discs.back)) for disc in scene.discs]

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
        # beyond this radius, outside the picture, points are kept at it: the distortion might fold them back
        reach = np.linalg.norm(border, axis=1).max()
        self._radius_limit = min((1.0 + 2.0 * _MARGIN) * reach, 0.999 * camera.radius_limit)
        grid = np.stack(np.meshgrid(np.linspace(0, size[0] - 1, 4), np.linspace(0, size[1] - 1, 3)), axis=-1)
        self._probe_rays = camera.rays(grid.reshape(-1, 2))

        polygons, self._cords, self._cord_bgr, posts = room_geometry(scene.style.room, scene.arena)
        self._behind_all = scene.style.room.shaded(scene.style.room.walls.front)
        groups = [(bgr, group) for bgr, group in polygons + posts if group]
        outlines = [outline for _, group in groups for outline in group]
        self._room_points = np.concatenate(outlines)
        self._room_counts = np.array([len(outline) for outline in outlines])
        self._room_group = np.repeat(np.arange(len(groups)), [len(group) for _, group in groups])
        self._room_bgr = [bgr for bgr, _ in groups]
        self._first_post = len(groups) - len(posts)

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
        points, counts = self._clipped(to_camera(pose, self._room_points, time_s), self._room_counts)
        pixels = _fixed_point(self._pixels(points, pose))
        stops = np.cumsum(counts).tolist()
        groups = {}
        for number in np.flatnonzero(counts).tolist():
            group = groups.setdefault(int(self._room_group[number]), [])
            group.append(pixels[stops[number] - counts[number] : stops[number]])
        cords_drawn = False
        for number in sorted(groups):
            if number >= self._first_post and not cords_drawn:
                self._draw_cords(picture, pose, time_s)
                cords_drawn = True
            cv2.fillPoly(picture, groups[number], self._room_bgr[number], cv2.LINE_AA, _SHIFT)
        if not cords_drawn:
            self._draw_cords(picture, pose, time_s)

    def _clipped(self, points, counts):
        """Polygons in camera axes cut to the frustum, as clip_polygons; most lie wholly on one side and are quick."""
        starts = np.cumsum(counts) - counts
        side = points @ self._frustum[:, :3].T + self._frustum[:, 3]
        lowest = np.minimum.reduceat(side, starts)
        highest = np.maximum.reduceat(side, starts)
        outside = (highest < 0.0).any(axis=1)
        cut = ~outside & (lowest < 0.0).any(axis=1)
        kept = np.where(outside, 0, counts)
        if not cut.any():
            return points[np.repeat(~outside, counts)], kept
        cut_points, cut_counts = clip_polygons(points[np.repeat(cut, counts)], counts[cut], self._frustum)
        new_counts = kept.copy()
        new_counts[cut] = cut_counts
        result = np.empty((int(new_counts.sum()), 3))
        from_cut = np.repeat(cut, new_counts)
        result[from_cut] = cut_points
        result[~from_cut] = points[np.repeat(~outside & ~cut, counts)]
        return result, new_counts

    def _draw_cords(self, picture, pose, time_s):
        ends = to_camera(pose, self._cords.reshape(-1, 3), time_s).reshape(-1, 2, 3)
        side = ends @ self._frustum[:, :3].T + self._frustum[:, 3]
        ends = ends[~((side[:, 0] < 0.0) & (side[:, 1] < 0.0)).any(axis=1)]
        ends = clip_segments(ends, self._frustum[:1])  # the rest OpenCV cuts off; they are too short to be bent much
        if len(ends):
            pixels = _fixed_point(self._pixels(ends.reshape(-1, 3), pose)).reshape(-1, 2, 2)
            cv2.polylines(picture, list(pixels), False, self._cord_bgr, 1, cv2.LINE_AA, _SHIFT)

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
        """List of _Thing that may be seen, from far to near."""
        scene, position = self.scene, np.asarray(pose.position_m, dtype=float)
        candidates = [  # centre, radius of a sphere around it that holds everything, how to make it
            (front.centre_m, 0.5 * disc.ring_diameter_m, _either, (front, back, position))
            for disc, (front, back) in zip(scene.discs, self._disc_things)
        ]
        candidates += [(thing.centre_m, reach, _itself, (thing,)) for thing, reach in self._prop_things]
        candidates += [
            (
                vehicle.position_m,
                scene.style.hulls.radius_m,
                _vehicle_thing,
                (vehicle, self._parts_of(vehicle), position),
            )
            for vehicle in vehicles
        ]
        for board in boards:
            margin = 1.0 + 2.0 * scene.style.boards.margin_squares
            reach = 0.5 * board.square_m * math.hypot(board.columns + margin, board.rows + margin)
            candidates.append((board.centre_m, reach, _board_thing, (board, position, scene.style.boards)))
        if not candidates:
            return []
        centres = to_camera(pose, np.array([candidate[0] for candidate in candidates], dtype=float))
        side = centres @ self._frustum[:, :3].T + self._frustum[:, 3]
        may_be_seen = (side.min(axis=1) > [-candidate[1] for candidate in candidates]).tolist()
        near_last = np.argsort(-np.einsum("ij,ij->i", centres, centres), kind="stable").tolist()
        return [candidates[k][2](*candidates[k][3]) for k in near_last if may_be_seen[k]]

    def _parts_of(self, vehicle):
        colour = self.scene.hull_colour(vehicle)
        if colour not in self._hull_parts:
            self._hull_parts[colour] = [(part, part.middle) for part in self.scene.style.hulls.parts(colour)]
        return self._hull_parts[colour]

    def _draw_things(self, picture, pose, things):
        layers = [layer for thing in things for layer in thing.layers]
        if not layers:
            return
        moments = 1
        if self._is_moving(pose):
            flow = np.linalg.norm(self._flow(np.array([thing.centre_m for thing in things]), pose), axis=1)
            moments = int(min(max(np.ceil(flow.max() / _THING_STEP_PX), 1), _MAX_THING_MOMENTS))
        outlines = [outline for layer in layers for outline in layer.outlines]
        lengths = np.array([len(outline) for outline in outlines])
        starts = np.cumsum(lengths) - lengths
        world = np.concatenate(outlines)
        points = np.stack([to_camera(pose, world, time_s) for time_s in self._moments(moments)])
        is_near = np.minimum.reduceat(points[..., 0].min(axis=0), starts) < NEAR_M
        pixels = self._pixels(points.reshape(-1, 3), pose).reshape(moments, -1, 2)
        low = np.minimum.reduceat(pixels.min(axis=0), starts).tolist()
        high = np.maximum.reduceat(pixels.max(axis=0), starts).tolist()
        single = pixels.astype(np.float32)  # for OpenCV
        is_near, starts, lengths = is_near.tolist(), starts.tolist(), lengths.tolist()

        batch = _Batch(self._paint, 1.0 / moments)
        first = 0
        for layer in layers:
            last = first + len(layer.outlines)
            polygons, reach = [], low[first:last] + high[first:last]
            for number in range(first, last):
                part = slice(starts[number], starts[number] + lengths[number])
                for moment in range(moments):
                    if is_near[number]:
                        polygon = self._cut_outline(points[moment, part], layer.is_solid, pose)
                        if len(polygon):
                            reach += [polygon.min(axis=0), polygon.max(axis=0)]
                    elif layer.is_solid:
                        polygon = cv2.convexHull(single[moment, part])[:, 0]
                    else:
                        polygon = pixels[moment, part]
                    if len(polygon) > 2:
                        polygons.append(polygon)
            first = last
            batch.add(polygons, reach, layer)
        batch.blend_into(picture)

    def _cut_outline(self, points, is_solid, pose):
        """Pixels (n, 2) of that part of an outline in camera axes, or of a solid's points, that is in front."""
        if is_solid:
            points = points[points[:, 0] >= NEAR_M]
            return _convex_hull(self._pixels(points, pose)) if len(points) > 2 else points[:, 1:]
        points, _ = clip_polygons(points, [len(points)], self._frustum[:1])
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
            tile = self._noise.values
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
        return self.imaging.exposure_s > 0.0 and bool(np.any(pose.velocity_m_s) or np.any(pose.rate_rad_s))

    def _flow(self, points_m, pose):
        """Motion (n, 2) [px] of points (n, 3), cortex frame, during the exposure."""
        half_s = 0.5 * self.imaging.exposure_s
        ends = [
            self._pixels(np.maximum(to_camera(pose, points_m, time_s), (NEAR_M, -np.inf, -np.inf)), pose)
            for time_s in (-half_s, half_s)
        ]
        return ends[1] - ends[0]

    def _pixels(self, points, pose):
        """Pixels (n, 2) of points (n, 3) in camera axes in front of the near plane; those far outside keep near.

        The same model as Camera.project, without OpenCV's derivatives, which take most of its time.
        """
        pixels = self._distorted(points)
        if self.imaging.rolling_s > 0.0 and self._is_rolling(pose):
            height = self.camera.height_px
            for _ in range(2):  # the row depends on the time and the time on the row: converges at once
                row = np.clip(pixels[:, 1], -0.5 * height, 1.5 * height)
                time_s = (row / (height - 1.0) - 0.5) * self.imaging.rolling_s
                pixels = self._distorted(_moved(points, pose, time_s))
        return pixels

    def _is_rolling(self, pose):
        return bool(np.any(pose.velocity_m_s) or np.any(pose.rate_rad_s))

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


def to_camera(pose, points_m, time_s=0.0):
    """Points (n, 3) [m] from the cortex frame into camera axes, time_s [s] after the middle of the exposure."""
    R = np.asarray(pose.R_camera_to_cortex, dtype=float)
    position = np.asarray(pose.position_m, dtype=float)
    if time_s:
        position = position + np.asarray(pose.velocity_m_s) * time_s
        R = R @ cv2.Rodrigues(np.asarray(pose.rate_rad_s, dtype=float) * time_s)[0]
    return (points_m - position) @ R


class _Layer(NamedTuple):
    """Outlines of one colour. A solid's outline is the convex hull of its points in the picture.

    ground_bgr: colour of the layer before, when this one is painted on it: it never reaches beyond. None: on its own.
    """

    outlines: list
    bgr: tuple
    is_solid: bool = False
    ground_bgr: tuple | None = None


class _Thing(NamedTuple):
    """Something with a distance: its layers are drawn together."""

    name: str
    kind: str  # landmark, back, vehicle, board, prop
    centre_m: np.ndarray
    layers: list
    outline_m: np.ndarray | None = None
    normal: np.ndarray | None = None
    centre_outline_m: np.ndarray | None = None


class _Batch:
    """Layers of a picture whose coverage is computed at once."""

    def __init__(self, paint, weight):
        """paint: (h, w, 3) uint8 of the picture's size, to work in. weight: of one polygon."""
        self._paint, self._weight = paint, weight
        self._polygons, self._masks, self._boxes, self._layers = [], [], [], []

    def add(self, polygons, reach, layer):
        """The next layer: pixels (n, 2) of its outlines at all moments, and a list of pixels that spans them all."""
        if not polygons:
            return
        height, width = self._paint.shape[:2]
        x, y = zip(*reach)
        x0, y0 = max(math.floor(min(x) + 0.5), 0), max(math.floor(min(y) + 0.5), 0)
        x1, y1 = min(math.floor(max(x) + 1.5), width), min(math.floor(max(y) + 1.5), height)
        if x0 >= x1 or y0 >= y1:
            return
        self._masks += [len(self._boxes)] * len(polygons)
        self._polygons += polygons
        self._boxes.append((x0, y0, x1, y1))
        self._layers.append(layer)

    def blend_into(self, picture):
        """Paint all layers, in order, into picture (h, w, 3) uint8."""
        if not self._boxes:
            return
        masks = coverage(
            np.concatenate(self._polygons),
            [len(polygon) for polygon in self._polygons],
            self._masks,
            np.full(len(self._polygons), self._weight),
            self._boxes,
        )
        for (x0, y0, x1, y1), layer, mask in zip(self._boxes, self._layers, masks):
            below = picture[y0:y1, x0:x1]
            if layer.ground_bgr is None:
                paint = self._paint[: y1 - y0, : x1 - x0]
                _fill(paint, layer.bgr)
                cv2.blendLinear(paint, below, mask, 1.0 - mask, dst=below)
            else:  # where it covers a part of a pixel, its ground covers that part and not the rest in proportion
                change = mask[:, :, None] * np.subtract(layer.bgr, layer.ground_bgr).astype(np.float32)
                cv2.add(below, change, dst=below, dtype=cv2.CV_8U)


def _itself(thing):
    return thing


def _either(front, back, position):
    """The side of a disc that is seen from a position."""
    return front if (position - front.centre_m) @ front.normal > 0.0 else back


def _prop_thing(prop):
    """(_Thing, radius [m] of the sphere around its centre that holds it)."""
    centre = prop.outline_m.mean(axis=0)
    reach = float(np.linalg.norm(prop.outline_m - centre, axis=1).max())
    return _Thing("", "prop", centre, [_Layer([prop.outline_m], prop.bgr)]), reach


def _disc_things(disc, back_bgr):
    """The _Things that a Disc is from its front and from behind."""
    centre, normal = np.asarray(disc.centre_m, dtype=float), np.asarray(disc.normal, dtype=float)
    ring, inner = disc.outline(disc.ring_diameter_m), disc.outline(disc.centre_diameter_m)
    layers = [_Layer([ring], disc.ring_bgr), _Layer([inner], disc.centre_bgr, ground_bgr=disc.ring_bgr)]
    front = _Thing(disc.name, "landmark", centre, layers, ring, normal, inner)
    return front, _Thing(disc.name, "back", centre, [_Layer([ring], back_bgr)], ring, normal)


def _vehicle_thing(vehicle, parts, position):
    R, centre = np.asarray(vehicle.R_body_to_cortex), np.asarray(vehicle.position_m, dtype=float)
    eye = (position - centre) @ R  # body axes
    facing = [
        (part, eye - middle) for part, middle in parts if part.normal is None or (eye - middle) @ part.normal > 0.0
    ]
    facing.sort(key=lambda entry: -(entry[1] @ entry[1]))
    outline = np.concatenate([part.points for part, _ in facing]) @ R.T + centre
    stops = np.cumsum([len(part.points) for part, _ in facing]).tolist()
    layers = [
        _Layer([outline[stop - len(part.points) : stop]], part.bgr, is_solid=True)
        for stop, (part, _) in zip(stops, facing)
    ]
    return _Thing(vehicle.name, "vehicle", centre, layers, outline)


def _board_thing(board, position, params):
    centre = np.asarray(board.centre_m, dtype=float)
    (white, sheet), (black, squares) = board_layers(board, params)
    layers = [_Layer(sheet, white), _Layer(squares, black, ground_bgr=white)]
    if (centre - position) @ np.asarray(board.R_board_to_cortex)[:, 2] <= 0.0:  # its z points away from the viewer
        layers = layers[:1]
    return _Thing("", "board", centre, layers)


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
    """(n, 2) int32 as OpenCV's drawing functions want them with _SHIFT."""
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
    """Pixels (n, 2) around the picture."""
    width, height = size_px
    x, y = np.linspace(-0.5, width - 0.5, 33), np.linspace(-0.5, height - 0.5, 17)
    sides = [(x, np.full(33, y[0])), (x, np.full(33, y[-1])), (np.full(17, x[0]), y), (np.full(17, x[-1]), y)]
    return np.concatenate([np.stack(side, axis=1) for side in sides])


def _light_map(size_px, imaging):
    """What each pixel's value is multiplied by (h, w, 3) float32: vignette and colour of the light."""
    width, height = size_px
    x, y = np.meshgrid(np.arange(width) - 0.5 * (width - 1), np.arange(height) - 0.5 * (height - 1))
    radius = (x * x + y * y) / (0.25 * (width * width + height * height))
    light = (1.0 - imaging.vignette * radius)[:, :, None] * light_colour(imaging.temperature_k)
    return np.ascontiguousarray(light, dtype=np.float32)


def light_colour(temperature_k):
    """Factors (3,) of blue, green and red in light of a temperature against 6500 K, green kept (Planck's law)."""
    radiance = np.expm1(_PLANCK_K / (_WAVELENGTHS_M * _DAYLIGHT_K)) / np.expm1(
        _PLANCK_K / (_WAVELENGTHS_M * temperature_k)
    )
    return radiance / radiance[1]
