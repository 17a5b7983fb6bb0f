"""Bearings as rays: where a camera says that landmarks and other vehicles are. Needs no ROS.

Axes are those of the camera: x along the optical axis, y right, z down. Nothing here is thread-safe.
"""

import math
from typing import NamedTuple

import numpy as np

from risc_lab.camera import rays_of_bearings
from risc_visual.drawing.palette import WHITE_RGB, ray_colours, vehicle_colour

_AHEAD_S = 0.5  # [s] a picture at most this much newer than the last sight of its vehicle is still placed


class Ray(NamedTuple):
    """One line of sight, from the camera's centre."""

    name: str  # of what is seen
    is_vehicle: bool  # else it is a landmark
    end_m: tuple[float, float, float]  # camera axes
    width_m: float
    rgb: tuple[float, float, float]


class RayStyles:
    """Width and colour of the rays towards all known objects, and which rays are drawn."""

    def __init__(self, params, landmarks, vehicles):
        """params: params.RayParams. landmarks: landmark_config.LandmarksConfig.

        vehicles: for each vehicle all its names, in the order of the colours.
        """
        self._params = params
        # Thin under a template's name: in the original release such bearings were not measurements.
        widths_m = {kind.name: params.template_width_m for kind in landmarks.landmarks}
        widths_m.update({kind.roi_name: params.width_m for kind in landmarks.landmarks})
        self._landmarks = {name: (widths_m[name], rgb) for name, rgb in ray_colours(landmarks).items()}
        self._vehicles = {
            name: (params.width_m, vehicle_colour(index)) for index, names in enumerate(vehicles) for name in names
        }

    def rays(self, bearings, to_vehicles=False):
        """Rays of the bearings that are seen and within the limits; of several with the same name, the first.

        bearings: risc_estimation.bearings.Bearings, of landmarks or of vehicles. Returns a list of Ray.
        """
        looks, other = self._vehicles if to_vehicles else self._landmarks, (self._params.width_m, WHITE_RGB)
        limits_rad = np.radians((self._params.azimuth_max_deg, self._params.elevation_max_deg))
        drawn = {}
        for item in bearings:
            # NaN is not within, either
            within = abs(item.azimuth_rad) < limits_rad[0] and abs(item.elevation_rad) < limits_rad[1]
            if item.visible and within:
                drawn.setdefault(item.name, (item.azimuth_rad, item.elevation_rad))
        ends_m = self._params.length_m * rays_of_bearings(*np.reshape(list(drawn.values()), (-1, 2)).T)
        return [
            Ray(name, to_vehicles, tuple(end_m), *looks.get(name, other)) for name, end_m in zip(drawn, ends_m.tolist())
        ]


class Whereabouts:
    """When motion capture last saw each vehicle: the picture of a vehicle can be placed only near such a time."""

    def __init__(self, max_age_s):
        """max_age_s: [s] a picture that is older than the newest sight of its vehicle by this cannot be placed."""
        self._max_age_s, self._seen_s = max_age_s, {}

    def note(self, stamp_s, visible):
        """Take a frame of motion capture. visible: dict name of vehicle -> bool."""
        for name, is_seen in visible.items():
            self._seen_s[name] = stamp_s if is_seen else self._seen_s.get(name, -math.inf)

    def stamp_of(self, name, stamp_s):
        """Time [s] at which to place a vehicle's picture, None if it cannot be placed.

        stamp_s: of the picture; 0 = not stamped (bags of the original release): then it is the newest sight. The
        picture of a vehicle that motion capture has never named (a camera on a stand) is placed at its stamp.
        """
        seen_s = self._seen_s.get(name, stamp_s)
        at_s = stamp_s or seen_s
        return at_s if at_s - _AHEAD_S <= seen_s <= at_s + self._max_age_s and math.isfinite(at_s) else None


class Shown:
    """Finds markers that were not renewed for a lifetime: rviz drops them, but not its status messages about them.

    Times are seconds of the clock by which rviz lets markers expire.
    """

    def __init__(self, lifetime_s):
        self._lifetime_s, self._until_s = lifetime_s, {}

    def renew(self, keys, now_s):
        """Note that these are drawn now."""
        self._until_s.update(dict.fromkeys(keys, now_s + self._lifetime_s))

    def pop_expired(self, now_s):
        """List of the keys whose lifetime is over, each once; also of those drawn before the clock was set back."""
        expired = [key for key, until_s in self._until_s.items() if not now_s < until_s <= now_s + self._lifetime_s]
        for key in expired:
            del self._until_s[key]
        return expired
