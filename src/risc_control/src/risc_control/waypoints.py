"""Files of waypoints: the minimum-snap path through them (`minimum_snap`), as a Motion. No ROS.

    name: eight
    closed: true
    waypoints:
      - {position_m: [1.0, 0.0, 1.0]}
      - {position_m: [2.0, 0.5, 1.0], yaw_deg: 90}

See `Waypoints` for all keys.
"""

import functools
import math
import pathlib
from dataclasses import dataclass

import numpy as np

from risc_control.minimum_snap import COEFFICIENTS, best_durations, greatest_speed, pieces, reversed_pieces
from risc_control.motions import polynomials
from risc_lab.lab.yaml_reader import load_yaml
from risc_lab.settings import Name, NotNegative, Positive, Settings, Vector, settings_from

_LEAST_APART_M = 0.05
_MOST = 200


@dataclass(frozen=True)
class Waypoint(Settings):
    """A place that is flown through."""

    position_m: Vector  # cortex frame
    yaw_deg: float | None = None  # where the nose points there, + clockwise from above; all or none have one
    time_s: NotNegative | None = None  # when it is there; all or none have one, the first is 0


@dataclass(frozen=True)
class Waypoints(Settings):
    """A course through waypoints."""

    waypoints: tuple[Waypoint, ...]
    name: Name = "waypoints"
    closed: bool = True  # from the last to the first, cyclically; False: back the same way, with a rest at both ends
    period_s: Positive | None = None  # closed and with times: when it is at the first waypoint again
    speed_m_s: Positive = 0.6  # greatest speed, if there are no times

    def __post_init__(self):
        super().__post_init__()
        count, points = len(self.waypoints), [waypoint.position_m for waypoint in self.waypoints]
        if not 2 <= count <= _MOST:
            raise ValueError("a course needs 2 to %d waypoints, there are %d" % (_MOST, count))
        for i, (here, there) in enumerate(zip(points, points[1:] + points[:1]), start=1):
            if (i < count or self.closed) and math.dist(here, there) < _LEAST_APART_M:
                cure = "leave one out" if i < count else "leave one out, the way back to the first is flown in any case"
                text = "waypoints %d and %d are at the same place, (%.2f, %.2f, %.2f) m: %s"
                raise ValueError(text % (i, i % count + 1, *here, cure))
        for key in ("yaw_deg", "time_s"):
            without = [i for i, waypoint in enumerate(self.waypoints, start=1) if getattr(waypoint, key) is None]
            if 0 < len(without) < count:
                text = "waypoint %d has no %s, and others have one: give it to all or none"
                raise ValueError(text % (without[0], key))
        if self.is_timed:
            times_s = [waypoint.time_s for waypoint in self.waypoints]
            if times_s[0] != 0.0:
                raise ValueError("time_s of the first waypoint must be 0, found %g" % times_s[0])
            if self.closed and self.period_s is None:
                raise ValueError("period_s is missing: when a closed course with times is at its first waypoint again")
            names = ["time_s of waypoint %d" % i for i in range(1, count + 1)] + ["period_s"]
            times_s += [self.period_s] if self.closed else []
            for name, before_s, time_s in zip(names[1:], times_s, times_s[1:]):
                if not time_s > before_s:
                    raise ValueError("%s must be later than the one before, %g s, found %g" % (name, before_s, time_s))
        if self.period_s is not None and not (self.is_timed and self.closed):
            raise ValueError("period_s is for a closed course whose waypoints have a time_s: leave it out")

    def __str__(self):
        return self.name

    @property
    def is_timed(self):
        return self.waypoints[0].time_s is not None

    @functools.cached_property
    def path(self):
        """(Motion, its period [s])."""
        points = np.array([waypoint.position_m for waypoint in self.waypoints])
        if self.is_timed:
            times_s = [waypoint.time_s for waypoint in self.waypoints] + ([self.period_s] if self.closed else [])
            durations_s = np.diff(times_s)
        else:
            durations_s = best_durations(points, self.closed)
            durations_s *= greatest_speed(pieces(points, durations_s, self.closed), durations_s) / self.speed_m_s
        coefficients = np.concatenate([pieces(points, durations_s, self.closed), self._yaw(durations_s)], axis=2)
        if not self.closed:
            coefficients = np.concatenate([coefficients, reversed_pieces(coefficients)])
            durations_s = np.concatenate([durations_s, durations_s[::-1]])
        return polynomials(coefficients, durations_s), float(durations_s.sum())

    def _yaw(self, durations_s):
        """(m, 8, 1) coefficients of the yaw, by the shorter turn from each waypoint to the next."""
        if self.waypoints[0].yaw_deg is None:
            return np.zeros((len(durations_s), COEFFICIENTS, 1))
        yaws_deg = [waypoint.yaw_deg for waypoint in self.waypoints]
        yaws = np.unwrap(np.radians(yaws_deg + yaws_deg[:1] * self.closed))
        if not self.closed:
            return pieces(yaws[:, None], durations_s, False)
        # the whole turns of a round are made at a constant rate; the rest is periodic
        begins, rate = np.cumsum(durations_s) - durations_s, (yaws[-1] - yaws[0]) / durations_s.sum()
        coefficients = pieces((yaws[:-1] - rate * begins)[:, None], durations_s, True)
        coefficients[:, 0, 0] += rate * begins
        coefficients[:, 1, 0] += rate * durations_s
        return coefficients


def load_waypoints(path):
    """Waypoints of a file, named after it unless they have a name. Raises ValueError that names file and key."""
    return settings_from(Waypoints, {"name": pathlib.Path(path).stem, **load_yaml(path)}, str(path))
