"""What rviz would show, as the scene of a viser page that loads nothing from elsewhere. Needs no ROS master.

The scene is a tree: `/topic/ns` is a group that has a pose in the fixed frame, `/topic/ns/id` a marker that has a pose
in its group. A group's pose is that of its first marker, so that only the group of a flying vehicle moves, not
every part of it. Times are seconds of a monotonic clock; frames are named as in tf.
"""

import threading
from dataclasses import dataclass
from urllib.parse import quote

import numpy as np
from scipy.spatial.transform import Rotation
from visualization_msgs.msg import Marker

from risc_visual.browser.marker_shapes import SHAPES, look_of, turn_of

FIXED_FRAME = "cortex"
_SAME_M = 1e-5  # positions nearer than this are the same
_SAME_TURN = 1e-9  # and so are quaternions whose product differs from 1 by less: 0.005 degrees
_MOST = 1e9
_WAITS_S = 1.0  # of waiting for the pose of a marker's frame; after that the marker is outdated
_EYE_M, _LOOKS_AT_M, _FIELD_RAD = (-6.3, 3.6, 4.2), (0.0, -0.1, 0.9), 0.75  # of the initial view
_TILE_M = 0.5
_AMBIENT = 1.0  # beside viser's own two lights
_WXYZ = [3, 0, 1, 2]  # of a quaternion x, y, z, w: viser's order
_SEEN = ("type", "scale", "color", "points", "colors", "text")  # fields of a marker


@dataclass
class _Member:
    """One marker: its newest message, and what was drawn of it."""

    marker: Marker = None
    waits_since_s: float | None = None  # for the pose of its frame; None = it is placed
    ends_s: float = np.inf
    pose: np.ndarray | None = None  # (7,) position and quaternion x, y, z, w of `placed` in the fixed frame
    placed: Marker | None = None  # the last message that was placed
    handle: object = None  # viser's handle of what is drawn
    drawn: Marker | None = None  # the message that is drawn
    look: tuple | None = None  # its look, of `look_of`
    drawn_pose: np.ndarray | None = None  # its pose in the group


class MarkerScene:
    """Markers by topic, ns and id, as rviz' displays keep them. Topics may be noted in several threads."""

    def __init__(self, server, half_x_m, half_y_m):
        """server: viser.ViserServer. half_x_m, half_y_m: half the floor's size."""
        self._server = server
        self._lock = threading.Lock()
        self._groups = {}  # path -> _Group
        server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        view = server.initial_camera
        view.position, view.look_at, view.fov = _EYE_M, _LOOKS_AT_M, _FIELD_RAD
        # Cheap light: the page must work on computers whose browser renders in software.
        server.scene.configure_environment_map(None)
        server.scene.configure_default_lights(enabled=True, cast_shadow=False)
        server.scene.add_light_ambient("/light", intensity=_AMBIENT)
        server.scene.add_grid(
            "/floor",
            width=2.0 * half_x_m,
            height=2.0 * half_y_m,
            cell_size=_TILE_M,
            section_size=2.0 * _TILE_M,
            cell_color=(60, 60, 60),
            section_color=(90, 90, 90),
            shadow_opacity=0.0,
        )

    def note(self, topic, markers, now_s):
        """Take the markers of a message. Returns the types among them that cannot be shown."""
        strange = set()
        topic = "/%s/" % _name(topic.strip("/"))
        with self._lock:
            for marker in markers:
                path = topic + _name(marker.ns)
                if marker.action == Marker.DELETEALL:
                    for other, group in self._groups.items():
                        if other.startswith(topic):
                            group.end(list(group.members))
                elif marker.action == Marker.DELETE:
                    if path in self._groups:
                        self._groups[path].end([marker.id])
                elif marker.type not in SHAPES:
                    strange.add(marker.type)
                elif marker.action == Marker.ADD and _is_sound(marker):
                    self._groups.setdefault(path, _Group(path)).put(marker, now_s)
        return strange

    def draw(self, now_s, lookup):
        """Show what has changed since the last time. Returns the number of changes.

        lookup(frame, stamp): geometry_msgs/Transform from a frame to the fixed one, None if that is not known (yet). A
        marker that waits for its frame is not drawn, and after a second it is forgotten. Raises the first error
        at the end: what cannot be drawn keeps nothing else from being drawn.
        """
        problems, count = [], 0
        with self._lock, self._server.atomic():
            for path, group in list(self._groups.items()):
                group.end([number for number, member in group.members.items() if now_s >= member.ends_s])
                if group.touched:
                    count += group.draw(self._server.scene, now_s, lookup, problems)
                if not group.members:
                    del self._groups[path]
        if problems:
            raise problems[0]
        return count

    def clear(self):
        """Remove everything but the floor."""
        with self._lock:
            for group in self._groups.values():
                group.end(list(group.members))
        self.draw(0.0, lambda _frame, _stamp: None)  # what came meanwhile may ask for a frame


class _Group:
    """The markers of a topic and a namespace."""

    def __init__(self, path):
        self.members = {}
        self.touched = False
        self._path = path
        self._gone = []  # handles of what is to be erased
        self._handle, self._pose = None, None  # as drawn

    def put(self, marker, now_s):
        self.touched = True
        member = self.members.setdefault(marker.id, _Member())
        member.marker = marker
        if member.waits_since_s is None:
            member.waits_since_s = now_s
        member.ends_s = now_s + (marker.lifetime.to_sec() or np.inf)

    def end(self, numbers):
        for number in self.members.keys() & numbers:
            self.touched = True
            self._gone.append(self.members.pop(number).handle)

    def draw(self, scene, now_s, lookup, problems):
        """Returns the number of changes; errors are added to `problems`."""
        self.touched = False
        self._place(now_s, lookup)
        gone, self._gone = list(filter(None, self._gone)), []
        count = len(gone)
        placed = sorted((number, member) for number, member in self.members.items() if member.pose is not None)
        if self._handle and not self.members:
            gone, self._handle, self._pose = [*gone, self._handle], None, None
        for handle in gone:
            handle.remove()
        if not placed:
            return count
        poses = np.array([member.pose for _, member in placed])
        if self._handle is None:
            self._handle = scene.add_frame(self._path, show_axes=False)
        if self._pose is None or not _is_near(poses[0], self._pose):
            count, self._pose = count + 1, poses[0]
            self._handle.position, self._handle.wxyz = poses[0][:3], poses[0][3:][_WXYZ]
        back = Rotation.from_quat(self._pose[3:]).inv()
        turns = (back * Rotation.from_quat(poses[:, 3:])).as_quat()
        own = np.column_stack((back.apply(poses[:, :3] - self._pose[:3]), turns))
        for (number, member), pose in zip(placed, own):
            try:
                count += _show(scene, "%s/%d" % (self._path, number), member, pose)
            except Exception as error:  # after any error the others are still drawn
                problems.append(error)
        return count

    def _place(self, now_s, lookup):
        for number, member in list(self.members.items()):
            if member.waits_since_s is None:
                continue
            pose, header = _pose(member.marker), member.marker.header
            frame = header.frame_id.lstrip("/") or FIXED_FRAME
            if frame != FIXED_FRAME:
                transform = lookup(frame, header.stamp)
                pose = None if transform is None else _carried(transform, pose)
            if pose is not None:
                member.pose, member.placed, member.waits_since_s = pose, member.marker, None
            elif now_s - member.waits_since_s > _WAITS_S:
                self.end([number])
            else:
                self.touched = True


def _show(scene, path, member, pose):
    """Draw what is placed, at a pose (7,) in its group. Returns 1 when there was something to do."""
    marker, before = member.placed, member.drawn
    same = before is not None and all(getattr(before, name) == getattr(marker, name) for name in _SEEN)
    stays = before is not None and _is_near(pose, member.drawn_pose)
    if same and stays:
        return 0
    place = {"position": pose[:3], "wxyz": turn_of(marker, pose[3:])[_WXYZ]}
    changes = {} if stays else place
    if not same:
        member.drawn = None  # in case it cannot be shown
        method, fixed, free = look = look_of(marker)
        if member.look and method == member.look[0] and _are_equal(fixed, member.look[1]):
            changes = {**changes, **free}
        else:
            member.handle, changes = getattr(scene, method)(path, **fixed, **free, **place), {}
        member.look = look
    for name, value in changes.items():
        setattr(member.handle, name, value)
    member.drawn, member.drawn_pose = marker, pose
    return 1


def _are_equal(look, other):
    return all(np.array_equal(value, other.get(name)) for name, value in look.items())


def _name(text):
    """A text as one step of a path."""
    return quote(text, safe=" ") or "-"


def _pose(marker):
    """(7,) position and unit quaternion; all zeros means not set: no turn."""
    at, turn = marker.pose.position, marker.pose.orientation
    quaternion = np.array((turn.x, turn.y, turn.z, turn.w))
    length = np.linalg.norm(quaternion)
    return np.array((at.x, at.y, at.z, *(quaternion / length if length > 0.0 else (0.0, 0.0, 0.0, 1.0))))


def _carried(transform, pose):
    """A pose (7,), transformed by a geometry_msgs/Transform."""
    at, turn = transform.translation, transform.rotation
    rotation = Rotation.from_quat((turn.x, turn.y, turn.z, turn.w))
    position = rotation.apply(pose[:3]) + (at.x, at.y, at.z)
    return np.append(position, (rotation * Rotation.from_quat(pose[3:])).as_quat())


def _is_near(pose, other):
    """True when two poses (7,) cannot be told apart by eye."""
    return np.abs(pose[:3] - other[:3]).max() < _SAME_M and abs(pose[3:] @ other[3:]) > 1.0 - _SAME_TURN


def _is_sound(marker):
    """False for numbers that are not finite, or too large to be drawn."""
    at, turn, size, colour = marker.pose.position, marker.pose.orientation, marker.scale, marker.color
    numbers = [at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w, size.x, size.y, size.z]
    numbers += [value for item in (colour, *marker.colors) for value in (item.r, item.g, item.b, item.a)]
    numbers += [value for point in marker.points for value in (point.x, point.y, point.z)]
    return bool((np.abs(numbers) < _MOST).all())
