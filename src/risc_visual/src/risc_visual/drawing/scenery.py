"""What is drawn around the vehicles: net, floor numbers, motion capture cameras. Frame: cortex. Needs no ROS."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from risc_lab.lab.arena import Arena
from risc_lab.lab.yaml_reader import load_yaml, package_file
from risc_lab.settings import Positive, Settings, Vector, between, settings_from


@dataclass(frozen=True)
class Net(Arena):
    """The net of an Arena, as it is drawn."""

    thickness_m: Positive = 0.01  # of its panels: as thick as the cords look

    def walls(self):
        """The four panels: list of (centre (3,) [m], size (3,) [m])."""
        x, y, z, t = self.half_x_m, self.half_y_m, self.height_m, self.thickness_m
        across_x = [((side * x, 0.0, z / 2), (t, 2.0 * y, z)) for side in (1.0, -1.0)]
        return across_x + [((0.0, side * y, z / 2), (2.0 * x, t, z)) for side in (1.0, -1.0)]

    def edges(self):
        """The box' twelve edges: (24, 3) [m], start and end in turn."""
        x, y, z = self.half_x_m, self.half_y_m, self.height_m
        corners = [(x, y), (-x, y), (-x, -y), (x, -y)]
        ends = []
        for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1]):
            ends += [(x0, y0, 0.0), (x1, y1, 0.0), (x0, y0, z), (x1, y1, z), (x0, y0, 0.0), (x0, y0, z)]
        return np.array(ends)


@dataclass(frozen=True)
class Grid(Settings):
    """Numbers along two edges of the floor, outside of the net, on the sides from which the saved views look."""

    step_m: Positive = 0.5
    outside_m: Positive = 0.5  # of the net
    text_height_m: Positive = 0.2

    def labels(self, net):
        """List of (text, position (3,) [m]): the numbers of x, those of y, then the names of the axes."""
        y, x = net.half_y_m + self.outside_m, -net.half_x_m - self.outside_m
        along_x = [("%.1f" % value, (value, y, 0.0)) for value in self._values(net.half_x_m)]
        along_y = [("%.1f" % value, (x, value, 0.0)) for value in self._values(net.half_y_m)]
        return along_x + along_y + [("X (m)", (net.half_x_m + 0.1, y, 0.0)), ("Y (m)", (x - 0.5, 0.0, 0.0))]

    def _values(self, half_m):
        count = int(half_m / self.step_m + 1e-9)
        return [k * self.step_m for k in range(count, -count - 1, -1)]


@dataclass(frozen=True)
class CameraPose(Settings):
    """Where a motion capture camera is, and where it looks."""

    position_m: Vector
    heading_deg: float  # of the optical axis in plan: 0 = along +y, + clockwise from above


@dataclass(frozen=True)
class Cameras(Settings):
    """All motion capture cameras."""

    tilt_deg: between(-90.0, 90.0)  # of the optical axes below the horizon
    poses: tuple[CameraPose, ...] = ()

    def turns(self):
        """List of Rotations from camera axes (x along the optical axis, y left, z up) to cortex axes."""
        return [Rotation.from_euler("ZY", (90.0 - pose.heading_deg, self.tilt_deg), True) for pose in self.poses]


@dataclass(frozen=True)
class Scenery(Settings):
    """Everything about the laboratory that never moves."""

    net: Net
    grid: Grid
    cameras: Cameras

    def around(self, arena):
        """The same laboratory with another Arena: the cameras keep their distance from the net."""
        out_m = np.array([arena.half_x_m - self.net.half_x_m, arena.half_y_m - self.net.half_y_m, 0.0])
        poses = tuple(
            replace(pose, position_m=tuple((pose.position_m + np.sign(pose.position_m) * out_m).tolist()))
            for pose in self.cameras.poses
        )
        return replace(self, net=replace(self.net, **vars(arena)), cameras=replace(self.cameras, poses=poses))


def load_scenery(path=None):
    """Scenery from `path` or from this package's config/arena.yaml. Raises ValueError naming file and key."""
    path = path or package_file("risc_visual", "config/arena.yaml")
    return settings_from(Scenery, load_yaml(path), str(path))
