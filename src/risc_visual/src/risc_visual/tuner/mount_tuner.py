"""Tuning where a vehicle's camera sits (thesis 4.4.4, figure 4.5): the present mount and the actions on it. No ROS.

Sliders and texts show a mount as six numbers: x, y, z [m] and roll, pitch, yaw [deg].
"""

import math
import threading
from dataclasses import dataclass

import numpy as np

from risc_estimation.mount_fit import FitParams, fit_mount, misses, standard_deviations, weak_values
from risc_estimation.mount_samples import BearingWindow
from risc_lab.lab.calibration import CameraMount, load_mount, resolve_url, save_mount
from risc_lab.settings import Positive, Settings

NUMBERS = ("x", "y", "z", "roll", "pitch", "yaw")
LIMITS = (1.0, 1.0, 1.0, 180.0, 90.0, 180.0)  # [m, deg] of the numbers, either side of 0
_STEP = 1e-6  # [m, deg] numbers that differ by less are the same


@dataclass(frozen=True)
class TunerParams(Settings):
    """Settings of transform_tuner, beside those of the window and of the fit (risc_estimation)."""

    nominal: bool = False  # begin with the nominal mount instead of the one in the fleet's file
    rate_hz: Positive = 50.0  # of the frames, at most
    text_hz: Positive = 2.0
    live_s: Positive = 3.0  # time that the first line of the text in the view covers
    rms_good_deg: Positive = 0.6  # rays that miss by less on the average pass the check
    rectified: bool = True  # which pictures the bearings are from, for errors in pixels
    camera: str = "ardrone"  # namespace of the pictures below the vehicle's


class MountTuner:
    """One vehicle's camera. Actions return (whether it was done, a sentence with figures).

    The mount may be changed from several threads; the window may not.
    """

    def __init__(self, vehicle, params=None, window_params=None, fit_params=None):
        """vehicle: FleetVehicle. Raises ValueError for a mount file that is not usable, unless params.nominal."""
        self.vehicle, self.name, self.template = vehicle, vehicle.namespace, vehicle.template
        self._params = params or TunerParams()
        self._fit_params = fit_params or FitParams()
        self._from_file = bool(vehicle.camera_mount) and not self._params.nominal
        self._first = load_mount(vehicle.camera_mount if self._from_file else "")
        self.mount = self._first  # replaced as a whole
        self._lock = threading.Lock()  # held to replace it: `change` keeps some of its numbers
        self.window = BearingWindow(window_params)
        self.acting = threading.Lock()  # for callers: one action at a time
        self.seen_s = self.answered_s = -math.inf  # when it was seen last, and answered last [s]
        self.answer = ""  # the last one

    @property
    def numbers(self):
        """The mount as {x, y, z [m], roll, pitch, yaw [deg]}, within the sliders' limits."""
        return dict(zip(NUMBERS, numbers_of(mount_of(numbers_of(self.mount)))))

    def change(self, numbers):
        """Take {some of NUMBERS: value}; cut at the sliders' limits. Raises ValueError for NaN."""
        if not np.all(np.isfinite(list(numbers.values()))):
            raise ValueError("%s: not moved: a mount needs finite numbers, got %r" % (self.name, numbers))
        with self._lock:
            self.mount = mount_of([numbers.get(key, value) for key, value in self.numbers.items()])

    def shows(self, numbers):
        """Whether these numbers are those of the mount."""
        return all(abs(numbers[key] - value) < _STEP for key, value in self.numbers.items())

    def record(self):
        """Begin a new window."""
        self.window.restart()
        return True, "%s: recording; fly where the camera sees landmarks, near and far, then solve" % self.name

    def solve(self, samples, camera=None):
        """Find the mount. samples: the first of window.samples(); camera: risc_lab.camera.Camera, for pixels."""
        start = self.mount
        try:
            fit = fit_mount(samples, start, self._fit_params, camera)
        except ValueError as error:
            return False, "%s: not solved: %s" % (self.name, error)
        with self._lock:
            mount = self.mount = mount_of(numbers_of(fit.mount))
        found, was = misses(samples, mount, self._fit_params, camera), misses(samples, start, self._fit_params)
        std_mm = ", ".join("%.1f" % (1e3 * value) for value in fit.std[:3])
        std_deg = ", ".join("%.2f" % math.degrees(value) for value in fit.std[3:])
        sentences = [
            "%s: solved: %s, was %.2f deg" % (self.name, found, math.degrees(was.rms_rad)),
            "%s; standard deviations %s mm, %s deg" % (text_of(mount), std_mm, std_deg),
            *("WARNING: " + text for text in fit.warnings),
        ]
        return True, ". ".join(sentences)

    def check(self, samples, camera=None):
        """Judge the mount. samples: the second of window.samples(), which no solution has seen."""
        count, needed = len(samples.times_s), self._fit_params.samples_min
        if count < needed:
            text = "%s: not checked: %d bearings were held out, %d are needed: record more"
            return False, text % (self.name, count, needed)
        found = misses(samples, self.mount, self._fit_params, camera)
        faults = []
        if not math.degrees(found.rms_rad) <= self._params.rms_good_deg:
            faults.append("more than %.2f deg" % self._params.rms_good_deg)
        if found.wrong_share > self._fit_params.wrong_max:
            faults.append("more than %.0f %% wrong" % (100.0 * self._fit_params.wrong_max))
        verdict = "NOT good, " + " and ".join(faults) if faults else "good"
        return not faults, "%s: %s: %s held out" % (self.name, verdict, found)

    def save(self):
        """Write the mount to the file that the fleet names; `reset` goes back to it from now on."""
        url = self.vehicle.camera_mount
        if not url:
            return False, (
                "%s: not saved: the fleet file names no camera_mount for %s: add one, e.g. camera_mount: "
                "%s_mount.yaml with its folder, and start again" % (self.name, self.vehicle.namespace, self.name)
            )
        mount = self.mount
        try:
            path = resolve_url(url).resolve()
            save_mount(mount, path)
        except (OSError, ValueError) as error:
            return False, "%s: not saved: cannot write %s: %s" % (self.name, url, error)
        with self._lock:
            self._first, self._from_file = mount, True
        return True, "%s: saved to %s: %s" % (self.name, path, text_of(mount))

    def reset(self):
        """Go back to the mount that was saved last, or to the initial one."""
        with self._lock:
            mount = self.mount = self._first
            origin = "the file's" if self._from_file else "the nominal one"
        return True, "%s: the mount is %s again: %s" % (self.name, origin, text_of(mount))

    def lines(self, latest, to_solve, to_check, camera=None, seen=True):
        """Lines of the text beside the camera. latest: Samples of the last seconds; seen: by motion capture, now."""
        if not seen:
            return ["%s: not seen by motion capture" % self.name]
        mount, params = self.mount, self._fit_params
        found = misses(latest, mount, params, camera)
        lines = ["%s: %s" % (self.name, found if found.right.size else "no landmark in view")]
        lines.append("window: %d bearings to solve on, %d to check on" % (len(to_solve.times_s), len(to_check.times_s)))
        if len(to_solve.times_s) < params.samples_min:
            lines.append("too few to solve")
        else:
            right = misses(to_solve, mount, params).right
            lines += weak_values(standard_deviations(to_solve.take(right), mount, params), params)
        return lines + ["left out: %d, %s" % (n, why) for why, n in sorted(self.window.refused.items())]


def numbers_of(mount):
    """(x, y, z [m], roll, pitch, yaw [deg]) of a CameraMount."""
    angles = (mount.roll_rad, mount.pitch_rad, mount.yaw_rad)
    return tuple(float(value) for value in mount.position_m) + tuple(math.degrees(angle) for angle in angles)


def mount_of(numbers):
    """CameraMount of (x, y, z [m], roll, pitch, yaw [deg]), cut at LIMITS."""
    cut = [float(np.clip(value, -limit, limit)) for value, limit in zip(numbers, LIMITS)]
    return CameraMount(tuple(cut[:3]), *map(math.radians, cut[3:]))


def text_of(mount):
    """Text of a mount."""
    rounded = [round(value, digits) + 0.0 for value, digits in zip(numbers_of(mount), (3, 3, 3, 2, 2, 2))]  # no -0.0
    return "x %.3f, y %.3f, z %.3f m, roll %.2f, pitch %.2f, yaw %.2f deg" % tuple(rounded)
