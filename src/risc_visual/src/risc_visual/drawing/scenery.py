"""What is drawn around the vehicles: net, floor numbers, motion capture cameras. Frame: cortex. Needs no ROS."""

import math
from dataclasses import dataclass, replace

import numpy as np

from risc_lab.lab.arena import Arena
from risc_lab.lab.yaml_reader import Section, load_yaml, package_file


@dataclass(frozen=True)
class Net(Arena):
    """The net of an Arena, as it is drawn."""

    thickness_m: float = 0.01  # of its panels

    def walls(self):
        """The four panels: list of (centre (3,) [m], size (3,) [m])."""
        x, y, z, t = self.half_x_m, self.half_y_m, self.height_m, self.thickness_m
        panel_x, panel_y = (t, 2.0 * y, z), (2.0 * x, t, z)
        return [
            ((x, 0.0, z / 2), panel_x),
            ((-x, 0.0, z / 2), panel_x),
            ((0.0, y, z / 2), panel_y),
            ((0.0, -y, z / 2), panel_y),
        ]

    def edges(self):
        """The box' twelve edges: (24, 3) [m], start and end in turn."""
        x, y, z = self.half_x_m, self.half_y_m, self.height_m
        corners = [(x, y), (-x, y), (-x, -y), (x, -y)]
        ends = []
        for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1]):
            ends += [(x0, y0, 0.0), (x1, y1, 0.0), (x0, y0, z), (x1, y1, z), (x0, y0, 0.0), (x0, y0, z)]
        return np.array(ends)


@dataclass(frozen=True)
class Grid:
    """Numbers along two edges of the floor."""

    from_m: float
    to_m: float
    step_m: float
    edge_m: float
    caption_m: float
    text_height_m: float

    def labels(self):
        """List of (text, position (3,) [m]): the numbers of x, those of y, then the names of the axes."""
        count = int(round((self.to_m - self.from_m) / self.step_m)) + 1
        values = [self.to_m - k * self.step_m for k in range(count)]
        along_x = [("%.1f" % value, (value, self.edge_m, 0.0)) for value in values]
        along_y = [("%.1f" % value, (self.edge_m, value, 0.0)) for value in values]
        return along_x + along_y + [("X (m)", (0.0, self.caption_m, 0.0)), ("Y (m)", (self.caption_m, 0.0, 0.0))]


@dataclass(frozen=True)
class Camera:
    """A motion capture camera and where it looks."""

    position_m: tuple[float, float, float]
    heading_rad: float  # of the optical axis in plan: 0 = along +y, + clockwise from above
    tilt_rad: float  # of the optical axis below the horizon

    def rotation_to_cortex(self):
        """(3, 3) rotation from camera axes (x along the optical axis, y left, z up) to cortex axes."""
        sin_h, cos_h, sin_t, cos_t = (
            np.sin(self.heading_rad),
            np.cos(self.heading_rad),
            np.sin(self.tilt_rad),
            np.cos(self.tilt_rad),
        )
        ahead = (cos_t * sin_h, cos_t * cos_h, -sin_t)
        left = (-cos_h, sin_h, 0.0)
        return np.column_stack([ahead, left, np.cross(ahead, left)])


@dataclass(frozen=True)
class Scenery:
    """Everything about the laboratory that never moves."""

    net: Net
    grid: Grid
    cameras: tuple[Camera, ...]

    def around(self, arena):
        """The same laboratory as far around another Arena."""
        further = np.array([arena.half_x_m - self.net.half_x_m, arena.half_y_m - self.net.half_y_m, 0.0])
        out_m = self.grid.step_m * math.ceil(max(further) / self.grid.step_m - 1e-9)
        cameras = [
            replace(camera, position_m=tuple((camera.position_m + np.sign(camera.position_m) * further).tolist()))
            for camera in self.cameras
        ]
        grid = {key: getattr(self.grid, key) + out_m for key in ("to_m", "edge_m", "caption_m")}
        return Scenery(
            replace(self.net, **vars(arena)),
            replace(self.grid, from_m=self.grid.from_m - out_m, **grid),
            tuple(cameras),
        )


def load_scenery(path=None):
    """Scenery from `path` or from this package's config/arena.yaml. Raises ValueError naming file and key."""
    if path is None:
        path = package_file("risc_visual", "config/arena.yaml")
    return scenery_from_dict(load_yaml(path), str(path))


def scenery_from_dict(content, where="arena file"):
    """Scenery from the content of its YAML file. Raises ValueError naming the key."""
    root = Section(content, where)
    net, grid, cameras = root.section("net"), root.section("grid"), root.section("cameras")
    tilt_rad = np.radians(cameras.number("tilt_deg", minimum=-90.0, maximum=90.0))
    scenery = Scenery(
        net=net.settings(Net),
        grid=Grid(**{key: grid.number(key) for key in Grid.__dataclass_fields__}),
        cameras=tuple(_camera(section, tilt_rad) for section in cameras.sections("poses", ())),
    )
    for section in (grid, cameras, root):
        section.done()
    if scenery.grid.step_m <= 0.0 or scenery.grid.to_m < scenery.grid.from_m or scenery.grid.text_height_m <= 0.0:
        raise ValueError("%s, grid: needs step_m > 0, text_height_m > 0 and to_m >= from_m" % where)
    return scenery


def _camera(section, tilt_rad):
    camera = Camera(section.vector("position_m", 3), np.radians(section.number("heading_deg")), tilt_rad)
    section.done()
    return camera
