"""What the virtual cameras look at: landmark discs, vehicles' hulls, checkerboards and the room around the arena.

Everything is flat polygons in the cortex frame [m] (x forward, y left, z up), or convex solids given by their points.
Colours are BGR 0..255; in settings, and so in config/scene.yaml, they are OpenCV's HSV.

A thing (Disc, Board, Prop, VehiclePose) has
    sphere(scene)         bounding sphere: centre (3,) and radius [m]
    layers(scene, eye_m)  its Layers, as seen from a place (3,), in painter's order
"""

import functools
import math
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal, NamedTuple

import cv2
import numpy as np

from risc_lab.lab.arena import NET_HALF_X_M, NET_HALF_Y_M, Arena
from risc_lab.lab.landmark_catalogue import load_landmark_catalogue
from risc_lab.lab.yaml_reader import load_yaml, package_file
from risc_lab.settings import Fraction, Meta, Positive, Settings, between, settings_from

CIRCLE_POINTS = 64  # corners of a disc's outline: area and diameter 0.16 % and 0.08 % too small, corrected below
_CIRCLE_GAIN = math.sqrt(2.0 * math.pi / CIRCLE_POINTS / math.sin(2.0 * math.pi / CIRCLE_POINTS))  # for the true area
_MAX_EDGE = 0.5  # [m], boards: [squares]; longer edges are divided, as a distorted picture bends straight lines
CORNERS = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])  # of a square

Bgr = tuple[float, float, float]
Hsv = tuple[Annotated[float, Meta(ge=0.0, lt=180.0)], between(0.0, 255.0), between(0.0, 255.0)]


class Layer(NamedTuple):
    """Outlines of one colour. A solid's outline is the convex hull of its points in the picture.

    ground_bgr: colour of the layer before, if this one is painted on it and lies within it. None: it stands alone.
    """

    outlines: list  # of (n, 3) [m], cortex frame
    bgr: Bgr
    is_solid: bool = False
    ground_bgr: Bgr | None = None


@dataclass(frozen=True)
class Disc:
    """A landmark: a flat two-colour disc, painted on the side towards which its normal points."""

    name: str
    centre_m: tuple[float, float, float]  # cortex frame
    normal: tuple[float, float, float]  # unit vector, cortex frame
    centre_bgr: Bgr
    ring_bgr: Bgr
    centre_diameter_m: float = 0.20
    ring_diameter_m: float = 0.30  # outer

    def outline(self, diameter_m):
        """Corners (CIRCLE_POINTS, 3) [m], cortex frame, of a polygon around the centre with the area of the circle."""
        across, upward = plane_axes(self.normal)
        angles = np.arange(CIRCLE_POINTS) * (2.0 * math.pi / CIRCLE_POINTS)
        radius_m = 0.5 * diameter_m * _CIRCLE_GAIN
        return np.asarray(self.centre_m) + radius_m * (
            np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * upward
        )

    @functools.cached_property
    def _outlines(self):
        return self.outline(self.ring_diameter_m), self.outline(self.centre_diameter_m)

    def sphere(self, _scene):
        return self.centre_m, 0.5 * self.ring_diameter_m

    def layers(self, scene, eye_m):
        ring, centre = self._outlines
        if (eye_m - self.centre_m) @ self.normal <= 0.0:
            return [Layer([ring], bgr_of_hsv(scene.style.disc_backs))]
        return [Layer([ring], self.ring_bgr), Layer([centre], self.centre_bgr, ground_bgr=self.ring_bgr)]


@dataclass(frozen=True)
class Board:
    """A checkerboard for calibration.

    Board axes as OpenCV's: x along the columns to the right, y along the rows down, z into the board, as seen from
    in front of it; the origin is the middle of the inner corners.
    """

    columns: int  # inner corners
    rows: int
    square_m: float
    centre_m: tuple[float, float, float]  # cortex frame
    R_board_to_cortex: np.ndarray  # (3, 3)

    def to_cortex(self, squares):
        """Points (..., 3) [m], cortex frame, of places (..., 2) on the board in squares from its middle."""
        R = np.asarray(self.R_board_to_cortex)
        return np.asarray(self.centre_m) + self.square_m * np.asarray(squares) @ R[:, :2].T

    def sphere(self, scene):
        margin = 1.0 + 2.0 * scene.style.boards.margin_squares
        return self.centre_m, 0.5 * self.square_m * math.hypot(self.columns + margin, self.rows + margin)

    def layers(self, scene, eye_m):
        paints = scene.style.boards
        half = 0.5 * np.array([self.columns + 1, self.rows + 1])
        sheet = self.to_cortex(subdivided(CORNERS * (half + paints.margin_squares)))
        white, black = bgr_of_hsv(paints.white), bgr_of_hsv(paints.black)
        if (self.centre_m - eye_m) @ np.asarray(self.R_board_to_cortex)[:, 2] <= 0.0:  # from behind
            return [Layer([sheet], white)]
        column, row = np.meshgrid(np.arange(self.columns + 1), np.arange(self.rows + 1))
        is_black = (column + row) % 2 == 0
        middles = np.stack((column[is_black], row[is_black]), axis=1) + 0.5 - half
        squares = self.to_cortex(middles[:, None] + subdivided(0.5 * CORNERS))
        return [Layer([sheet], white), Layer(list(squares), black, ground_bgr=white)]


@dataclass(frozen=True)
class Prop:
    """A flat thing of one colour that may stand anywhere; it has the same colour on both sides."""

    outline_m: np.ndarray  # (n, 3) corners, cortex frame
    bgr: Bgr

    def sphere(self, _scene):
        centre_m = self.outline_m.mean(axis=0)
        return centre_m, np.linalg.norm(self.outline_m - centre_m, axis=1).max()

    def layers(self, _scene, _eye_m):
        return [Layer([self.outline_m], self.bgr)]


@dataclass(frozen=True)
class VehiclePose:
    """Where another vehicle is."""

    name: str
    position_m: np.ndarray  # (3,) centre, cortex frame
    R_body_to_cortex: np.ndarray  # (3, 3); body axes: x nose, y right wing, z belly
    colour: int | None = None  # index of the hull; None: that of the scene, else the first

    def sphere(self, scene):
        return self.position_m, scene.style.hulls.radius_m

    def layers(self, scene, eye_m):
        R, centre_m = np.asarray(self.R_body_to_cortex), np.asarray(self.position_m, dtype=float)
        eye = (eye_m - centre_m) @ R  # body axes
        facing = [
            (part, eye - part.middle)
            for part in scene.hull(self)
            if part.normal is None or (eye - part.middle) @ part.normal > 0.0
        ]
        facing.sort(key=lambda entry: -(entry[1] @ entry[1]))
        return [Layer([part.points @ R.T + centre_m], part.bgr, is_solid=True) for part, _ in facing]


class Part(NamedTuple):
    """A convex solid of one colour, body axes. points: (n, 3) whose convex hull it is.

    normal: (3,) of a flat part that is drawn only when it faces the camera; None: drawn from all sides.
    """

    points: np.ndarray
    bgr: Bgr
    middle: np.ndarray  # (3,)
    normal: np.ndarray | None = None


@dataclass(frozen=True)
class CameraPose:
    """Where a camera is in the middle of its exposure, and how it moves meanwhile."""

    position_m: np.ndarray  # (3,) focal point, cortex frame
    R_camera_to_cortex: np.ndarray  # (3, 3); camera axes: x along the optical axis, y right, z down in the picture
    velocity_m_s: np.ndarray = (0.0, 0.0, 0.0)  # cortex frame
    rate_rad_s: np.ndarray = (0.0, 0.0, 0.0)  # camera axes


@dataclass(frozen=True)
class HullColour(Settings):
    """Colours of a vehicle's hull."""

    nose: Hsv
    tail: Hsv


@dataclass(frozen=True)
class HullParams(Settings):
    """Shape of a vehicle's hull, four rotor shrouds around a body, and the available colours."""

    diameter_m: between(0.01, 2.0)  # of a shroud
    offset_m: between(0.01, 2.0)  # of a shroud's centre from the vehicle's, along nose and wing
    height_m: between(0.005, 1.0)
    body: Hsv  # battery and electronics in the middle
    rotors: Hsv  # turning blades inside a shroud
    colours: dict[str, HullColour]

    def __post_init__(self):
        super().__post_init__()
        if not self.colours:
            raise ValueError("'colours' needs one hull at least")

    @property
    def radius_m(self):
        """Radius of the sphere around the vehicle's centre that holds everything."""
        return math.sqrt(2.0) * self.offset_m + 0.5 * self.diameter_m + self.height_m

    @functools.cached_property
    def hulls(self):
        """The hull of each colour: list of Part."""
        return [self._parts(paint) for paint in self.colours.values()]

    def _parts(self, paint):
        angles = np.arange(24) * (2.0 * math.pi / 24)
        circle = np.stack((np.cos(angles), np.sin(angles), np.zeros(24)), axis=1)
        half_m, radius_m = 0.5 * self.height_m, 0.5 * self.diameter_m
        solids = []  # points, colour, normal
        for x, hsv in ((self.offset_m, paint.nose), (-self.offset_m, paint.tail)):
            for y in (-self.offset_m, self.offset_m):
                rim = circle * radius_m + (x, y, 0.0)
                solids.append((np.concatenate((rim + (0.0, 0.0, -half_m), rim + (0.0, 0.0, half_m))), hsv, None))
                for side in (-1.0, 1.0):  # above and below
                    blades = circle * (0.8 * radius_m) + (x, y, side * half_m)
                    solids.append((blades, self.rotors, np.array([0.0, 0.0, side])))
        # the body: three slices of a flat boat
        length_m = self.offset_m + 0.3 * self.diameter_m
        slices = [(0.8, -0.9 * half_m), (1.0, 0.0), (0.8, 1.1 * half_m)]
        body = [circle * (size * length_m * np.array([1.0, 0.42, 1.0])) + (0.0, 0.0, z) for size, z in slices]
        solids.append((np.concatenate(body), self.body, None))
        return [Part(points, bgr_of_hsv(hsv), points.mean(axis=0), normal) for points, hsv, normal in solids]


@dataclass(frozen=True)
class BoardParams(Settings):
    """Paints of checkerboards."""

    white: Hsv
    black: Hsv
    margin_squares: between(0.0, 10.0)  # white margin around the squares


@dataclass(frozen=True)
class Walls(Settings):
    """Front is +x, left is +y."""

    front: Hsv
    back: Hsv
    left: Hsv
    right: Hsv


@dataclass(frozen=True)
class Panel(Settings):
    """A rectangle on a wall or on the floor."""

    surface: Literal["front", "back", "left", "right", "floor"]
    centre_m: tuple[float, float]  # along the wall and up; on the floor x and y
    size_m: tuple[Positive, Positive]
    hsv: Hsv


@dataclass(frozen=True)
class RoomParams(Settings):
    """The room around the arena: four walls, a floor of tiles, a ceiling with lamps, the net, things on the walls."""

    half_x_m: Positive  # with the laboratory's net; in another arena the walls move with the net
    half_y_m: Positive
    height_m: Positive
    tile_m: between(0.1, 100.0)
    floor: Hsv
    floor_tiles: Hsv  # every second tile
    marks: between(0, 2000)  # wear marks on the arena's floor, half of them dark: texture by which a camera sees motion
    mark_m: between(0.001, 1.0)  # length of the largest
    dark_marks: Hsv
    light_marks: Hsv
    ceiling: Hsv
    lamps: Hsv
    lamp_size_m: tuple[Positive, Positive]
    walls: Walls
    skirting: Hsv
    skirting_m: Fraction
    net: Hsv
    net_mesh_m: between(0.05, 10.0)
    posts: Hsv
    post_m: between(0.005, 1.0)
    panels: tuple[Panel, ...] = ()
    shade: Positive = 1.0  # brightness of walls and floor

    def shaded(self, hsv):
        """BGR of the paint of a wall or of the floor."""
        return tuple(min(255.0, self.shade * value) for value in bgr_of_hsv(hsv))


@dataclass(frozen=True)
class ImagingParams(Settings):
    """How a camera takes its picture."""

    exposure_s: between(0.0, 0.1)
    rolling_s: between(0.0, 0.1)  # first row's exposure to the last row's; 0: all rows at once
    defocus_px: between(0.0, 5.0)  # standard deviation of the lens' blur
    vignette: between(0.0, 0.9)  # how much darker the corners are than the middle
    temperature_k: between(2000.0, 20000.0)  # of the light, which the sensor does not correct; 6500: colours as painted
    read_noise: between(0.0, 30.0)  # standard deviation without light [levels]
    shot_noise: between(0.0, 2.0)  # deviation = shot_noise * sqrt(level)


@dataclass(frozen=True)
class Style(Settings):
    """Content of config/scene.yaml: the appearance of what cameras see, not the places of landmarks and vehicles."""

    paints: dict[str, Hsv]  # of landmarks
    disc_backs: Hsv  # landmarks from behind
    hulls: HullParams
    boards: BoardParams
    room: RoomParams
    imaging: ImagingParams

    @functools.cached_property
    def catalogue(self):
        """The laboratory's LandmarkCatalogue."""
        return load_landmark_catalogue()

    def disc(self, template, position_m, normal):
        """Disc of a landmark. Raises ValueError for an unknown landmark or paint."""
        kinds = {kind.name: kind for kind in self.catalogue.landmarks}
        if template not in kinds:
            raise ValueError(
                "landmark %s is not known: add it to risc_lab/config/landmarks.yaml (known: %s)"
                % (template, ", ".join(sorted(kinds)))
            )
        kind, paints = kinds[template], []
        for key in ("centre", "ring"):
            name = getattr(kind, key)
            if name not in self.paints:
                raise ValueError(
                    "landmark %s: '%s' is '%s', which is not among the paints of risc_simulator/config/scene.yaml: %s"
                    % (template, key, name, ", ".join(sorted(self.paints)))
                )
            paints.append(bgr_of_hsv(self.paints[name]))
        discs = self.catalogue.discs
        sizes_m = discs.centre_diameter_m, discs.ring_diameter_m
        return Disc(template, tuple(position_m), tuple(normal), *paints, *sizes_m)


@dataclass(frozen=True)
class Scene:
    """Everything that the cameras see apart from what moves."""

    style: Style
    discs: tuple[Disc, ...] = ()
    arena: Arena = Arena()
    colour_of_vehicle: dict[str, int] = field(default_factory=dict)  # number of the hull, by the vehicle's name
    props: tuple[Prop, ...] = ()

    def hull(self, vehicle):
        """Parts of a VehiclePose."""
        number = self.colour_of_vehicle.get(vehicle.name, 0) if vehicle.colour is None else vehicle.colour
        hulls = self.style.hulls.hulls
        return hulls[number % len(hulls)]


def normal_of_facing(facing_rad):
    """Horizontal unit vector (3,), cortex frame, along a yaw angle as States.psi: + clockwise, 0 = along +x."""
    return math.cos(facing_rad), -math.sin(facing_rad), 0.0


def plane_axes(normal):
    """Two unit vectors (3,), cortex frame: right and up as seen by a viewer at whom the plane's normal points.

    For a horizontal plane, up is +x.
    """
    normal = np.asarray(normal, dtype=float)
    hint = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.999 else np.array([1.0, 0.0, 0.0])
    across = np.cross(hint, normal)
    across /= np.linalg.norm(across)
    return across, np.cross(normal, across)


@functools.lru_cache(256)
def bgr_of_hsv(hsv):
    """BGR of a colour in OpenCV's 8-bit HSV."""
    return tuple(float(x) for x in cv2.cvtColor(np.uint8([[hsv]]), cv2.COLOR_HSV2BGR)[0, 0])


def load_scene(fleet):
    """Scene of a fleet: its landmarks, and a hull for each vehicle in the fleet's order, in a room around its arena.

    fleet: lab.fleet.Fleet. Raises ValueError naming file and key.
    """
    style, usual = load_style(), Arena()
    room = replace(
        style.room,
        half_x_m=style.room.half_x_m + (fleet.arena.half_x_m - usual.half_x_m),
        half_y_m=style.room.half_y_m + (fleet.arena.half_y_m - usual.half_y_m),
        height_m=style.room.height_m + (fleet.arena.height_m - usual.height_m),
    )
    discs = tuple(style.disc(m.name, m.position_m, normal_of_facing(m.facing_rad)) for m in fleet.landmarks)
    colours = {}
    for index, vehicle in enumerate(fleet.vehicles):  # whichever of its names the caller uses
        colours[vehicle.namespace] = colours[vehicle.template] = index
    return Scene(replace(style, room=room), discs, fleet.arena, colours)


def load_style(path=None):
    """Style from a scene file, None = config/scene.yaml. Raises ValueError naming file and key."""
    path = package_file("risc_simulator", "config/scene.yaml") if path is None else path
    style = settings_from(Style, load_yaml(path), str(path))
    if style.room.half_x_m < NET_HALF_X_M or style.room.half_y_m < NET_HALF_Y_M:
        raise ValueError(
            "%s: the room is smaller than the net: make half_x_m %g or more, half_y_m %g"
            % (path, NET_HALF_X_M, NET_HALF_Y_M)
        )
    return style


class RoomLayer(NamedTuple):
    """Static parts of one colour: outlines (n, 3) [m] of polygons, or lines (2, 3)."""

    bgr: Bgr
    outlines: list
    are_lines: bool = False


def room_layers(room, arena):
    """RoomLayers of RoomParams around an Arena, in painter's order."""
    x, y, z = room.half_x_m, room.half_y_m, room.height_m
    floor = _rectangle("floor", (0.0, 0.0), (2.0 * x, 2.0 * y), room)
    layers = [RoomLayer(room.shaded(room.floor), [floor])]
    counts = [int(math.ceil(2.0 * half_m / room.tile_m)) for half_m in (x, y)]
    tiles = []
    for i in range(counts[0]):
        for j in range(i % 2, counts[1], 2):
            x0, y0 = i * room.tile_m - x, j * room.tile_m - y
            x1, y1 = min(x0 + room.tile_m, x), min(y0 + room.tile_m, y)
            tiles.append(np.array([(x0, y0, 0.0), (x1, y0, 0.0), (x1, y1, 0.0), (x0, y1, 0.0)]))
    layers.append(RoomLayer(bgr_of_hsv(room.floor_tiles), tiles))
    marks = _marks(room, arena)
    layers += [RoomLayer(bgr_of_hsv(room.dark_marks), marks[::2]), RoomLayer(bgr_of_hsv(room.light_marks), marks[1::2])]
    layers.append(RoomLayer(bgr_of_hsv(room.ceiling), [floor + (0.0, 0.0, z)]))
    lamps = [
        _rectangle("floor", (u, v), room.lamp_size_m[::-1], room) + (0.0, 0.0, z)
        for u in (-0.6 * x, 0.0, 0.6 * x)
        for v in (-0.5 * y, 0.5 * y)
    ]
    layers.append(RoomLayer(bgr_of_hsv(room.lamps), lamps))
    skirting = []
    for on, hsv in vars(room.walls).items():
        length_m = 2.0 * (y if on in ("front", "back") else x)
        layers.append(RoomLayer(room.shaded(hsv), [_rectangle(on, (0.0, 0.5 * z), (length_m, z), room)]))
        skirting.append(_rectangle(on, (0.0, 0.5 * room.skirting_m), (length_m, room.skirting_m), room))
    layers.append(RoomLayer(bgr_of_hsv(room.skirting), skirting))
    for panel in room.panels:
        outline = _rectangle(panel.surface, panel.centre_m, panel.size_m, room)
        layers.append(RoomLayer(bgr_of_hsv(panel.hsv), [outline]))
    cords, posts = _net(room, arena)
    layers += [RoomLayer(bgr_of_hsv(room.net), cords, are_lines=True), RoomLayer(bgr_of_hsv(room.posts), posts)]
    return [layer for layer in layers if layer.outlines]


def _marks(room, arena):
    """Outlines of the wear marks: always the same, at random places of the arena."""
    rng = np.random.default_rng(0)
    marks = []
    for _ in range(room.marks):
        centre = np.append(rng.uniform(-1.0, 1.0, 2) * (arena.half_x_m, arena.half_y_m), 0.0)
        length_m, angle = rng.uniform(0.3, 1.0) * room.mark_m, rng.uniform(0.0, 3.1)
        along = 0.5 * length_m * np.array([math.cos(angle), math.sin(angle), 0.0])
        across = rng.uniform(0.2, 0.8) * np.array([-along[1], along[0], 0.0])
        marks.append(centre + np.array([-along - across, along - across, along + across, -along + across]))
    return marks


def _net(room, arena):
    """Cords of the net, lines (2, 3) [m] cut into pieces, and its corner posts as outlines."""
    half_x, half_y, top = arena.half_x_m, arena.half_y_m, min(arena.height_m, room.height_m)
    cords, posts = [], []
    for half, side, axis in ((half_y, half_x, 0), (half_x, half_y, 1)):
        across = np.linspace(-half, half, max(2, int(round(2.0 * half / room.net_mesh_m)) + 1))
        upward = np.linspace(0.0, top, max(2, int(round(top / room.net_mesh_m)) + 1))
        for fixed in (-side, side):
            for line in [((u, 0.0), (u, top)) for u in across] + [((-half, v), (half, v)) for v in upward]:
                pieces = subdivided(np.insert(np.array(line), axis, fixed, axis=1), closed=False)
                cords += list(np.stack((pieces[:-1], pieces[1:]), axis=1))
    for x in (-half_x, half_x):
        for y in (-half_y, half_y):
            foot = np.array([x, y, 0.0])
            side = 0.5 * room.post_m / math.hypot(x, y) * np.array([-y, x, 0.0])
            head = foot + (0.0, 0.0, top)
            posts.append(subdivided(np.array([foot - side, foot + side, head + side, head - side])))
    return cords, posts


def _rectangle(on, centre_m, size_m, room):
    """Outline (n, 3) [m] of a rectangle on a surface of the room, long edges cut."""
    axis, value = {
        "front": (0, room.half_x_m),
        "back": (0, -room.half_x_m),
        "left": (1, room.half_y_m),
        "right": (1, -room.half_y_m),
        "floor": (2, 0.0),
    }[on]
    return subdivided(np.insert(np.add(centre_m, 0.5 * CORNERS * size_m), axis, value, axis=1))


def subdivided(outline, closed=True):
    """Outline (n, 2 or 3) with more points on the same edges, so that none is longer than _MAX_EDGE."""
    ends = np.roll(outline, -1, axis=0) if closed else outline[1:]
    points = []
    for start, end in zip(outline, ends):
        count = max(1, int(math.ceil(np.linalg.norm(end - start) / _MAX_EDGE)))
        points.append(start + np.arange(count)[:, None] / count * (end - start))
    return np.concatenate(points if closed else [*points, outline[-1:]])
