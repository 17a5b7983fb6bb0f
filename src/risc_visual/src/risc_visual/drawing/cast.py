"""Who is in the picture: names, colours, shapes, and what to show of a vehicle that is lost. Needs no ROS."""

import math
import threading
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from risc_lab.frames import rotation_body_to_cortex
from risc_visual.drawing.airframes import AIRFRAMES, DEFAULT_AIRFRAME, vehicle_colour

REST_M_S = 0.01  # a reference slower than this stands still
ROD_MAX_M = 1.5  # a pendulum tip farther than this from every vehicle stands on none


@dataclass(frozen=True)
class Pose:
    """A vehicle as motion capture knows it now. Frame: cortex; angles in the NED sense."""

    name: str
    visible: bool
    position_m: tuple[float, float, float]
    euler_rad: tuple[float, float, float]  # phi, theta, psi


@dataclass(frozen=True)
class View:
    """A vehicle as it is to be drawn. Frame: cortex."""

    name: str
    index: int
    position_m: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]  # x, y, z, w; body axes (x nose, y right, z belly) to cortex
    places_m: list[list[float]]  # of the parts' centres
    parts: tuple  # of airframes.Part
    colour: tuple[float, float, float]
    lost: bool  # where it was last seen


class Index:
    """A number for every name, the same as long as the program runs; so ids and colours never change hands."""

    def __init__(self, names=()):
        self._lock = threading.Lock()  # topics that are drawn in threads of their own share one index
        self._numbers = {}
        for name in names:
            self[name]

    def __getitem__(self, name):
        with self._lock:
            return self._numbers.setdefault(name, len(self._numbers))


class Cast:
    """The vehicles of the picture; remembers where each was last seen."""

    def __init__(self, index, airframe_of=None):
        """airframe_of: dict name -> type of vehicle; others are drawn as the default type."""
        self._index = index
        self._airframe_of = airframe_of or {}
        self._last = {}

    def views(self, poses):
        """List of `View` of those seen now or before; one that never was seen has no place to be drawn at.

        A pose with a number that is not finite counts as not seen.
        """
        seen = [pose for pose in poses if pose.visible and np.isfinite(pose.position_m + pose.euler_rad).all()]
        if seen:
            rotations = rotation_body_to_cortex(*np.array([pose.euler_rad for pose in seen]).T)
            quaternions = Rotation.from_matrix(rotations).as_quat().tolist()
            for pose, rotation, quaternion in zip(seen, rotations, quaternions):
                places_m = [part.centre_m for part in self._parts(pose.name)] @ rotation.T + pose.position_m
                self._last[pose.name] = pose.position_m, tuple(quaternion), places_m.tolist()
        now = {pose.name for pose in seen}
        return [self._view(pose.name, pose.name not in now) for pose in poses if pose.name in self._last]

    def _parts(self, name):
        return AIRFRAMES.get(self._airframe_of.get(name), AIRFRAMES[DEFAULT_AIRFRAME])

    def _view(self, name, lost):
        index = self._index[name]
        return View(name, index, *self._last[name], self._parts(name), vehicle_colour(index), lost)


def rod_foot(tip_m, views):
    """Position [m] of the vehicle that carries the pendulum whose tip is at tip_m: the nearest one; None if none is."""
    if not views:
        return None
    distances_m = np.linalg.norm([np.subtract(view.position_m, tip_m) for view in views], axis=1)
    nearest = int(np.argmin(distances_m))
    return views[nearest].position_m if distances_m[nearest] <= ROD_MAX_M else None


def is_news(said_s, now_s, lifetime_s):
    """Whether what was said then is still true. Times [s] of ROS, by which rviz lets markers expire: so it is as true
    in a bag that is played slowly. What was said long after now belongs to a bag that has begun again.
    """
    return abs(now_s - said_s) < lifetime_s


def reference_marks(references_m, speeds_m_s, positions_m, vehicles, away_m):
    """Which references deserve a mark of their own: those that stand still, and those their vehicle is not at.

    references_m, positions_m: dicts name -> position (3,) [m] of references and of the vehicles that are seen;
    speeds_m_s: dict name -> speed of the reference; vehicles: names of all vehicles. Returns a list of (name, away):
    away when the vehicle is farther than away_m, or not seen.
    """
    marks = []
    for name, reference_m in references_m.items():
        away = False
        if name in vehicles:  # the original release puts a title there, which is nowhere
            away = name not in positions_m or math.dist(positions_m[name], reference_m) > away_m
        if away or speeds_m_s[name] < REST_M_S:
            marks.append((name, away))
    return marks


def title_text(title, phases):
    """Text over the arena: the title, then what the vehicles do, in one word if they all do the same.

    phases: dict name -> phase.
    """
    lines = [title] if title else []
    if len(phases) > 1 and len(set(phases.values())) == 1:
        lines.append(next(iter(phases.values())))
    else:
        lines += ["%s: %s" % item for item in phases.items()]
    return "\n".join(lines)
