"""Recent bearings of landmarks from one camera, combined with poses for fitting its mount. Needs no ROS.

The last of every `held_out_every` seconds is held out: a mount is solved on the others and checked on these. Whole
seconds, not single bearings, since neighbouring pictures have the same errors.
"""

from collections import Counter, deque
from dataclasses import dataclass

import numpy as np

from risc_estimation.mount_fit import Samples
from risc_estimation.pose_track import PoseTrack
from risc_lab.camera import rays_of_bearings
from risc_lab.clock_guard import Step
from risc_lab.settings import Positive, Settings, between


@dataclass(frozen=True)
class WindowParams(Settings):
    """Settings of the window; also parameters of transform_tuner of risc_visual."""

    window_s: Positive = 60.0  # how far back it reaches
    held_out_every: between(2, 1000) = 3  # [s] one second of this many is held out for checking
    late_max_s: Positive = 10.0  # how long bearings wait for their poses, and poses for their bearings


class BearingWindow:
    """Poses, landmarks and bearings of one vehicle in, Samples out. Not thread-safe."""

    def __init__(self, params=None):
        self._params = params or WindowParams()
        self.refused = Counter()  # why bearings were left out -> how many
        self._places = {}
        self._track = PoseTrack(span_s=self._params.late_max_s + 1.0)
        self._waiting = deque()  # (stamp, landmark, ray) of bearings whose pose may still come
        self._rows = deque()  # (stamp, landmark, point in body axes, ray)
        self._newest_s = -np.inf

    def restart(self):
        """Forget every bearing, and record from now on."""
        self._forget()
        self.refused.clear()

    def _forget(self):
        self._rows.clear()
        self._waiting.clear()

    def see_landmarks(self, places):
        """{landmark: (3,) [m] cortex}; those not named stay where they were last seen."""
        self._places.update({name: np.array(place) for name, place in places.items() if np.all(np.isfinite(place))})

    def see_pose(self, stamp_s, position_m, euler_rad):
        """Take the vehicle's pose: (3,) [m] cortex; roll, pitch, yaw [rad]. Call it only while the vehicle is seen."""
        if self._track.append(stamp_s, position_m, euler_rad) is Step.NEW_CLOCK:
            self._forget()
            self._newest_s = -np.inf
        self._advance(stamp_s)
        if self._waiting and self._waiting[0][0] <= stamp_s:
            self._place()

    def see_bearings(self, stamp_s, bearings):
        """bearings: {landmark: (azimuth, elevation) [rad]} of one picture.

        stamp: of its exposure; 0 = not stamped (bags of the original release): then it is that of the newest pose.
        """
        stamp_s = stamp_s or self._track.last_stamp_s
        if stamp_s is None:
            self.refused.update(["the vehicle was not seen"] * len(bearings))
            return
        self._advance(stamp_s)
        for name, bearing_rad in bearings.items():
            if not np.all(np.isfinite(bearing_rad)):
                self.refused["the bearing is no number"] += 1
            elif name not in self._places:
                self.refused["the place of %s is not known" % name] += 1
            else:
                self._waiting.append((stamp_s, name, rays_of_bearings(*bearing_rad)))
        self._place()

    def samples(self):
        """(Samples to solve on, Samples to check on)."""
        everything = self._samples(self._rows)
        aside = np.floor(everything.times_s) % self._params.held_out_every == self._params.held_out_every - 1
        return everything.take(~aside), everything.take(aside)

    def latest(self, duration_s):
        """Samples of the last duration_s [s]."""
        return self._samples([row for row in self._rows if row[0] >= self._newest_s - duration_s])

    def _advance(self, stamp_s):
        self._newest_s = max(self._newest_s, stamp_s)
        while self._rows and self._rows[0][0] < self._newest_s - self._params.window_s:
            self._rows.popleft()

    def _place(self):
        """Join the waiting bearings with their poses, where these are known."""
        last_s = self._track.last_stamp_s
        ready = []
        while self._waiting and last_s is not None and self._waiting[0][0] <= last_s:
            ready.append(self._waiting.popleft())
        while self._waiting and self._waiting[0][0] < self._newest_s - self._params.late_max_s:
            self._waiting.popleft()
            self.refused["the vehicle was not seen"] += 1
        if not ready:
            return
        poses = self._track.at([stamp_s for stamp_s, _, _ in ready])
        for (stamp_s, name, ray), known, position_m, R in zip(ready, *poses):
            if known:
                self._rows.append((stamp_s, name, (self._places[name] - position_m) @ R, ray))
            else:
                self.refused["the vehicle was not seen"] += 1

    @staticmethod
    def _samples(rows):
        return Samples(
            times_s=np.array([row[0] for row in rows], dtype=float),
            names=np.array([row[1] for row in rows], dtype=object),
            points_body_m=np.array([row[2] for row in rows]).reshape(-1, 3),
            rays=np.array([row[3] for row in rows]).reshape(-1, 3),
        )
