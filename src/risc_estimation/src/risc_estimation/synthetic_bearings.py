"""Bearings that cameras would have measured, from motion capture alone (thesis 4.4.4). Needs no ROS."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from risc_estimation.bearings import Bearing
from risc_estimation.expected_bearings import LANDMARK, Hull, look
from risc_estimation.pose_track import PoseTrack
from risc_lab.clock_guard import ClockGuard, Step
from risc_lab.lab.landmark_catalogue import Disc
from risc_lab.settings import NotNegative, Positive, Settings, between


@dataclass(frozen=True)
class SyntheticParams(Settings):
    """Properties of the simulated cameras and detectors; also parameters of synthetic_angles."""

    rate_hz: Positive = 30.0  # pictures a second
    delay_s: NotNegative = 0.0  # transport delay: a picture stamped t shows the world at t - delay_s
    noise_deg: NotNegative = 0.0  # standard deviation of azimuth and of elevation
    seed: int = 1  # of the noise
    min_fraction: between(1e-6, 1.0) = 0.9  # an object is found when this much of it is in the picture, and
    min_diameter_px: NotNegative = 14.0  # the least diameter of a landmark's middle, or of a vehicle, is this, and
    max_distance_m: Positive = 6.0  # it is no farther than this


class Picture(NamedTuple):
    """Measurements of one simulated camera. The lists hold one Bearing per known object, found or not."""

    vehicle: str  # the observing one
    landmarks: list[Bearing]
    quads: list[Bearing]


class SyntheticBearings:
    """States in, pictures out, on a fixed schedule of stamps. Not thread-safe. A seed reproduces the noise."""

    def __init__(self, observers, params=None):
        """observers: {vehicle: Observer, None = its camera is not known, so it sees nothing}."""
        self._params = params or SyntheticParams()
        self._observers = dict(observers)
        self._tracks = {}
        self._restart()
        self._discs: dict[str, Disc] = {}
        self._random = np.random.default_rng(self._params.seed)
        self._stamps = ClockGuard()

    def _restart(self):
        self._tracks = {
            name: PoseTrack(span_s=self._params.delay_s + 0.5) for name in (*self._observers, *self._tracks)
        }
        self._tick = None  # number of the next picture; its stamp is tick / rate

    def see_landmarks(self, discs):
        """Set the present landmarks, a list of Disc; those not named stay where they were last seen."""
        self._discs.update({disc.name: disc for disc in discs})

    def update(self, stamp_s, states):
        """Take one frame of states; returns the pictures that are due: [(stamp [s], [Picture, one per vehicle])].

        states: {vehicle: (position (3,) [m] cortex, roll pitch yaw (3,) [rad])} of the visible vehicles.
        """
        step = self._stamps.look(stamp_s)
        if step is Step.REFUSED:
            return []
        if step is Step.NEW_CLOCK:
            self._restart()
        for name, (position_m, euler_rad) in states.items():
            if name not in self._tracks:
                self._tracks[name] = PoseTrack(span_s=self._params.delay_s + 0.5)
            self._tracks[name].append(stamp_s, position_m, euler_rad)
        rate_hz = self._params.rate_hz
        if self._tick is None:
            self._tick = math.ceil(stamp_s * rate_hz)
        due = []
        while self._tick / rate_hz <= stamp_s:
            due.append((self._tick / rate_hz, self._pictures(self._tick / rate_hz)))
            self._tick += 1
        return due

    def _pictures(self, stamp_s):
        poses = {name: track.at(stamp_s - self._params.delay_s) for name, track in self._tracks.items()}
        hulls = {
            name: Hull(name, pose.positions_m[0], pose.R_body_to_cortex[0])
            for name, pose in poses.items()
            if pose.known[0]
        }
        return [self._picture(name, observer, hulls) for name, observer in self._observers.items()]

    def _picture(self, vehicle, observer, hulls):
        others = [name for name in self._tracks if name != vehicle]
        own = hulls.get(vehicle)
        sightings = []
        if observer is not None and own is not None:
            targets = list(self._discs.values()) + [hulls[name] for name in others if name in hulls]
            sightings = look(observer, own.position_m, own.R_body_to_cortex, targets)
        found = {}
        for item in sightings:
            if self._is_found(item):
                noise = np.radians(self._params.noise_deg) * self._random.standard_normal(2)
                azimuth_rad, elevation_rad = item.azimuth_rad + float(noise[0]), item.elevation_rad + float(noise[1])
                found[item.kind == LANDMARK, item.name] = Bearing(item.name, True, azimuth_rad, elevation_rad)

        def bearings(is_landmark, names):
            return [found.get((is_landmark, name), Bearing(name, False, np.nan, np.nan)) for name in names]

        return Picture(vehicle, bearings(True, self._discs), bearings(False, others))

    def _is_found(self, sighting):
        params = self._params
        return (
            sighting.fraction >= params.min_fraction
            and sighting.diameter_px >= params.min_diameter_px
            and sighting.distance_m <= params.max_distance_m
            and bool(np.isfinite(sighting.centre_px).all())
        )
