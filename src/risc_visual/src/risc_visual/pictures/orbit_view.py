"""Views of rviz: their configuration files, and where the orbit camera sees a point. Needs no ROS and no rviz.

Points are in the view's target frame (the fixed frame unless it says otherwise), z up, in metres. Pixels: x right,
y down, (0, 0) is the middle of the top left pixel.
"""

from dataclasses import dataclass, replace

import numpy as np

from risc_lab.lab.yaml_reader import load_yaml

ORBIT = "rviz/Orbit"
_STEEPEST_RAD = np.pi / 2.0 - 0.001  # rviz keeps the camera off the vertical, where its heading is lost
_WITH_WINDOWS = ("rviz/Camera", "rviz/Image")  # displays that take room beside the scene
_DEFAULT_FIELD_RAD = np.pi / 4.0
_FIT_STEPS = 40


@dataclass(frozen=True)
class OrbitView:
    """A view of rviz: the camera looks at the focal point from a distance."""

    distance_m: float
    pitch_rad: float  # of the camera above the focal point
    yaw_rad: float  # where it stands around the focal point, from +x, + counter-clockwise from above
    focal_point_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    field_rad: float = _DEFAULT_FIELD_RAD  # of view, from the top to the bottom of the picture

    def __post_init__(self):
        if not self.distance_m > 0.0 or not 0.0 < self.field_rad < np.pi or len(self.focal_point_m) != 3:
            raise ValueError("a view needs a distance > 0, a field of view < 180 deg, a 3-D focal point: %r" % (self,))

    @property
    def eye_m(self):
        """(3,) position of the camera."""
        pitch = np.clip(self.pitch_rad, -_STEEPEST_RAD, _STEEPEST_RAD)
        level = np.cos(pitch)
        away = np.array([level * np.cos(self.yaw_rad), level * np.sin(self.yaw_rad), np.sin(pitch)])
        return np.asarray(self.focal_point_m, dtype=float) + self.distance_m * away

    def matrix(self, width_px, height_px):
        """Pinhole matrix (3, 4): P @ (x, y, z, 1) = depth * (x_px, y_px, 1), depth along the optical axis [m]."""
        eye = self.eye_m
        ahead = (self.focal_point_m - eye) / self.distance_m
        right = np.cross(ahead, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        R = np.array([right, np.cross(ahead, right), ahead])  # rows: right, down, ahead
        focal_px = 0.5 * height_px / np.tan(0.5 * self.field_rad)
        K = np.array([[focal_px, 0.0, 0.5 * (width_px - 1)], [0.0, focal_px, 0.5 * (height_px - 1)], [0.0, 0.0, 1.0]])
        return K @ np.column_stack((R, -R @ eye))

    def project(self, points_m, width_px, height_px):
        """Pixels (..., 2) of points (..., 3) in a picture of this size; NaN behind the camera."""
        points = np.asarray(points_m, dtype=float)
        P = self.matrix(width_px, height_px)
        pixels = points @ P[:, :3].T + P[:, 3]
        depth = np.where(pixels[..., 2:] > 0.0, pixels[..., 2:], np.nan)
        return pixels[..., :2] / depth

    def fitted(self, points_m, width_px, height_px, margin=0.03):
        """The view from the same side that is filled by the points (n, 3) in a picture of this size.

        margin: left free on every side, a fraction of the picture's width and height.
        """
        size = np.array([width_px, height_px])
        view = self
        for _ in range(_FIT_STEPS):
            pixels = view.project(points_m, *size)
            if np.isnan(pixels).any():
                view = replace(view, distance_m=2.0 * view.distance_m)
                continue
            low, high = pixels.min(axis=0), pixels.max(axis=0)
            P = view.matrix(*size)
            m_per_px = view.distance_m / (0.5 * height_px / np.tan(0.5 * view.field_rad))
            right = np.cross(P[2, :3], (0.0, 0.0, 1.0))
            right /= np.linalg.norm(right)
            down = np.cross(P[2, :3], right)
            aside, below = (0.5 * (low + high) - 0.5 * (size - 1)) * m_per_px
            view = replace(
                view,
                focal_point_m=tuple((view.focal_point_m + aside * right + below * down).tolist()),
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
    try:
        focal = content.get("Focal Point", {})
        return OrbitView(
            distance_m=float(content["Distance"]),
            pitch_rad=float(content["Pitch"]),
            yaw_rad=float(content["Yaw"]),
            focal_point_m=tuple(float(focal.get(axis, 0.0)) for axis in "XYZ"),
            field_rad=float(content.get("Field of View", _DEFAULT_FIELD_RAD)),
        )
    except (KeyError, TypeError) as error:
        raise ValueError("%s: Distance, Pitch, Yaw and Focal Point must be numbers (%s)" % (where, error)) from None


def load_config(path):
    """Content of an rviz configuration file. Raises ValueError naming the file when it is none."""
    content = load_yaml(path)
    if not isinstance(content.get("Visualization Manager"), dict):
        raise ValueError("%s: this is no configuration of rviz: it has no 'Visualization Manager'" % path)
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
    displays = config["Visualization Manager"].get("Displays") or ()
    topics = [item["Marker Topic"] for item in displays if item.get("Marker Topic") and item.get("Enabled", True)]
    return ["/" + topic.lstrip("/") for topic in topics]


def has_display(config, display_class):
    """Whether an rviz configuration has an enabled display of this class, e.g. rviz/InteractiveMarkers."""
    displays = config["Visualization Manager"].get("Displays") or ()
    return any(item.get("Class") == display_class and item.get("Enabled", True) for item in displays)


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
