"""Bearing errors: what the vehicles' cameras measured against where things really were."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from data_extraction.flatten import seconds
from data_extraction.samples import Samples
from data_extraction.surroundings import Surroundings
from risc_estimation.bearings import make_camera
from risc_estimation.expected_bearings import Observer, bearings_of_points, look
from risc_lab.frames import wrap_angle

ANGLES, DETECTIONS = "/angles", "/detections"
GROUND_TRUTH, MOCAP_STATES = "/ground_truth", "/cortex_raw"
GROSS_ERROR_DEG = 3.0  # more is a mistaken identity, not a measurement error
LEAST_DIAMETER_PX = 14.0  # of a landmark's middle (or of a vehicle): what is smaller is not expected to be found
WHOLE = 0.999  # fraction of an outline in the picture from which on it counts as fully seen
_DELAYS_S = np.linspace(-0.1, 0.4, 51)
_DELAY_GAIN_DEG = 0.02  # delays that make no more difference to the errors than this cannot be told apart
_LATE_S = 0.01  # stamps that are later than this deserve a remark


class _Row(NamedTuple):
    stamp_s: float
    name: str  # of the object, as on /angles
    is_quad: bool
    visible: bool
    azimuth_deg: float
    elevation_deg: float
    covariance_px: tuple[float, float, float] | None = None  # [px^2] xx, xy, yy of its detection; None: not known


@dataclass
class TargetBearings:
    """One vehicle's bearings of one object."""

    name: str  # mocap template
    is_vehicle: bool = False
    stamps_s: list[float] = field(default_factory=list)  # of the bearings below
    errors_deg: list[tuple] = field(default_factory=list)  # (azimuth, elevation), measured minus true; all detections
    whole: list[bool] = field(default_factory=list)  # the object was fully in the picture
    normalised: list[float] = field(default_factory=list)  # see `_normalised`; NaN without a covariance
    pictures: int = 0  # whose true pose is known
    in_view: int = 0  # of them, those in which it was fully to be seen; 0 when the camera is not known
    seen: int = 0  # of these, those in which it was found
    out_of_view: int = 0  # detections while it was not to be seen at all: false alarms

    @property
    def judged_deg(self):
        """(n, 2) errors of the fully seen ones."""
        return np.array(self.errors_deg).reshape(-1, 2)[np.array(self.whole, dtype=bool)]

    def figures(self):
        """Numbers for the summary; None where there is nothing to tell."""
        judged, everything = self.judged_deg, np.array(self.errors_deg).reshape(-1, 2)
        bias, rms = _bias(judged), _rms(judged)
        whole = np.array(self.whole, dtype=bool)
        partial = everything[~whole]
        normalised = np.array(self.normalised)[whole & (np.abs(everything) <= GROSS_ERROR_DEG).all(axis=1)]
        normalised = normalised[np.isfinite(normalised)]
        return {
            "count": len(judged),
            "azimuth_bias_deg": bias[0],
            "elevation_bias_deg": bias[1],
            "azimuth_rms_deg": rms[0],
            "elevation_rms_deg": rms[1],
            "normalised_rms": float(np.sqrt(normalised.mean())) if len(normalised) else None,
            "gross": int((np.abs(judged) > GROSS_ERROR_DEG).any(axis=1).sum()),
            "in_view": self.in_view,
            "seen_percent": round(100.0 * self.seen / self.in_view, 2) if self.in_view else None,
            "false_alarms": self.out_of_view,
            "partial_count": len(partial),
            "partial_azimuth_rms_deg": _rms(partial)[0],
            "partial_elevation_rms_deg": _rms(partial)[1],
        }


@dataclass
class BearingStatistics:
    """All bearings of a bag against the truth."""

    truth: str  # "ground truth" or "mocap"
    landmarks_from: str  # "fleet" or "/states3"
    delay_s: float  # that the stamps were corrected by
    vehicles: dict[str, dict[str, TargetBearings]]  # observer -> object -> bearings
    best_delay_s: float | None = None  # the correction that explains the errors best; None = cannot be told
    best_delay_rms_deg: float | None = None  # both angles, with that correction
    notes: list[str] = field(default_factory=list)

    @property
    def has_judged(self):
        """Whether anything was fully seen, and hence has an error."""
        return any(any(target.whole) for targets in self.vehicles.values() for target in targets.values())

    def figures(self):
        """The part `bearings` of summary.json."""
        return {
            "truth": self.truth,
            "landmarks_from": self.landmarks_from,
            "delay_s": self.delay_s,
            "best_delay_s": self.best_delay_s,
            "best_delay_rms_deg": self.best_delay_rms_deg,
            "vehicles": {
                vehicle: {name: target.figures() for name, target in sorted(targets.items())}
                for vehicle, targets in sorted(self.vehicles.items())
            },
            "notes": self.notes,
        }


class BearingCollector:
    """Takes the messages of a bag one by one, keeps what `BearingStatistics` needs."""

    def __init__(self, fleet=None, rectified=True):
        """fleet: risc_lab.lab.Fleet, see Surroundings. rectified: whether vision worked on rectified pictures.

        Raises ValueError, from Surroundings.
        """
        self._fleet = fleet
        self._rectified = rectified
        self._surroundings = Surroundings(fleet, (GROUND_TRUTH, MOCAP_STATES))
        self._rows = {}  # observer, as on /angles -> Samples: those of a _Row, its name as an index into the next
        self._names = {}  # of objects, as on /angles -> index
        self._covariances = {}  # observer -> Samples: stamp, index of the name, xx, xy, yy

    def __call__(self, topic, receipt_s, message):
        """Take one message; topics that are of no interest are passed over."""
        if topic == ANGLES:
            stamp_s = seconds(message.header.stamp)
            for entry in message.Obj:
                rows = self._rows.setdefault(entry.name, Samples(6))
                for is_quad, angles in ((False, entry.landmarks), (True, entry.quads)):
                    for angle in angles:
                        index = self._names.setdefault(angle.name, len(self._names))
                        rows.append((stamp_s, index, is_quad, angle.visible, angle.azim, angle.elev))
        elif topic == DETECTIONS:
            stamp_s = seconds(message.header.stamp)
            rows = self._covariances.setdefault(message.name, Samples(5))
            for item in (*message.landmarks, *message.quads):
                if item.visible and item.covariance[0] > 0.0:
                    index = self._names.setdefault(item.name, len(self._names))
                    rows.append((stamp_s, index, item.covariance[0], item.covariance[1], item.covariance[3]))
        else:
            self._surroundings(topic, receipt_s, message)

    def wants(self, topic):
        """Whether messages of this topic say anything here."""
        return topic in (ANGLES, DETECTIONS) or self._surroundings.wants(topic)

    def landmarks(self):
        """{name: place (3,) [m], cortex frame} of the landmarks that motion capture saw."""
        return self._surroundings.landmarks()

    def statistics(self, delay_s=0.0):
        """BearingStatistics; None when the bag holds no bearings or nothing to compare them with.

        delay_s: a bearing stamped t was measured at t - delay_s.
        """
        surroundings = self._surroundings
        topic = GROUND_TRUTH if surroundings.tracks[GROUND_TRUTH] else MOCAP_STATES
        if not self._rows or not surroundings.tracks[topic]:
            return None
        from_fleet = topic == GROUND_TRUTH and bool(self._fleet and self._fleet.landmarks)
        discs = surroundings.discs(from_fleet)
        result = BearingStatistics(
            truth="ground truth" if topic == GROUND_TRUTH else "mocap",
            landmarks_from="fleet" if from_fleet else "/states3",
            delay_s=delay_s,
            vehicles={},
        )
        samples = []
        names = list(self._names)
        for name, compact in sorted(self._rows.items()):
            known = self._covariances[name].table().tolist() if name in self._covariances else []
            covariances = {(stamp_s, index): tuple(numbers) for stamp_s, index, *numbers in known}
            rows = [
                _Row(stamp_s, names[int(index)], bool(is_quad), bool(visible), azimuth_deg, elevation_deg,
                     covariances.get((stamp_s, index)))
                for stamp_s, index, is_quad, visible, azimuth_deg, elevation_deg in compact.table().tolist()
            ]  # fmt: skip
            try:
                vehicle = surroundings.vehicle(name)
                observer = self._observer(vehicle)
            except ValueError as error:
                result.notes.append(str(error))
                continue
            if observer.camera is None:
                result.notes.append("%s: no calibration, so nobody knows what was in view" % vehicle)
            targets = self._compare(vehicle, observer, rows, discs, topic, delay_s, result.notes)
            result.vehicles[vehicle] = targets
            samples += self._samples(vehicle, observer.mount, rows, targets, discs, topic)
        result.best_delay_s, result.best_delay_rms_deg = self._best_delay(samples, topic)
        if result.best_delay_s is not None and abs(result.best_delay_s - delay_s) > _LATE_S:
            result.notes.append(
                "the stamps look %.0f ms later than was assumed: correct video_latency of the driver, or the delay here"
                % (1e3 * (result.best_delay_s - delay_s))
            )
        return result

    def _observer(self, vehicle):
        calibration = self._surroundings.calibration(vehicle)
        camera = None if calibration is None else make_camera(calibration, self._rectified)
        return Observer(camera, self._surroundings.mount(vehicle))

    def _template(self, row):
        if row.is_quad:
            return self._surroundings.vehicle(row.name)
        return self._surroundings.catalogue.template_of_region.get(row.name, row.name)

    def _compare(self, vehicle, observer, rows, discs, topic, delay_s, notes):
        """{object: TargetBearings} of one vehicle's rows."""
        pictures = {}
        for row in rows:
            pictures.setdefault(row.stamp_s, []).append(row)
        stamps_s = np.array(sorted(pictures))
        poses = self._surroundings.tracks[topic][vehicle].at(stamps_s - delay_s)
        targets, unknown = {}, set()
        for stamp_s, known, position_m, R in zip(stamps_s, *poses):
            if not known:
                continue
            hulls = self._surroundings.hulls(topic, stamp_s - delay_s, without=vehicle)
            places = {item.name: item.centre_m for item in discs}
            places.update({hull.name: hull.position_m for hull in hulls})
            sightings = {}
            if observer.camera is not None:
                sightings = {item.name: item for item in look(observer, position_m, R, discs + hulls)}
            for row in pictures[stamp_s]:
                try:
                    name = self._template(row)
                except ValueError:
                    name = row.name
                if name not in places:
                    unknown.add(row.name)
                    continue
                target = targets.setdefault(name, TargetBearings(name, row.is_quad))
                true = bearings_of_points(places[name], position_m, R, observer.mount)
                _count(target, row, np.degrees(true), sightings.get(name), observer.camera)
        if unknown:
            notes.append("%s: nobody knows where %s was" % (vehicle, ", ".join(sorted(unknown))))
        return targets

    def _samples(self, vehicle, mount, rows, targets, discs, topic):
        """[(vehicle, mount, (n,) stamps, (n, 3) places, (n, 2) angles [deg])] of the landmarks it saw in full."""
        places = {disc.name: disc.centre_m for disc in discs}
        samples = []
        for name, target in targets.items():
            if name not in places:
                continue
            whole = {stamp for stamp, is_whole in zip(target.stamps_s, target.whole) if is_whole}
            taken = [
                row for row in rows if not row.is_quad and row.stamp_s in whole and row.visible
                and self._template(row) == name
            ]  # fmt: skip
            if taken:
                stamps_s = np.array([row.stamp_s for row in taken])
                angles = np.array([(row.azimuth_deg, row.elevation_deg) for row in taken])
                samples.append((vehicle, mount, stamps_s, np.array(places[name]), angles))
        return samples

    def _best_delay(self, samples, topic):
        """(delay [s], rms [deg]) that explains the bearings best; (None, None) when that cannot be told."""

        def rms_deg(delay_s):
            squares = []
            for vehicle, mount, stamps_s, place_m, angles_deg in samples:
                poses = self._surroundings.tracks[topic][vehicle].at(stamps_s - delay_s)
                true = bearings_of_points(place_m, poses.positions_m, poses.R_body_to_cortex, mount)
                error = np.degrees(wrap_angle(np.radians(angles_deg) - np.column_stack(true)))
                squares.append(error[poses.known] ** 2)
            squares = np.concatenate(squares)
            squares = squares[(squares < GROSS_ERROR_DEG**2).all(axis=1)]
            return float(np.sqrt(squares.mean())) if len(squares) else np.inf

        if not samples:
            return None, None
        values = [rms_deg(delay_s) for delay_s in _DELAYS_S]
        best = _DELAYS_S[int(np.argmin(values))]
        step = _DELAYS_S[1] - _DELAYS_S[0]
        found = minimize_scalar(rms_deg, bounds=(best - step, best + step), method="bounded")
        if not np.isfinite(found.fun) or max(values) - found.fun < _DELAY_GAIN_DEG:
            return None, None  # nothing moved, or nothing was right
        return round(float(found.x), 5), float(found.fun)


def _count(target, row, true_deg, sighting, camera):
    """Enter one row into a target's bearings. sighting: what should have been seen; None = the camera is not known."""
    target.pictures += 1
    whole = sighting is None or (sighting.fraction >= WHOLE and sighting.diameter_px >= LEAST_DIAMETER_PX)
    if sighting is not None and whole:
        target.in_view += 1
        target.seen += bool(row.visible)
    if not row.visible:
        return
    if sighting is not None and sighting.fraction == 0.0:
        target.out_of_view += 1
        return
    error = np.degrees(wrap_angle(np.radians((row.azimuth_deg - true_deg[0], row.elevation_deg - true_deg[1]))))
    target.stamps_s.append(row.stamp_s)
    target.errors_deg.append(tuple(error.tolist()))
    target.whole.append(whole)
    target.normalised.append(_normalised(row, error, camera))


def _normalised(row, error_deg, camera):
    """Error against its covariance: e' C^-1 e / 2, 1 on average when C is right; NaN when that is not known."""
    if row.covariance_px is None or camera is None:
        return np.nan
    pixel = camera.pixels_of_bearings(*np.radians((row.azimuth_deg, row.elevation_deg)))
    ends = np.array(camera.bearings(pixel + 0.5 * np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])))
    slope = ends[:, ::2] - ends[:, 1::2]  # of azimuth and elevation by x and y
    xx, xy, yy = row.covariance_px
    error = np.linalg.solve(slope, np.radians(error_deg))  # [px]
    return float(error @ np.linalg.solve(((xx, xy), (xy, yy)), error) / 2.0)


def _bias(errors):
    return [float(value) for value in errors.mean(axis=0)] if len(errors) else [None, None]


def _rms(errors):
    return [float(value) for value in np.sqrt((errors**2).mean(axis=0))] if len(errors) else [None, None]
