"""Views of rviz: their configuration files, and where the orbit camera sees a point. Needs no ROS and no rviz.

Points are in the view's target frame (the fixed frame unless it says otherwise), z up, in metres. Pixels: x right,
y down, (0, 0) is the middle of the top left pixel.
"""

from dataclasses import dataclass, replace

import numpy as np

from risc_lab.lab.yaml_reader import load_yaml
from risc_lab.settings import Positive, Settings, between, settings_from

ORBIT = "rviz/Orbit"
_STEEPEST_RAD = np.pi / 2.0 - 0.001  # rviz keeps the camera off the vertical, where its heading is lost
_WITH_WINDOWS = ("rviz/Camera", "rviz/Image")  # displays that take room beside the scene
_DEFAULT_FIELD_RAD = np.pi / 4.0
_FIT_STEPS = 40


@dataclass(frozen=True)
class OrbitView(Settings):
    """A view of rviz: the camera looks at the focal point from a distance."""

    distance_m: Positive
    pitch_rad: float  # of the camera above the focal point
    yaw_rad: float  # where it stands around the focal point, from +x, + counter-clockwise from above
    focal_point_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    field_rad: between(0.01, 3.1) = _DEFAULT_FIELD_RAD  # of view, from the top to the bottom of the picture

    @property
    def eye_m(self):
        """(3,) position of the camera."""
        pitch = np.clip(self.pitch_rad, -_STEEPEST_RAD, _STEEPEST_RAD)
        level = np.cos(pitch)
        away = np.array([level * np.cos(self.yaw_rad), level * np.sin(self.yaw_rad), np.sin(pitch)])
        return np.asarray(self.focal_point_m, dtype=float) + self.distance_m * away

    def _axes(self):
        """(3, 3) rows: right, down, ahead."""
        ahead = (self.focal_point_m - self.eye_m) / self.distance_m
        right = np.cross(ahead, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(ahead, right), ahead])

    def project(self, points_m, width_px, height_px):
        """Pixels (..., 2) of points (..., 3) in a picture of this size; NaN behind the camera."""
        seen = (np.asarray(points_m, dtype=float) - self.eye_m) @ self._axes().T
        depth = np.where(seen[..., 2:] > 0.0, seen[..., 2:], np.nan)
        focal_px = 0.5 * height_px / np.tan(0.5 * self.field_rad)
        return focal_px * seen[..., :2] / depth + (0.5 * (width_px - 1), 0.5 * (height_px - 1))

    def fitted(self, points_m, width_px, height_px, margin=0.03):
        """The view from the same side that is filled by the points (n, 3) in a picture of this size.

        margin: left free on every side, a fraction of the picture's width and height.
        """
        size, view = np.array([width_px, height_px]), self
        for _ in range(_FIT_STEPS):
            pixels = view.project(points_m, *size)
            if np.isnan(pixels).any():
                view = replace(view, distance_m=2.0 * view.distance_m)
                continue
            low, high = pixels.min(axis=0), pixels.max(axis=0)
            m_per_px = view.distance_m / (0.5 * height_px / np.tan(0.5 * view.field_rad))
            off_m = (0.5 * (low + high) - 0.5 * (size - 1)) * m_per_px
            view = replace(
                view,
                focal_point_m=tuple((view.focal_point_m + off_m @ view._axes()[:2]).tolist()),
                distance_m=view.distance_m * float(((high - low) / (size * (1.0 - 2.0 * margin))).max()),
            )
        return view

    def as_dict(self, view):
        """A view of an rviz configuration, with this camera."""
        numbers = {"Distance": self.distance_m, "Pitch": self.pitch_rad, "Yaw": self.yaw_rad}
        return dict(view, **numbers, **{"Focal Point": dict(zip("XYZ", self.focal_point_m))})


def orbit_view_from_dict(content, where="view"):
    """OrbitView from a view of an rviz configuration. Raises ValueError naming what is wrong with it."""
    if content.get("Class") != ORBIT:
        raise ValueError("%s: needs a view of class %s, found %r" % (where, ORBIT, content.get("Class")))
    focal = content.get("Focal Point", {})
    values = {
        "distance_m": content.get("Distance"),
        "pitch_rad": content.get("Pitch"),
        "yaw_rad": content.get("Yaw"),
        "focal_point_m": [focal.get(axis, 0.0) for axis in "XYZ"],
        "field_rad": content.get("Field of View", _DEFAULT_FIELD_RAD),
    }
    return settings_from(OrbitView, values, where)


def load_config(path):
    """Content of an rviz configuration file. Raises ValueError naming the file when it is not one."""
    content = load_yaml(path)
    if not isinstance(content.get("Visualization Manager"), dict):
        raise ValueError("%s is not an rviz configuration: it has no 'Visualization Manager'" % path)
    return content


def saved_view(config, name=""):
    """The view of that name among those an rviz configuration has saved, as a dict; without a name its current one.

    Raises ValueError listing the names.
    """
    views = config["Visualization Manager"].get("Views", {})
    if not name:
        return views.get("Current", {})
    by_name = {view.get("Name"): view for view in views.get("Saved") or ()}
    if name not in by_name:
        raise ValueError("there is no saved view '%s', only %s" % (name, ", ".join(map(str, by_name)) or "none"))
    return by_name[name]


def marker_topics(config):
    """Topics of the enabled marker displays of an rviz configuration, as the master knows them."""
    return ["/" + item["Marker Topic"].lstrip("/") for item in _enabled(config) if item.get("Marker Topic")]


def has_display(config, display_class):
    """Whether an rviz configuration has an enabled display of this class, e.g. rviz/InteractiveMarkers."""
    return any(item.get("Class") == display_class for item in _enabled(config))


def _enabled(config):
    displays = config["Visualization Manager"].get("Displays") or ()
    return [item for item in displays if item.get("Enabled", True)]


def picture_config(config, view, size_px, frame_rate_hz, scheme, without=(), silent=()):
    """The rviz configuration with nothing but the scene, which fills a window of this size (with rviz' --fullscreen).

    view: dict, as `saved_view` gives it. scheme: captions.Scheme. without: topics that are not shown. silent:
    namespaces of markers that are not shown.
    """
    manager = dict(config["Visualization Manager"])
    colour = {"Background Color": _text(scheme.ground), "Frame Rate": frame_rate_hz}
    manager["Global Options"] = dict(manager.get("Global Options", {}), **colour)
    displays = []
    for item in manager.get("Displays") or ():
        topic = item.get("Marker Topic")
        if item.get("Class") in _WITH_WINDOWS or (topic and "/" + topic.lstrip("/") in without):
            continue
        if item.get("Class") == "rviz/Grid":
            item = dict(item, Color=_text(scheme.floor))
        elif topic and silent:
            item = dict(item, Namespaces=dict.fromkeys(silent, False))
        displays.append(item)
    manager["Displays"] = displays
    manager["Views"] = {"Current": view, "Saved": None}
    window = {"X": 0, "Y": 0, "Width": size_px[0], "Height": size_px[1]}
    return dict(config, **{"Panels": [], "Visualization Manager": manager, "Window Geometry": window})


def _text(rgb):
    return "; ".join(map(str, rgb))
