"""What the virtual cameras look at: landmark discs, vehicles' hulls, checkerboards and the room around the arena.

Everything is flat polygons in the cortex frame [m] (x forward, y left, z up), or convex solids given by their points.
Colours are BGR 0..255, written as OpenCV HSV in config/scene.yaml.
"""

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import cv2
import numpy as np

from risc_lab.lab.arena import NET_HALF_X_M, NET_HALF_Y_M, Arena
from risc_lab.lab.landmark_catalogue import LandmarkCatalogue, load_landmark_catalogue
from risc_lab.lab.yaml_reader import Section, load_yaml, package_file

CIRCLE_POINTS = 64  # corners of a disc's outline: area and diameter 0.16 % and 0.08 % small, which is mended below
_CIRCLE_GAIN = math.sqrt(2.0 * math.pi / CIRCLE_POINTS / math.sin(2.0 * math.pi / CIRCLE_POINTS))  # for the true area
_MAX_EDGE_M = 0.5  # long edges of the room are cut: a straight line is not straight in a distorted picture
_SURFACES = ("front", "back", "left", "right", "floor")

Bgr = tuple[float, float, float]


@dataclass(frozen=True)
class Disc:
    """A landmark: a flat two-colour disc, painted on the side that its normal points away from."""

    name: str
    centre_m: tuple[float, float, float]  # cortex frame
    normal: tuple[float, float, float]  # unit vector, cortex frame
    centre_bgr: Bgr
    ring_bgr: Bgr
    centre_diameter_m: float = 0.20
    ring_diameter_m: float = 0.30  # outer

    def __post_init__(self):
        if abs(np.linalg.norm(self.normal) - 1.0) > 1e-6:
            raise ValueError("landmark %s: the normal %r must have length 1" % (self.name, tuple(self.normal)))
        if not 0.0 < self.centre_diameter_m < self.ring_diameter_m:
            raise ValueError("landmark %s: needs 0 < centre_diameter_m < ring_diameter_m" % self.name)

    def outline(self, diameter_m):
        """Corners (CIRCLE_POINTS, 3) [m], cortex frame, of a circle around the centre, with a circle's area."""
        across, upward = plane_axes(self.normal)
        angles = np.arange(CIRCLE_POINTS) * (2.0 * math.pi / CIRCLE_POINTS)
        radius_m = 0.5 * diameter_m * _CIRCLE_GAIN
        return np.asarray(self.centre_m) + radius_m * (
            np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * upward
        )


@dataclass(frozen=True)
class Board:
    """A checkerboard for calibration.

    Board axes as OpenCV's: x along the columns to the right, y along the rows down, z into the board, as seen by
    somebody in front of it; the origin is the middle of the inner corners.
    """

    columns: int  # inner corners
    rows: int
    square_m: float
    centre_m: tuple[float, float, float]  # cortex frame
    R_board_to_cortex: np.ndarray  # (3, 3)

    def __post_init__(self):
        if self.columns < 2 or self.rows < 2 or not self.square_m > 0.0:
            raise ValueError(
                "board: needs 2 x 2 inner corners at least and squares of some size, found %d x %d of %r m"
                % (self.columns, self.rows, self.square_m)
            )

    def corners(self):
        """Inner corners (rows * columns, 3) [m], cortex frame, row by row: the order of findChessboardCorners."""
        column, row = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        return self.to_cortex(column.ravel() - 0.5 * (self.columns - 1), row.ravel() - 0.5 * (self.rows - 1))

    def to_cortex(self, x_squares, y_squares):
        """Points (n, 3) [m], cortex frame, of coordinates on the board in squares from its middle."""
        flat = np.stack((x_squares, y_squares, np.zeros_like(x_squares)), axis=-1) * self.square_m
        return np.asarray(self.centre_m) + flat @ np.asarray(self.R_board_to_cortex).T


@dataclass(frozen=True)
class Prop:
    """A flat thing of one colour that may stand anywhere; it has the same colour on both sides."""

    outline_m: np.ndarray  # (n, 3) corners, cortex frame
    bgr: Bgr


@dataclass(frozen=True)
class CameraPose:
    """Where a camera is in the middle of its exposure, and how it moves meanwhile."""

    position_m: np.ndarray  # (3,) focal point, cortex frame
    R_camera_to_cortex: np.ndarray  # (3, 3); camera axes: x along the optical axis, y right, z down in the picture
    velocity_m_s: np.ndarray = (0.0, 0.0, 0.0)  # cortex frame
    rate_rad_s: np.ndarray = (0.0, 0.0, 0.0)  # camera axes


@dataclass(frozen=True)
class VehiclePose:
    """Where another vehicle is."""

    name: str
    position_m: np.ndarray  # (3,) centre, cortex frame
    R_body_to_cortex: np.ndarray  # (3, 3); body axes: x nose, y right wing, z belly
    colour: int | str | None = None  # number or name of the hull; None: as the scene says, else the first


@dataclass(frozen=True)
class HullColour:
    """Colours of a vehicle's hull."""

    name: str
    nose_bgr: Bgr
    tail_bgr: Bgr


class Part(NamedTuple):
    """A convex solid of one colour. points: (n, 3) whose convex hull it is.

    normal: (3,) of a flat part that is drawn only when it faces the camera; None: drawn from all sides.
    """

    points: np.ndarray
    bgr: Bgr
    normal: np.ndarray | None = None

    @property
    def middle(self):
        """(3,) mean of the points."""
        return self.points.mean(axis=0)


@dataclass(frozen=True)
class HullParams:
    """Shape of a vehicle's hull: four rotor shrouds around a body."""

    diameter_m: float = 0.23  # of a shroud
    offset_m: float = 0.135  # of a shroud's centre from the vehicle's, along nose and wing
    height_m: float = 0.07
    body_bgr: Bgr = (45.0, 45.0, 45.0)
    rotor_bgr: Bgr = (70.0, 70.0, 70.0)

    @property
    def radius_m(self):
        """Of the sphere around the vehicle's centre that holds everything."""
        return math.sqrt(2.0) * self.offset_m + 0.5 * self.diameter_m + self.height_m

    def parts(self, colour):
        """List of Part in body axes. colour: HullColour."""
        angles = np.arange(24) * (2.0 * math.pi / 24)
        circle = np.stack((np.cos(angles), np.sin(angles), np.zeros(24)), axis=1)
        half_m, radius_m = 0.5 * self.height_m, 0.5 * self.diameter_m
        parts = []
        for x, bgr in ((self.offset_m, colour.nose_bgr), (-self.offset_m, colour.tail_bgr)):
            for y in (-self.offset_m, self.offset_m):
                rim = circle * radius_m + (x, y, 0.0)
                parts.append(Part(np.concatenate((rim + (0.0, 0.0, -half_m), rim + (0.0, 0.0, half_m))), bgr))
                for side in (-1.0, 1.0):  # above and below
                    blades = circle * (0.8 * radius_m) + (x, y, side * half_m)
                    parts.append(Part(blades, self.rotor_bgr, np.array([0.0, 0.0, side])))
        # the body: three slices of a flat boat
        length_m = self.offset_m + 0.3 * self.diameter_m
        slices = [(0.8, -0.9 * half_m), (1.0, 0.0), (0.8, 1.1 * half_m)]
        body = [circle * (size * length_m * np.array([1.0, 0.42, 1.0])) + (0.0, 0.0, z) for size, z in slices]
        parts.append(Part(np.concatenate(body), self.body_bgr))
        return parts


@dataclass(frozen=True)
class Panel:
    """A rectangle on a wall or on the floor."""

    surface: str  # front, back, left, right, floor
    centre_m: tuple[float, float]  # along the wall and up; on the floor x and y
    size_m: tuple[float, float]
    bgr: Bgr


@dataclass(frozen=True)
class RoomParams:
    """The room around the arena: four walls, a floor of tiles, a ceiling with lamps, the net, things on the walls."""

    half_x_m: float = 4.3
    half_y_m: float = 4.1
    height_m: float = 3.6
    tile_m: float = 0.6
    floor_bgr: Bgr = (118.0, 112.0, 108.0)
    tile_bgr: Bgr = (108.0, 103.0, 100.0)
    marks: int = 0  # wear marks on the arena's floor
    mark_m: float = 0.05  # length of the largest
    dark_mark_bgr: Bgr = (84.0, 80.0, 76.0)
    light_mark_bgr: Bgr = (136.0, 132.0, 128.0)
    ceiling_bgr: Bgr = (195.0, 203.0, 205.0)
    lamp_bgr: Bgr = (246.0, 251.0, 252.0)
    lamp_size_m: tuple[float, float] = (1.2, 0.3)
    wall_bgr: dict[str, Bgr] = field(default_factory=lambda: dict.fromkeys(_SURFACES[:4], (180.0, 186.0, 190.0)))
    skirting_bgr: Bgr = (76.0, 86.0, 90.0)
    skirting_m: float = 0.12
    net_bgr: Bgr = (89.0, 96.0, 89.0)
    net_mesh_m: float = 0.25
    post_bgr: Bgr = (62.0, 62.0, 62.0)
    post_m: float = 0.05
    panels: tuple[Panel, ...] = ()
    net: Arena = Arena()

    def around(self, net):
        """The same room as far around another net."""
        return replace(
            self,
            net=net,
            half_x_m=self.half_x_m + (net.half_x_m - self.net.half_x_m),
            half_y_m=self.half_y_m + (net.half_y_m - self.net.half_y_m),
            height_m=self.height_m + (net.height_m - self.net.height_m),
        )


class Room(NamedTuple):
    """The room as drawn.

    polygons: list of (bgr, list of (n, 3) outlines [m]) in painter's order. cords: (k, 2, 3) ends of the net's cords.
    """

    polygons: list
    cords: np.ndarray
    cord_bgr: Bgr
    posts: list  # as polygons; in front of the cords


@dataclass(frozen=True)
class ImagingParams:
    """How a camera takes its picture."""

    exposure_s: float = 0.012
    rolling_s: float = 0.0  # first row's exposure to the last row's; 0: all rows at once
    defocus_px: float = 0.45  # standard deviation of the lens' blur
    vignette: float = 0.18  # how much darker the corners are than the middle
    temperature_k: float = 6500.0  # of the light that the sensor does not correct; 6500: colours as painted
    read_noise: float = 1.2  # standard deviation without light [levels]
    shot_noise: float = 0.16  # deviation = shot_noise * sqrt(level)

    def __post_init__(self):
        for name, (low, high) in _IMAGING_LIMITS.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError("imaging: %s must be in [%g, %g], found %r" % (name, low, high, value))


_IMAGING_LIMITS = {
    "exposure_s": (0.0, 0.1),
    "rolling_s": (0.0, 0.1),
    "defocus_px": (0.0, 5.0),
    "vignette": (0.0, 0.9),
    "temperature_k": (2000.0, 20000.0),
    "read_noise": (0.0, 30.0),
    "shot_noise": (0.0, 2.0),
}


@dataclass(frozen=True)
class Scene:
    """Everything that the cameras see apart from what moves."""

    discs: tuple[Disc, ...] = ()
    room: RoomParams = field(default_factory=RoomParams)
    hull: HullParams = field(default_factory=HullParams)
    hull_colours: tuple[HullColour, ...] = (HullColour("plain", (40.0, 40.0, 200.0), (40.0, 200.0, 210.0)),)
    colour_of_vehicle: dict[str, int] = field(default_factory=dict)  # hull by the vehicle's name
    props: tuple[Prop, ...] = ()
    disc_back_bgr: Bgr = (120.0, 120.0, 120.0)
    board_white_bgr: Bgr = (225.0, 225.0, 225.0)
    board_black_bgr: Bgr = (25.0, 25.0, 25.0)
    board_margin_squares: float = 1.0

    def hull_colour(self, vehicle):
        """HullColour of a VehiclePose. Raises ValueError for a name that no hull has."""
        colour = vehicle.colour
        if colour is None:
            colour = self.colour_of_vehicle.get(vehicle.name, 0)
        if isinstance(colour, str):
            for hull in self.hull_colours:
                if hull.name == colour:
                    return hull
            names = ", ".join(hull.name for hull in self.hull_colours)
            raise ValueError("vehicle %s: no hull is called '%s'; known are %s" % (vehicle.name, colour, names))
        return self.hull_colours[colour % len(self.hull_colours)]


@dataclass(frozen=True)
class SceneStyle:
    """Content of config/scene.yaml: a scene without landmarks, how paints look, and the imaging; and the landmarks."""

    scene: Scene
    imaging: ImagingParams
    paints: dict[str, Bgr]
    catalogue: LandmarkCatalogue

    def disc(self, template, position_m, normal):
        """Disc of a landmark. Raises ValueError for one that is not known, and for a paint that is not."""
        kinds = {kind.name: kind for kind in self.catalogue.landmarks}
        if template not in kinds:
            raise ValueError(
                "landmark %s is not known: add it to risc_lab/config/landmarks.yaml (known: %s)"
                % (template, ", ".join(sorted(kinds)))
            )
        kind = kinds[template]
        for key in ("centre", "ring"):
            if getattr(kind, key) not in self.paints:
                raise ValueError(
                    "landmark %s: '%s' is '%s', which is not among the paints of risc_simulator/config/scene.yaml: %s"
                    % (template, key, getattr(kind, key), ", ".join(sorted(self.paints)))
                )
        return Disc(
            template,
            tuple(position_m),
            tuple(normal),
            self.paints[kind.centre],
            self.paints[kind.ring],
            self.catalogue.discs.centre_diameter_m,
            self.catalogue.discs.ring_diameter_m,
        )


def normal_of_facing(facing_rad):
    """Unit vector (3,), cortex frame, that looks level along a yaw angle as States.psi: + clockwise, 0 = along +x."""
    return math.cos(facing_rad), -math.sin(facing_rad), 0.0


def plane_axes(normal):
    """Two unit vectors (3,), cortex frame: right and up as seen by somebody whom the plane's normal points at.

    A level plane has no up; then +x serves.
    """
    normal = np.asarray(normal, dtype=float)
    hint = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.999 else np.array([1.0, 0.0, 0.0])
    across = np.cross(hint, normal)
    across /= np.linalg.norm(across)
    return across, np.cross(normal, across)


def bgr_of_hsv(hsv):
    """BGR of a colour in OpenCV's 8-bit HSV."""
    return tuple(float(x) for x in cv2.cvtColor(np.uint8([[hsv]]), cv2.COLOR_HSV2BGR)[0, 0])


def load_scene(fleet, path=None):
    """(Scene, ImagingParams) of a fleet: its landmarks, and a hull for each vehicle in the fleet's order.

    fleet: lab.fleet.Fleet. path: of a scene file, None = config/scene.yaml. Raises ValueError naming file and key.
    """
    style = load_style(path)
    discs = tuple(style.disc(m.name, m.position_m, normal_of_facing(m.facing_rad)) for m in fleet.landmarks)
    colours = {}
    for index, vehicle in enumerate(fleet.vehicles):  # whichever of its names the caller uses
        colours[vehicle.namespace] = colours[vehicle.template] = index
    room = style.scene.room.around(fleet.arena)
    return replace(style.scene, discs=discs, colour_of_vehicle=colours, room=room), style.imaging


def load_style(path=None):
    """SceneStyle from a scene file, None = config/scene.yaml. Raises ValueError naming file and key."""
    if path is None:
        path = package_file("risc_simulator", "config/scene.yaml")
    return style_from_dict(load_yaml(path), str(path))


def style_from_dict(content, where="scene"):
    """SceneStyle from the content of a scene file. Raises ValueError naming the key."""
    root = Section(content, where)
    paints_section = root.section("paints")
    paints = {name: _colour(paints_section, name, where) for name in paints_section.keys()}
    discs = root.section("discs")
    hulls, boards = root.section("hulls"), root.section("boards")
    style = SceneStyle(
        scene=Scene(
            room=_room(root.section("room"), where),
            hull=HullParams(
                diameter_m=hulls.number("diameter_m", minimum=0.01, maximum=2.0),
                offset_m=hulls.number("offset_m", minimum=0.01, maximum=2.0),
                height_m=hulls.number("height_m", minimum=0.005, maximum=1.0),
                body_bgr=_colour(hulls, "body", where),
                rotor_bgr=_colour(hulls, "rotors", where),
            ),
            hull_colours=_hull_colours(hulls.section("colours"), where),
            disc_back_bgr=_colour(discs, "back", where),
            board_white_bgr=_colour(boards, "white", where),
            board_black_bgr=_colour(boards, "black", where),
            board_margin_squares=boards.number("margin_squares", minimum=0.0, maximum=10.0),
        ),
        imaging=_imaging(root.section("imaging"), where),
        paints=paints,
        catalogue=load_landmark_catalogue(),
    )
    for section in (discs, hulls, boards, root):
        section.done()
    return style


def room_geometry(room):
    """Room of RoomParams: all that never moves, as polygons and lines."""
    x, y, z = room.half_x_m, room.half_y_m, room.height_m
    floor = _rectangle("floor", (0.0, 0.0), (2.0 * x, 2.0 * y), room)
    polygons = [(room.floor_bgr, [floor])]
    counts = [int(math.ceil(2.0 * half_m / room.tile_m)) for half_m in (x, y)]
    tiles = []
    for i in range(counts[0]):
        for j in range(i % 2, counts[1], 2):
            x0, y0 = i * room.tile_m - x, j * room.tile_m - y
            x1, y1 = min(x0 + room.tile_m, x), min(y0 + room.tile_m, y)
            tiles.append(np.array([(x0, y0, 0.0), (x1, y0, 0.0), (x1, y1, 0.0), (x0, y1, 0.0)]))
    polygons.append((room.tile_bgr, tiles))
    marks = _marks(room)
    polygons += [(room.dark_mark_bgr, marks[::2]), (room.light_mark_bgr, marks[1::2])]
    polygons.append((room.ceiling_bgr, [floor + (0.0, 0.0, z)]))
    width_m, depth_m = room.lamp_size_m
    lamps = [
        floor_rectangle + (0.0, 0.0, z)
        for u in (-0.6 * x, 0.0, 0.6 * x)
        for v in (-0.5 * y, 0.5 * y)
        for floor_rectangle in [_rectangle("floor", (u, v), (depth_m, width_m), room)]
    ]
    polygons.append((room.lamp_bgr, lamps))
    skirting = []
    for on in _SURFACES[:4]:
        length_m = 2.0 * (y if on in ("front", "back") else x)
        polygons.append((room.wall_bgr[on], [_rectangle(on, (0.0, 0.5 * z), (length_m, z), room)]))
        skirting.append(_rectangle(on, (0.0, 0.5 * room.skirting_m), (length_m, room.skirting_m), room))
    polygons.append((room.skirting_bgr, skirting))
    polygons += [(panel.bgr, [_rectangle(panel.surface, panel.centre_m, panel.size_m, room)]) for panel in room.panels]
    cords, posts = _net(room)
    return Room(polygons, cords, room.net_bgr, [(room.post_bgr, posts)])


def board_layers(board, scene):
    """[(bgr, outlines)] of a Board's front in painter's order; outlines: list of (n, 3) [m], cortex frame."""
    half_x, half_y = 0.5 * (board.columns + 1), 0.5 * (board.rows + 1)
    margin = scene.board_margin_squares
    sheet = _unit_square(2.0 * (half_x + margin), 2.0 * (half_y + margin), 12)
    white = board.to_cortex(sheet[:, 0], sheet[:, 1])
    square = _unit_square(1.0, 1.0, 2)
    column, row = np.meshgrid(np.arange(board.columns + 1), np.arange(board.rows + 1))
    is_black = (column + row) % 2 == 0
    middles = np.stack((column[is_black] + 0.5 - half_x, row[is_black] + 0.5 - half_y), axis=1)
    corners = (middles[:, None] + square).reshape(-1, 2)
    black = np.split(board.to_cortex(corners[:, 0], corners[:, 1]), len(middles))
    return [(scene.board_white_bgr, [white]), (scene.board_black_bgr, black)]


def _marks(room):
    """Outlines of the wear marks: always the same, at random places of the arena."""
    rng = np.random.default_rng(0)
    half_m = (room.net.half_x_m, room.net.half_y_m)
    marks = []
    for _ in range(room.marks):
        (x, y), length_m, angle = (
            rng.uniform(-1.0, 1.0, 2) * half_m,
            rng.uniform(0.3, 1.0) * room.mark_m,
            rng.uniform(0.0, 3.1),
        )
        along = 0.5 * length_m * np.array([math.cos(angle), math.sin(angle), 0.0])
        across = rng.uniform(0.2, 0.8) * np.array([-along[1], along[0], 0.0])
        centre = np.array([x, y, 0.0])
        marks.append(centre + np.array([-along - across, along - across, along + across, -along + across]))
    return marks


def _net(room):
    """Cords (k, 2, 3) [m] of the net, cut into pieces, and its corner posts as outlines."""
    half_x, half_y, top = room.net.half_x_m, room.net.half_y_m, min(room.net.height_m, room.height_m)
    ends = []
    for half, side, axis in ((half_y, half_x, 0), (half_x, half_y, 1)):
        across = np.linspace(-half, half, max(2, int(round(2.0 * half / room.net_mesh_m)) + 1))
        upward = np.linspace(0.0, top, max(2, int(round(top / room.net_mesh_m)) + 1))
        for fixed in (-side, side):
            plane = [((u, 0.0), (u, top)) for u in across] + [((-half, v), (half, v)) for v in upward]
            for a, b in plane:
                line = [(fixed, u, v) if axis == 0 else (u, fixed, v) for u, v in (a, b)]
                pieces = subdivided(np.array(line), closed=False)
                ends.append(np.stack((pieces[:-1], pieces[1:]), axis=1))
    posts = []
    for x in (-half_x, half_x):
        for y in (-half_y, half_y):
            radius = math.hypot(x, y)
            side = np.array([-y, x, 0.0]) / radius * 0.5 * room.post_m
            foot = np.array([x, y, 0.0])
            head = foot + (0.0, 0.0, top)
            posts.append(subdivided(np.array([foot - side, foot + side, head + side, head - side])))
    return np.concatenate(ends), posts


def _rectangle(on, centre_m, size_m, room):
    """Outline (n, 3) [m] of a rectangle on a surface of the room, long edges cut."""
    (u, v), (half_u, half_v) = centre_m, (0.5 * size_m[0], 0.5 * size_m[1])
    corners = [(u - half_u, v - half_v), (u + half_u, v - half_v), (u + half_u, v + half_v), (u - half_u, v + half_v)]
    place = {
        "front": lambda a, b: (room.half_x_m, a, b),
        "back": lambda a, b: (-room.half_x_m, a, b),
        "left": lambda a, b: (a, room.half_y_m, b),
        "right": lambda a, b: (a, -room.half_y_m, b),
        "floor": lambda a, b: (a, b, 0.0),
    }[on]
    return subdivided(np.array([place(a, b) for a, b in corners]))


def subdivided(outline_m, closed=True):
    """Outline (n, 3) with more points on the same edges, so that none is longer than _MAX_EDGE_M."""
    ends = np.roll(outline_m, -1, axis=0) if closed else outline_m[1:]
    starts = outline_m if closed else outline_m[:-1]
    points = []
    for start, end in zip(starts, ends):
        count = max(1, int(math.ceil(np.linalg.norm(end - start) / _MAX_EDGE_M)))
        points.append(start + np.arange(count)[:, None] / count * (end - start))
    if not closed:
        points.append(outline_m[-1:])
    return np.concatenate(points)


def _unit_square(width, height, cuts):
    """Outline (4 * cuts, 2) of a rectangle around the origin, each edge cut."""
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * (width, height)
    ends = np.roll(corners, -1, axis=0)
    share = np.arange(cuts)[:, None] / cuts
    return np.concatenate([a + share * (b - a) for a, b in zip(corners, ends)])


def _colour(section, key, where):
    hsv = section.vector(key, 3)
    if not (0.0 <= hsv[0] < 180.0 and 0.0 <= hsv[1] <= 255.0 and 0.0 <= hsv[2] <= 255.0):
        raise ValueError(
            "%s: colour '%s' must be OpenCV HSV (hue 0..179, saturation and value 0..255), found %r"
            % (where, key, list(hsv))
        )
    return bgr_of_hsv(hsv)


def _hull_colours(section, where):
    hulls = []
    for name in section.keys():
        colours = section.section(name)
        hulls.append(HullColour(name, _colour(colours, "nose", where), _colour(colours, "tail", where)))
        colours.done()
    if not hulls:
        raise ValueError("%s, hulls: 'colours' needs one hull at least" % where)
    return tuple(hulls)


def _room(section, where):
    walls = section.section("walls")
    room = RoomParams(
        half_x_m=section.number("half_x_m", minimum=NET_HALF_X_M, maximum=100.0),
        half_y_m=section.number("half_y_m", minimum=NET_HALF_Y_M, maximum=100.0),
        height_m=section.number("height_m", minimum=1.0, maximum=100.0),
        tile_m=section.number("tile_m", minimum=0.1, maximum=100.0),
        floor_bgr=_colour(section, "floor", where),
        tile_bgr=_colour(section, "floor_tiles", where),
        marks=_whole(section, "marks", where, 2000),
        mark_m=section.number("mark_m", minimum=0.001, maximum=1.0),
        dark_mark_bgr=_colour(section, "dark_marks", where),
        light_mark_bgr=_colour(section, "light_marks", where),
        ceiling_bgr=_colour(section, "ceiling", where),
        lamp_bgr=_colour(section, "lamps", where),
        lamp_size_m=section.vector("lamp_size_m", 2),
        wall_bgr={on: _colour(walls, on, where) for on in _SURFACES[:4]},
        skirting_bgr=_colour(section, "skirting", where),
        skirting_m=section.number("skirting_m", minimum=0.0, maximum=1.0),
        net_bgr=_colour(section, "net", where),
        net_mesh_m=section.number("net_mesh_m", minimum=0.05, maximum=10.0),
        post_bgr=_colour(section, "posts", where),
        post_m=section.number("post_m", minimum=0.005, maximum=1.0),
        panels=tuple(_panel(panel, where) for panel in section.sections("panels", ())),
    )
    walls.done()
    section.done()
    return room


def _whole(section, key, where, maximum):
    value = section.number(key, minimum=0, maximum=maximum)
    if value != int(value):
        raise ValueError("%s: '%s' must be a whole number, found %r" % (where, key, value))
    return int(value)


def _panel(section, where):
    surface = section.text("surface")
    if surface not in _SURFACES:
        known = ", ".join(_SURFACES)
        raise ValueError("%s, panels: 'surface' must be one of %s, found '%s'" % (where, known, surface))
    panel = Panel(surface, section.vector("centre_m", 2), section.vector("size_m", 2), _colour(section, "hsv", where))
    section.done()
    if min(panel.size_m) <= 0.0:
        raise ValueError("%s, panels: 'size_m' must be positive, found %r" % (where, list(panel.size_m)))
    return panel


def _imaging(section, where):
    values = {name: section.number(name, minimum=low, maximum=high) for name, (low, high) in _IMAGING_LIMITS.items()}
    section.done()
    return ImagingParams(**values)
