"""How well landmarks and vehicles are found in rendered pictures with known content, and how long a picture takes.

Simulated: labelled_pictures.py, seeded. A landmark counts when all of it is seen and its centre disc is at
least 14 px across; smaller and cut ones have rows of their own. A detection where no landmark of its name is counts as
false.
Times are those of one thread of this computer (OpenCV on one core), the best of three runs on each picture, so that
the effect of other programs on the caches does not count.
"""

import argparse
import json
import math
import pathlib
import sys
import time
from dataclasses import dataclass, field

import cv2
import numpy as np
from labelled_pictures import landmark_set
from picture_truth import LabelledRenderer

from risc_lab.frames import rotation_body_to_cortex
from risc_simulator.video.scene import CameraPose, Scene, VehiclePose, load_style
from risc_visual.vision.landmark_config import load_landmarks
from risc_visual.vision.landmark_detector import LandmarkDetector
from risc_visual.vision.overlay import draw_landmarks
from risc_visual.vision.vehicle_detector import VehicleDetector, load_vehicles

SIZE_MIN_PX, SEEN_MIN = 14.0, 0.98  # of landmarks that must be found
REQUIRED = {"recall": 0.97, "precision": 0.99, "error_median_px": 0.5, "ms_mean": 2.0}
BINS = {  # title: (unit, limits)
    "size": ("px", (7.0, 10.0, 14.0, 20.0, 30.0, 50.0, 100.0, math.inf)),
    "distance": ("m", (0.7, 1.0, 1.5, 2.0, 3.0, 4.0)),
    "obliqueness": ("deg", (0.0, 20.0, 40.0, 55.0, 70.0)),
    "blur": ("px", (0.0, 0.5, 2.0, 4.0, 6.0, math.inf)),
    "brightness": ("x", (0.3, 0.5, 0.8, 1.25, 2.0)),
    "seen": ("", (0.3, 0.5, 0.7, 0.9, SEEN_MIN, 1.0)),
}
REPEATS = 3  # of each picture; the fastest counts
CROP_PX, SHEET = 120, (6, 4)  # side of a crop; crops across and down a sheet
BEGIN, END = ("<!-- ./maap bench vision: %s -->" % word for word in ("begin", "end"))  # the tables' place in a document


@dataclass
class Count:
    """Detections of some landmarks."""

    wanted: int = 0
    found: int = 0
    false: int = 0
    errors_px: list = field(default_factory=list)
    errors_guessed_px: list = field(default_factory=list)  # without the camera's calibration
    errors_deg: list = field(default_factory=list)
    normalised: list = field(default_factory=list)  # squared errors over their covariances, 1 on average when right

    def row(self):
        """Figures as plain numbers; None without data."""
        claimed = self.found + self.false
        return {
            "wanted": self.wanted,
            "recall": self.found / self.wanted if self.wanted else None,
            "precision": self.found / claimed if claimed else None,
            "error_median_px": _percentile(self.errors_px, 50),
            "error_p95_px": _percentile(self.errors_px, 95),
            "error_guessed_median_px": _percentile(self.errors_guessed_px, 50),
            "error_guessed_p95_px": _percentile(self.errors_guessed_px, 95),
            "normalised_median": _percentile(self.normalised, 50),
            "normalised_p95": _percentile(self.normalised, 95),
            "bearing_rms_deg": float(np.sqrt(np.mean(np.square(self.errors_deg)))) if self.errors_deg else None,
        }


def _percentile(values, percent):
    return float(np.percentile(values, percent)) if values else None


class Judge:
    """Compares detections with the truth and counts the results."""

    def __init__(self, config):
        self._roi = {kind.name: kind.roi_name for kind in config.landmarks}
        self._scale, self._centre_m = config.ring_scale, config.discs.centre_diameter_m
        self.total = Count()
        self.bins = {title: [Count() for _ in limits[:-1]] for title, (_, limits) in BINS.items()}
        self.ms = []
        self.crops = {"hits": [], "misses": [], "false": []}

    def judge(self, sample, found, guessed, ms):
        """found, guessed: Detections with and without the sample's camera."""
        self.ms.append((ms, sum(truth.kind == "landmark" for truth in sample.truths)))
        used, used_guessed = set(), set()
        for truth in sample.truths:
            if truth.kind != "landmark" or truth.seen_fraction <= 0.0:
                continue
            hit, other = self._match(truth, found, used), self._match(truth, guessed, used_guessed)
            values = {
                "size": truth.diameter_px,
                "distance": truth.distance_m,
                "obliqueness": math.degrees(truth.obliqueness_rad),
                "blur": sample.conditions["blur_px"],
                "brightness": sample.conditions["gain"],
                "seen": truth.seen_fraction,
            }
            whole, large = truth.seen_fraction >= SEEN_MIN, truth.diameter_px >= SIZE_MIN_PX
            for title, value in values.items():
                if (whole or title == "seen") and (large or title == "size"):
                    self._note(_bin(self.bins[title], title, value), sample, truth, hit, other)
            if whole and large:
                self._note(self.total, sample, truth, hit, other)
                self._crop("hits" if hit else "misses", sample, truth.centre_px, found)
        for index, detection in enumerate(found):
            if index not in used:
                self._false(sample, detection)
                self._crop("false", sample, (detection.x, detection.y), found)

    def _match(self, truth, detections, used):
        """The detection of this landmark, or None."""
        reach_px = max(4.0, 0.5 * truth.diameter_px)
        best = None
        for index, detection in enumerate(detections):
            distance_px = math.hypot(detection.x - truth.centre_px[0], detection.y - truth.centre_px[1])
            if index not in used and detection.name == self._roi[truth.name] and distance_px <= reach_px:
                if best is None or distance_px < best[0]:
                    best = distance_px, index
        if best is None:
            return None
        used.add(best[1])
        return detections[best[1]]

    def _note(self, count, sample, truth, hit, other):
        if count is None:
            return
        count.wanted += 1
        if hit is not None:
            count.found += 1
            count.errors_px.append(math.hypot(hit.x - truth.centre_px[0], hit.y - truth.centre_px[1]))
            azimuth, elevation = sample.camera.bearings((hit.x, hit.y))
            count.errors_deg += [
                math.degrees(azimuth - truth.azimuth_rad),
                math.degrees(elevation - truth.elevation_rad),
            ]
            if hit.covariance is not None:
                xx, xy, yy = hit.covariance
                error_px = np.array((hit.x - truth.centre_px[0], hit.y - truth.centre_px[1]))
                count.normalised.append(error_px @ np.linalg.solve(((xx, xy), (xy, yy)), error_px) / 2.0)
        if other is not None:
            count.errors_guessed_px.append(math.hypot(other.x - truth.centre_px[0], other.y - truth.centre_px[1]))

    def _false(self, sample, detection):
        """Count a false detection in the bins of a landmark that looks like it: its size, distance, obliqueness."""
        major, minor = 2.0 * detection.outline.semi_major, 2.0 * detection.outline.semi_minor
        self.total.false += 1
        values = {
            "size": minor,
            "distance": sample.camera.K[0, 0] * self._centre_m / major,
            "obliqueness": math.degrees(math.acos(min(1.0, minor / major))),
            "blur": sample.conditions["blur_px"],
            "brightness": sample.conditions["gain"],
        }
        for title, value in values.items():
            count = _bin(self.bins[title], title, value)
            if count is not None:
                count.false += 1

    def _crop(self, kind, sample, centre_px, found):
        if len(self.crops[kind]) >= SHEET[0] * SHEET[1] or (kind == "hits" and len(self.ms) % 3):
            return
        picture = sample.image.copy()
        draw_landmarks(picture, found, self._scale)
        border = CROP_PX
        picture = cv2.copyMakeBorder(picture, border, border, border, border, cv2.BORDER_CONSTANT)
        x, y = (int(round(value)) + border - CROP_PX // 2 for value in centre_px)
        x, y = min(max(0, x), picture.shape[1] - CROP_PX), min(max(0, y), picture.shape[0] - CROP_PX)
        self.crops[kind].append(picture[y : y + CROP_PX, x : x + CROP_PX])

    def figures(self):
        """Everything as plain numbers."""
        result = {"total": self.total.row()}
        for title, (unit, limits) in BINS.items():
            result[title] = [
                dict(count.row(), low=low, high=None if math.isinf(high) else high, unit=unit)
                for count, low, high in zip(self.bins[title], limits, limits[1:])
            ]
        ms = [value for value, _ in self.ms]
        result["ms"] = {"mean": float(np.mean(ms)), "p50": _percentile(ms, 50), "p95": _percentile(ms, 95)}
        for count in sorted({count for _, count in self.ms}):
            result["ms"]["landmarks_%d" % count] = float(np.mean([value for value, n in self.ms if n == count]))
        result["pictures"] = len(ms)
        return result


def _bin(counts, title, value):
    """The Count whose range holds the value; None outside all. The last range holds its upper limit, too."""
    limits = BINS[title][1]
    if not limits[0] <= value <= limits[-1]:
        return None
    return counts[min(int(np.searchsorted(limits, value, side="right")) - 1, len(counts) - 1)]


def measure_landmarks(seed, count):
    """Judge of the landmark detector on a seeded set."""
    config = load_landmarks()
    judge = Judge(config)
    known, unknown = {}, LandmarkDetector(config)
    for sample in landmark_set(seed, count):
        detector = known.setdefault(sample.conditions["calibration"], LandmarkDetector(config, sample.camera))
        guessed = unknown.detect(sample.image)
        taken_s = []
        for _ in range(REPEATS):
            start_s = time.thread_time()
            found = detector.detect(sample.image)
            taken_s.append(time.thread_time() - start_s)
        judge.judge(sample, found, guessed, 1e3 * min(taken_s))
    return judge


def measure_vehicles(seed, count):
    """Figures of the vehicle detector: four vehicles that carry the cameras in turn, anywhere in the arena."""
    style = load_style()
    names = ["risc%d" % number for number in range(1, 5)]
    detector = VehicleDetector(load_vehicles(), names)
    cameras = [sample.camera for sample in landmark_set(seed, 6)]
    rng = np.random.default_rng(seed)
    wanted = found = false = 0
    errors_px, ms = [], []
    for index in range(count):
        observer = names[index % len(names)]
        position = np.array([rng.uniform(-1.6, 1.6), rng.uniform(-1.3, 1.3), rng.uniform(0.7, 1.8)])
        turn = rotation_body_to_cortex(*(rng.uniform(-1.0, 1.0, 3) * (0.12, 0.15, math.pi)))
        vehicles = []
        for number, name in enumerate(names):
            if name != observer and rng.random() < 0.6:
                ray = turn @ (1.0, rng.uniform(-0.5, 0.5), rng.uniform(-0.25, 0.25))
                attitude = rotation_body_to_cortex(*(rng.uniform(-1.0, 1.0, 3) * (0.15, 0.15, math.pi)))
                vehicles.append(VehiclePose(name, position + rng.uniform(1.0, 3.5) * ray, attitude, number))
        renderer = LabelledRenderer(cameras[index % len(cameras)], Scene(style), (seed, index))
        pose = CameraPose(position, turn)
        picture = renderer.render(pose, vehicles, gain=float(np.exp(rng.uniform(math.log(0.4), math.log(1.8)))))
        taken_s = []
        for _ in range(REPEATS):
            start_s = time.thread_time()
            detections = {detection.name: detection for detection in detector.detect(picture, observer)}
            taken_s.append(time.thread_time() - start_s)
        ms.append(1e3 * min(taken_s))
        for truth in renderer.truth(pose, vehicles):
            detection = detections.get(truth.name)
            x0, y0, x1, y1 = truth.box_px
            right = detection is not None and x0 <= detection.x <= x1 and y0 <= detection.y <= y1
            if right:
                del detections[truth.name]
            if truth.kind == "vehicle" and truth.seen_fraction >= 0.9:
                wanted += 1
                found += right
                if right:
                    error_px = math.hypot(detection.x - truth.centre_px[0], detection.y - truth.centre_px[1])
                    errors_px.append(error_px / max(x1 - x0, y1 - y0))
        false += len(detections)
    return {
        "pictures": count,
        "wanted": wanted,
        "recall": found / wanted if wanted else None,
        "precision": found / (found + false) if found + false else None,
        "error_median_share": _percentile(errors_px, 50),
        "ms_mean": float(np.mean(ms)),
    }


def markdown(figures, pictures=None):
    """The tables. pictures: path of their folder as seen from the document, None for none."""
    total, ms, vehicles = figures["total"], figures["ms"], figures["vehicles"]
    lines = [
        "%d rendered pictures of 640x360 (simulated; seed %d), %d landmarks that are seen whole and are at least "
        "%.0f px across." % (figures["pictures"], figures["seed"], total["wanted"], SIZE_MIN_PX),
        "",
        "| | aim | measured |",
        "|---|---|---|",
        "| recall | >= %.2f | %s |" % (REQUIRED["recall"], _text(total["recall"], "%.4f")),
        "| precision, all detections | >= %.2f | %s |" % (REQUIRED["precision"], _text(total["precision"], "%.4f")),
        "| centre error, median (p95), camera known | <= %.1f px | %s (%s) px |"
        % (REQUIRED["error_median_px"], _text(total["error_median_px"]), _text(total["error_p95_px"])),
        "| centre error, median (p95), raw picture without calibration | | %s (%s) px |"
        % (_text(total["error_guessed_median_px"]), _text(total["error_guessed_p95_px"])),
        "| bearing error, RMS per axis | <= 0.1 deg | %s deg |" % _text(total["bearing_rms_deg"], "%.3f"),
        "| squared error over its covariance, median (p95) | 0.69 (3.00) | %s (%s) |"
        % (_text(total["normalised_median"]), _text(total["normalised_p95"])),
        "| time per picture, best of three, mean (p50, p95), one core | <= %.0f ms | %.2f (%.2f, %.2f) ms |"
        % (REQUIRED["ms_mean"], ms["mean"], ms["p50"], ms["p95"]),
        "| time with 0, 1, ... landmarks in view | | %s ms |"
        % ", ".join("%.2f" % value for key, value in ms.items() if key.startswith("landmarks_")),
        "",
    ]
    lines += [
        "| | landmarks | recall | precision | centre error median / p95 | bearing RMS |",
        "|---|---|---|---|---|---|",
    ]
    for title in BINS:
        for row in figures[title]:
            limits = "from %g" % row["low"] if row["high"] is None else "%g to %g" % (row["low"], row["high"])
            name = {"seen": "share that is seen", "size": "least diameter"}.get(title, title)
            lines.append(
                "| %s %s %s | %d | %s | %s | %s / %s px | %s deg |"
                % (name, limits, row["unit"], row["wanted"], _text(row["recall"], "%.3f"),
                   "-" if title == "seen" else _text(row["precision"], "%.3f"), _text(row["error_median_px"]),
                   _text(row["error_p95_px"]), _text(row["bearing_rms_deg"], "%.3f"))
            )  # fmt: skip
    lines += [
        "",
        "Other vehicles by their hulls, %d pictures, %d vehicles that are seen to nine tenths at least: recall %s, "
        "precision %s, centre error %s of the outline's longer side (median), %.2f ms."
        % (vehicles["pictures"], vehicles["wanted"], _text(vehicles["recall"], "%.3f"),
           _text(vehicles["precision"], "%.3f"), _text(vehicles["error_median_share"]), vehicles["ms_mean"]),
    ]  # fmt: skip
    if pictures is not None:
        for kind, text in (("hits", "Found"), ("misses", "Missed"), ("false", "False detections")):
            if figures["crops"][kind]:
                lines += ["", "%s:" % text, "", "![%s](%s/%s.png)" % (text, pictures, kind)]
            else:
                lines += ["", "%s: none." % text]
    return "\n".join(lines) + "\n"


def _text(value, form="%.2f"):
    return "-" if value is None else form % value


def write_sheets(crops, folder):
    """Write hits.png, misses.png, false.png into a folder; those of earlier runs are removed."""
    folder.mkdir(parents=True, exist_ok=True)
    for kind, pieces in crops.items():
        path = folder / (kind + ".png")
        if path.exists():
            path.unlink()
        if pieces:
            across = min(SHEET[0], len(pieces))
            blank = [np.zeros((CROP_PX, CROP_PX, 3), np.uint8)] * (-len(pieces) % across)
            pieces = pieces + blank
            rows = [np.hstack(pieces[k : k + across]) for k in range(0, len(pieces), across)]
            if not cv2.imwrite(str(path), np.vstack(rows)):
                raise OSError("cannot write %s: check the folder's permissions and the disk" % path)


def write_tables(text, path):
    """Write the tables into a document, between its marks BEGIN and END; without marks, the file is the tables.

    Raises ValueError for a document with one of the marks only, OSError.
    """
    before, begin, rest = path.read_text(encoding="utf-8").partition(BEGIN) if path.exists() else ("", "", "")
    _, end, after = rest.partition(END)
    if begin and end:
        text = "%s%s\n%s%s%s" % (before, begin, text, end, after)
    elif begin or END in before:
        raise ValueError("%s: the tables' place needs the line %s and after it %s" % (path, BEGIN, END))
    path.write_text(text, encoding="utf-8")


def met(figures):
    """Names of the figures that miss their aims."""
    reached = dict(figures["total"], ms_mean=figures["ms"]["mean"])
    missed = [key for key in ("recall", "precision") if reached[key] is None or reached[key] < REQUIRED[key]]
    return missed + [
        key for key in ("error_median_px", "ms_mean") if reached[key] is None or reached[key] > REQUIRED[key]
    ]


def main(arguments=None):
    """Command line. Returns 1 when an aim is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=20)
    parser.add_argument("--count", type=int, default=1000, help="pictures (default 1000: some minutes)")
    parser.add_argument("--json", type=pathlib.Path, help="also write the figures here")
    parser.add_argument(
        "--markdown", type=pathlib.Path, metavar="FILE", help="write the tables here, between its marks if it has them"
    )
    parser.add_argument(
        "--pictures", type=pathlib.Path, metavar="DIR", help="write hits.png, misses.png, false.png here"
    )
    options = parser.parse_args(arguments)
    if options.count < 1:
        parser.error("--count must be at least 1")
    cv2.setNumThreads(1)
    judge = measure_landmarks(options.seed, options.count)
    figures = dict(judge.figures(), seed=options.seed, simulated=True)
    figures["vehicles"] = measure_vehicles(options.seed, max(1, options.count // 4))
    figures["crops"] = {kind: len(pieces) for kind, pieces in judge.crops.items()}
    folder = None
    if options.pictures and options.markdown:
        try:
            folder = options.pictures.resolve().relative_to(options.markdown.resolve().parent).as_posix()
        except ValueError:
            folder = options.pictures.resolve().as_posix()
    text = markdown(figures, folder)
    print(text)
    try:
        if options.json:
            options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
        if options.pictures:
            write_sheets(judge.crops, options.pictures)
        if options.markdown:
            write_tables(text, options.markdown)
    except (ValueError, OSError) as error:
        print("vision.py: %s" % error, file=sys.stderr)
        return 1
    missed = met(figures)
    if missed:
        print("misses its aim: %s" % ", ".join(missed), file=sys.stderr)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
