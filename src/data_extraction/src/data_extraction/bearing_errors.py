"""Bearing errors: the bearings that the vehicles' cameras measured, compared with the true ones."""

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from data_extraction.flatten import seconds
from data_extraction.recording import best_shift
from data_extraction.report.recorded_topics import Collector
from data_extraction.samples import Samples
from data_extraction.surroundings import Surroundings
from risc_estimation.bearings import make_camera
from risc_estimation.expected_bearings import Observer, bearings_of_points, look
from risc_lab.frames import wrap_angle

ANGLES, DETECTIONS = "/angles", "/detections"
GROUND_TRUTH, MOCAP_STATES = "/ground_truth", "/cortex_raw"
GROSS_ERROR_DEG = 3.0  # more is a mistaken identity, not a measurement error
LEAST_DIAMETER_PX = 14.0  # of a landmark's middle disc (or a vehicle): smaller ones are not expected to be found
WHOLE = 0.999  # least fraction of an outline in the picture that counts as fully seen
_DELAYS_S = np.linspace(-0.1, 0.4, 51)
_DELAY_GAIN_DEG = 0.02  # if the RMS error varies less than this over the delays, none of them can be chosen
_LATE_S = 0.01  # a larger difference from the assumed delay is noted


class TargetBearings:
    """One vehicle's bearings of one object."""

    def __init__(self, name, is_vehicle):
        """name: mocap template."""
        self.name, self.is_vehicle = name, is_vehicle
        # of every detection: stamp [s], azimuth, elevation, their errors (measured less true) [deg], whether the object
        # was fully in the picture (1, else 0), error against covariance (see `_normalised`; NaN without one)
        self.rows = Samples(7)
        self.in_view = 0  # pictures in which it should have been fully visible; 0 when the camera is not known
        self.seen = 0  # of these, those in which it was found
        self.out_of_view = 0  # detections while no part of it was in view: false alarms

    @property
    def judged(self):
        """(n, 7) rows of the detections in which the object was fully seen."""
        table = self.rows.table()
        return table[table[:, 5] > 0.0]

    @property
    def judged_deg(self):
        """(n, 2) azimuth and elevation errors [deg] of these detections."""
        return self.judged[:, 3:5]

    def figures(self):
        """Numbers for the summary; None where there are no data."""
        table, judged = self.rows.table(), self.judged
        errors, partial = judged[:, 3:5], table[table[:, 5] == 0.0, 3:5]
        gross = (np.abs(errors) > GROSS_ERROR_DEG).any(axis=1)
        normalised = judged[~gross & np.isfinite(judged[:, 6]), 6]
        bias = errors.mean(axis=0).tolist() if len(errors) else (None, None)
        rms, partial_rms = _rms(errors), _rms(partial)
        return {
            "count": len(errors),
            "azimuth_bias_deg": bias[0],
            "elevation_bias_deg": bias[1],
            "azimuth_rms_deg": rms[0],
            "elevation_rms_deg": rms[1],
            "normalised_rms": float(np.sqrt(normalised.mean())) if len(normalised) else None,
            "gross": int(gross.sum()),
            "in_view": self.in_view,
            "seen_percent": round(100.0 * self.seen / self.in_view, 2) if self.in_view else None,
            "false_alarms": self.out_of_view,
            "partial_count": len(partial),
            "partial_azimuth_rms_deg": partial_rms[0],
            "partial_elevation_rms_deg": partial_rms[1],
        }


@dataclass
class BearingStatistics:
    """All bearings of a bag, compared with the truth."""

    truth: str  # "ground truth" or "mocap"
    landmarks_from: str  # "fleet" or "/states3"
    delay_s: float  # correction that was subtracted from the stamps
    best_delay_s: float | None = None  # the correction that explains the errors best; None = undetermined
    best_delay_rms_deg: float | None = None  # both angles, with that correction
    vehicles: dict[str, dict[str, TargetBearings]] = field(default_factory=dict)  # observer -> object -> bearings
    notes: list[str] = field(default_factory=list)

    @property
    def has_judged(self):
        """Whether any object was fully seen, so that there are errors."""
        return any(len(target.judged) for targets in self.vehicles.values() for target in targets.values())

    def figures(self):
        """The part `bearings` of summary.json."""
        vehicles = {
            vehicle: {name: target.figures() for name, target in sorted(targets.items())}
            for vehicle, targets in sorted(self.vehicles.items())
        }
        return vars(self) | {"vehicles": vehicles}


class BearingCollector(Collector):
    """Takes the messages of a bag one by one, keeps what `BearingStatistics` needs."""

    topics = (ANGLES, DETECTIONS)

    def __init__(self, fleet=None):
        """fleet: risc_lab.lab.Fleet, see Surroundings. Raises ValueError, from there."""
        self._fleet = fleet
        self._surroundings = Surroundings(fleet, (GROUND_TRUTH, MOCAP_STATES))
        # observer, as on /angles -> stamp, index of the name, is a vehicle, visible, azimuth, elevation [deg]
        self._rows = defaultdict(lambda: Samples(6))
        # observer -> stamp, index of the name, xx, xy, yy [px^2] of its detection
        self._covariances = defaultdict(lambda: Samples(5))
        self._names = {}  # object's name, as on /angles -> index

    def __call__(self, topic, receipt_s, message):
        """Take one message; topics that are not needed are ignored."""
        if topic not in self.topics:
            self._surroundings(topic, receipt_s, message)
            return
        stamp_s, names = seconds(message.header.stamp), self._names
        if topic == DETECTIONS:
            for item in (*message.landmarks, *message.quads):
                if item.visible and item.covariance[0] > 0.0:
                    index = names.setdefault(item.name, len(names))
                    self._covariances[message.name].append((stamp_s, index, *item.covariance[[0, 1, 3]]))
            return
        for entry in message.Obj:
            for is_quad, angles in enumerate((entry.landmarks, entry.quads)):
                for angle in angles:
                    index = names.setdefault(angle.name, len(names))
                    self._rows[entry.name].append((stamp_s, index, is_quad, angle.visible, angle.azim, angle.elev))

    def wants(self, topic):
        """Whether messages of this topic are used."""
        return super().wants(topic) or self._surroundings.wants(topic)

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
        truth, landmarks = "ground truth" if topic == GROUND_TRUTH else "mocap", "fleet" if from_fleet else "/states3"
        result = BearingStatistics(truth, landmarks, delay_s)
        mounts = {}
        for name in sorted(self._rows):
            try:
                vehicle = surroundings.vehicle(name)
                calibration, mounts[vehicle] = surroundings.camera(vehicle)
                camera = None if calibration is None else make_camera(calibration, rectified=True)
            except ValueError as error:
                result.notes.append(str(error))
                continue
            if camera is None:
                text = "%s: what was in view is unknown: neither the bag nor the fleet file has a calibration"
                result.notes.append(text % vehicle)
            observer = Observer(camera, mounts[vehicle])
            result.vehicles[vehicle] = self._compare(name, vehicle, observer, discs, topic, delay_s, result.notes)
        result.best_delay_s, result.best_delay_rms_deg = self._best_delay(result.vehicles, mounts, discs, topic)
        if result.best_delay_s is not None and abs(result.best_delay_s - delay_s) > _LATE_S:
            result.notes.append(
                "the stamps look %.0f ms later than assumed: correct video_latency of the driver, or the delay here"
                % (1e3 * (result.best_delay_s - delay_s))
            )
        return result

    def _template(self, name, is_vehicle):
        """Mocap template of an object on /angles; its name there when unknown."""
        if not is_vehicle:
            return self._surroundings.catalogue.template_of_region.get(name, name)
        try:
            return self._surroundings.vehicle(name)
        except ValueError:
            return name

    def _compare(self, name, vehicle, observer, discs, topic, delay_s, notes):
        """{object: TargetBearings} of the bearings of the vehicle that /angles calls `name`."""
        rows = self._rows[name].table()
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        covariances = {(stamp, index): px for stamp, index, *px in self._covariances[name].table().tolist()}
        stamps_s, first = np.unique(rows[:, 0], return_index=True)
        poses = self._surroundings.tracks[topic][vehicle].at(stamps_s - delay_s)
        names, targets, unknown = list(self._names), {}, set()
        for stamp_s, picture, known, position_m, R in zip(stamps_s, np.split(rows, first[1:]), *poses):
            if not known:
                continue
            hulls = self._surroundings.hulls(topic, stamp_s - delay_s, without=vehicle)
            places = {item.name: item.centre_m for item in discs}
            places.update({hull.name: hull.position_m for hull in hulls})
            sightings = {}
            if observer.camera is not None:
                sightings = {item.name: item for item in look(observer, position_m, R, discs + hulls)}
            for _, index, is_vehicle, visible, *angles_deg in picture.tolist():
                template = self._template(names[int(index)], is_vehicle)
                if template not in places:
                    unknown.add(names[int(index)])
                    continue
                target = targets.setdefault(template, TargetBearings(template, bool(is_vehicle)))
                sighting = sightings.get(template)
                whole = sighting is None or (sighting.fraction >= WHOLE and sighting.diameter_px >= LEAST_DIAMETER_PX)
                if sighting is not None and whole:
                    target.in_view += 1
                    target.seen += bool(visible)
                if not visible:
                    continue
                if sighting is not None and sighting.fraction == 0.0:
                    target.out_of_view += 1
                    continue
                true = bearings_of_points(places[template], position_m, R, observer.mount)
                error = np.degrees(wrap_angle(np.radians(np.array(angles_deg) - np.degrees(true))))
                ratio = _normalised(angles_deg, error, covariances.get((stamp_s, index)), observer.camera)
                target.rows.append((stamp_s, *angles_deg, *error, whole, ratio))
        if unknown:
            notes.append("%s: the bag does not say where %s was" % (vehicle, ", ".join(sorted(unknown))))
        return targets

    def _best_delay(self, vehicles, mounts, discs, topic):
        """(delay [s], rms [deg]) that explains the bearings of landmarks best; (None, None) when none stands out."""
        places = {disc.name: np.array(disc.centre_m) for disc in discs}
        samples = [
            (vehicle, places[name], target.judged)
            for vehicle, targets in vehicles.items()
            for name, target in targets.items()
            if name in places
        ]

        def rms_deg(delay_s):
            squares = []
            for vehicle, place_m, table in samples:
                poses = self._surroundings.tracks[topic][vehicle].at(table[:, 0] - delay_s)
                true = bearings_of_points(place_m, poses.positions_m, poses.R_body_to_cortex, mounts[vehicle])
                error = np.degrees(wrap_angle(np.radians(table[:, 1:3]) - np.column_stack(true)))
                squares.append(error[poses.known] ** 2)
            squares = np.concatenate(squares)
            squares = squares[(squares < GROSS_ERROR_DEG**2).all(axis=1)]
            return float(np.sqrt(squares.mean())) if len(squares) else np.inf

        if not any(len(table) for _, _, table in samples):
            return None, None
        best_s, least, most = best_shift(rms_deg, _DELAYS_S)
        if not np.isfinite(least) or most - least < _DELAY_GAIN_DEG:
            return None, None  # nothing moved, or no bearing was right
        return round(best_s, 5), least


def _normalised(angles_deg, error_deg, covariance_px, camera):
    """Error against its covariance: e' C^-1 e / 2, 1 on average when C is right; NaN without covariance or camera."""
    if covariance_px is None or camera is None:
        return np.nan
    pixel = camera.pixels_of_bearings(*np.radians(angles_deg))
    ends = np.array(camera.bearings(pixel + 0.5 * np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])))
    slope = ends[:, ::2] - ends[:, 1::2]  # derivatives of azimuth and elevation by x and y [rad/px]
    xx, xy, yy = covariance_px
    error = np.linalg.solve(slope, np.radians(error_deg))  # [px]
    return float(error @ np.linalg.solve(((xx, xy), (xy, yy)), error) / 2.0)


def _rms(errors):
    return np.sqrt((errors**2).mean(axis=0)).tolist() if len(errors) else (None, None)
