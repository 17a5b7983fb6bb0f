"""What rviz would show: markers kept as its displays keep them, and what has changed since it was asked last. No ROS.

The scene is a tree: `/topic/ns` is a group that has a pose in the fixed frame, `/topic/ns/id` a marker that has a pose
in its group. A group's pose is that of its first marker, so that of a vehicle that flies only the group moves, not
every part of it. Times are seconds of a clock that never steps; frames are named as in tf.
"""

import enum
import threading
from dataclasses import dataclass
from urllib.parse import quote

FIXED_FRAME = "cortex"
_SAME_M = 1e-5  # positions nearer than this are the same
_SAME_TURN = 1e-9  # and so are quaternions whose product differs from 1 by less: 0.005 degrees
_WAITS_S = 1.0  # for the pose of a marker's frame; later it would be drawn where it was, not where it is


class Shape(enum.IntEnum):
    """`type` of visualization_msgs/Marker."""

    ARROW = 0
    CUBE = 1
    SPHERE = 2
    CYLINDER = 3
    LINE_STRIP = 4
    LINE_LIST = 5
    CUBE_LIST = 6
    SPHERE_LIST = 7
    POINTS = 8
    TEXT = 9
    MESH = 10
    TRIANGLES = 11


class Action(enum.IntEnum):
    """`action` of visualization_msgs/Marker."""

    ADD = 0
    DELETE = 2
    DELETE_ALL = 3


@dataclass(frozen=True)
class Placement:
    """Position [m] and orientation of something in the frame above it."""

    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)  # x, y, z, w; turns its axes into those above

    def of(self, inner):
        """Placement of something (`inner`, placed in this frame) in the frame above this one."""
        x, y, z = _turned(self.quaternion, inner.position_m)
        a, b, c = self.position_m
        return Placement((a + x, b + y, c + z), _product(self.quaternion, inner.quaternion))

    def seen_from(self, base):
        """This placement in the frame that `base` is, both being given in the same frame."""
        x, y, z, w = base.quaternion
        back = (-x, -y, -z, w)
        apart = tuple(mine - other for mine, other in zip(self.position_m, base.position_m))
        return Placement(_turned(back, apart), _product(back, self.quaternion))

    def is_near(self, other):
        """True when nobody could see the difference."""
        if any(abs(a - b) > _SAME_M for a, b in zip(self.position_m, other.position_m)):
            return False
        return abs(sum(a * b for a, b in zip(self.quaternion, other.quaternion))) > 1.0 - _SAME_TURN


HERE = Placement()


@dataclass(frozen=True)
class Look:
    """Everything about a marker but where it is. Sizes as visualization_msgs/Marker.scale means them for the shape."""

    shape: Shape
    size_m: tuple[float, float, float]
    rgba: tuple[float, float, float, float]
    points_m: tuple[tuple[float, float, float], ...] = ()
    colours: tuple[tuple[float, float, float, float], ...] = ()  # of the points; none = rgba
    text: str = ""


@dataclass(frozen=True)
class MarkerValue:
    """One marker of a message."""

    ns: str
    marker_id: int
    action: Action
    look: Look
    placement: Placement  # in `frame`
    frame: str = FIXED_FRAME
    stamp_s: float = 0.0  # ROS time that the placement holds at; 0 = the newest known
    lifetime_s: float = 0.0  # 0 = for ever


@dataclass(frozen=True)
class Draw:
    """A marker is new, or looks different now."""

    path: str
    look: Look
    placement: Placement  # in its group


@dataclass(frozen=True)
class Move:
    """A group (in the fixed frame) or a marker (in its group) is elsewhere. A group's first move is its beginning."""

    path: str
    placement: Placement


@dataclass(frozen=True)
class Erase:
    """A marker or a group is gone; a group after all its markers."""

    path: str


class MarkerScene:
    """Markers by topic, ns and id. Topics may be noted in several threads."""

    def __init__(self, fixed_frame=FIXED_FRAME):
        self._fixed_frame = fixed_frame
        self._lock = threading.Lock()
        self._groups = {}  # (topic, ns) -> _Group

    def note(self, topic, markers, now_s):
        """A message came in: its `MarkerValue`s, in their order."""
        with self._lock:
            for marker in markers:
                if marker.action == Action.DELETE_ALL:
                    for key, group in self._groups.items():
                        if key[0] == topic:
                            group.end_all()
                    continue
                key = (topic, marker.ns)
                if marker.action == Action.DELETE:
                    if key in self._groups:
                        self._groups[key].end(marker.marker_id)
                    continue
                if key not in self._groups:
                    self._groups[key] = _Group("/%s/%s" % (_name(topic.strip("/")), _name(marker.ns)))
                self._groups[key].put(marker, now_s)

    def changes(self, now_s, lookup):
        """What is to be done to what was drawn: `Draw`, `Move` and `Erase` in the order to do them.

        lookup(frame, stamp_s): `Placement` of a frame in the fixed frame, None if that is not known (yet). A marker
        that waits for its frame is not drawn, and after a second it is forgotten.
        """
        with self._lock:
            found = []
            for key, group in list(self._groups.items()):
                group.expire(now_s)
                if group.touched:
                    found += group.changes(now_s, lambda marker: self._in_fixed_frame(marker, lookup))
                if group.is_empty():
                    del self._groups[key]
            return found

    def forget(self):
        """Begin anew: nothing is kept, nothing counts as drawn."""
        with self._lock:
            self._groups.clear()

    def _in_fixed_frame(self, marker, lookup):
        if marker.frame == self._fixed_frame:
            return marker.placement
        frame = lookup(marker.frame, marker.stamp_s)
        return None if frame is None else frame.of(marker.placement)


class _Member:
    """One marker: what was said of it last, and what was drawn of it."""

    def __init__(self):
        self.marker = None
        self.waits_since_s = None  # [s] for the pose of its frame; None = it is placed
        self.ends_s = None  # [s] end of its life; None = none
        self.placement = None  # in the fixed frame
        self.look = None  # that it has there
        self.drawn = None  # (Look, Placement in the group)


class _Group:
    """The markers of a topic and a namespace."""

    def __init__(self, path):
        self.touched = False
        self._path = path
        self._members = {}
        self._erased = []
        self._placement = None  # as drawn

    def put(self, marker, now_s):
        self.touched = True
        member = self._members.setdefault(marker.marker_id, _Member())
        member.marker = marker
        if member.waits_since_s is None:
            member.waits_since_s = now_s
        member.ends_s = now_s + marker.lifetime_s if marker.lifetime_s > 0.0 else None

    def end(self, marker_id):
        member = self._members.pop(marker_id, None)
        if member is not None:
            self.touched = True
            if member.drawn is not None:
                self._erased.append(Erase("%s/%d" % (self._path, marker_id)))

    def end_all(self):
        for marker_id in list(self._members):
            self.end(marker_id)

    def expire(self, now_s):
        for marker_id, member in list(self._members.items()):
            if member.ends_s is not None and now_s >= member.ends_s:
                self.end(marker_id)

    def is_empty(self):
        return not self._members

    def changes(self, now_s, in_fixed_frame):
        """What is to be done; in_fixed_frame: `MarkerValue` -> Placement or None."""
        self.touched = False
        for marker_id, member in list(self._members.items()):
            if member.waits_since_s is None:
                continue
            placement = in_fixed_frame(member.marker)
            if placement is not None:
                member.placement, member.look, member.waits_since_s = placement, member.marker.look, None
            elif now_s - member.waits_since_s > _WAITS_S:
                self.end(marker_id)
            else:
                self.touched = True
        found, self._erased = self._erased, []
        placed = sorted((marker_id, m) for marker_id, m in self._members.items() if m.placement is not None)
        if not placed:
            if self._placement is not None and not self._members:
                found.append(Erase(self._path))
            return found
        anchor = placed[0][1].placement
        if self._placement is None or not anchor.is_near(self._placement):
            self._placement = anchor
            found.append(Move(self._path, anchor))
        for marker_id, member in placed:
            own = member.placement.seen_from(self._placement)
            path = "%s/%d" % (self._path, marker_id)
            if member.drawn is None or member.drawn[0] != member.look:
                found.append(Draw(path, member.look, own))
            elif not own.is_near(member.drawn[1]):
                found.append(Move(path, own))
            else:
                continue
            member.drawn = (member.look, own)
        return found


def _name(text):
    """A text as one step of a path."""
    return quote(text, safe=" ") or "-"


def _turned(quaternion, vector):
    """The vector turned by the quaternion; plain floats: numpy costs more for a single one."""
    x, y, z, w = quaternion
    a, b, c = vector
    s, t, u = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return a + w * s + y * u - z * t, b + w * t + z * s - x * u, c + w * u + x * t - y * s


def _product(first, second):
    """Quaternion that turns as `second`, then as `first`."""
    a, b, c, d = first
    x, y, z, w = second
    return (
        d * x + a * w + b * z - c * y,
        d * y - a * z + b * w + c * x,
        d * z + a * y - b * x + c * w,
        d * w - a * x - b * y - c * z,
    )
