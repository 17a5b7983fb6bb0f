"""Landmarks in picture files: `rosrun risc_visual detect_landmarks IMAGE...`. Needs no ROS master."""

import argparse
import json
import pathlib
import sys

import cv2

from risc_lab.camera import Camera
from risc_lab.images import PictureError, picture_from_file
from risc_lab.lab.calibration import load_calibration
from risc_visual.vision.landmark_config import load_landmarks
from risc_visual.vision.landmark_detector import LandmarkDetector
from risc_visual.vision.overlay import draw_landmarks

_DIGITS = 2  # of a pixel


def as_json(image, detections):
    """The line of one picture."""
    found = [
        {
            "name": d.name,
            "x": round(d.x, _DIGITS),
            "y": round(d.y, _DIGITS),
            "width": round(d.width, _DIGITS),
            "height": round(d.height, _DIGITS),
            "angle": round(d.angle, _DIGITS),
        }
        for d in detections
    ]
    return json.dumps({"image": image, "detections": found})


def as_table(image, detections):
    """The lines of one picture."""
    lines = ["%s: %s" % (image, "nothing" if not detections else "%d found" % len(detections))]
    if detections:
        lines.append("  %-10s %8s %8s %8s %8s %7s %6s" % ("name", "x", "y", "width", "height", "angle", "score"))
    lines += [
        "  %-10s %8.2f %8.2f %8.2f %8.2f %7.2f %6.2f%s"
        % (d.name, d.x, d.y, d.width, d.height, d.angle, d.score, "  part" if d.partial else "")
        for d in detections
    ]
    return "\n".join(lines)


def main(arguments=None):
    """Command line. Returns 1 when a picture could not be read or an overlay not be written, else 0."""
    parser = argparse.ArgumentParser(
        prog="detect_landmarks", description="Find the laboratory's landmarks in pictures."
    )
    parser.add_argument("images", nargs="+", metavar="IMAGE")
    parser.add_argument("--json", action="store_true", help="one JSON object a picture and line instead of a table")
    parser.add_argument("--overlay", type=pathlib.Path, metavar="DIR", help="write pictures with what was found here")
    parser.add_argument(
        "--config", metavar="YAML", help="landmarks, paints, thresholds (default: config/landmark_detector.yaml)"
    )
    parser.add_argument("--calibration", metavar="YAML", help="of the camera: centres of tilted discs are then exact")
    options = parser.parse_args(arguments)
    try:
        config = load_landmarks(options.config)
        camera = Camera(load_calibration(_url(options.calibration))) if options.calibration else None
        if options.overlay:
            options.overlay.mkdir(parents=True, exist_ok=True)
    except (ValueError, OSError) as error:
        parser.error(str(error))
    detector = LandmarkDetector(config, camera)
    failed = False
    written = set()
    for image in options.images:
        try:
            picture = picture_from_file(image)
            size = picture.shape[1], picture.shape[0]
            if camera is not None and size != (camera.width_px, camera.height_px):
                raise PictureError(
                    "it is %dx%d, the calibration is for %dx%d: give the one of its camera, or none"
                    % (size + (camera.width_px, camera.height_px))
                )
            detections = detector.detect(picture)
            if options.overlay:
                draw_landmarks(picture, detections, config.ring_scale)
                _write(picture, _free_name(options.overlay, image, written))
        except PictureError as error:
            failed = True
            if options.json:
                print(json.dumps({"image": image, "detections": [], "error": str(error)}), flush=True)
            else:
                print("%s: %s" % (image, error), file=sys.stderr, flush=True)
            continue
        print(as_json(image, detections) if options.json else as_table(image, detections), flush=True)
    return 1 if failed else 0


def _url(path):
    """A file that is there is meant, even where its bare name would mean one of the package's."""
    return str(pathlib.Path(path).absolute()) if pathlib.Path(path).exists() else path


def _free_name(folder, image, written):
    """Path in the folder for a picture's overlay; pictures of the same name from several folders get numbers."""
    stem, number = pathlib.Path(image).stem, 1
    path = folder / (stem + ".png")
    while path in written:
        number += 1
        path = folder / ("%s_%d.png" % (stem, number))
    written.add(path)
    return path


def _write(picture, path):
    try:
        good = cv2.imwrite(str(path), picture)
    except cv2.error:
        good = False
    if not good:
        raise PictureError("cannot write %s: check the folder's permissions and the disk" % path)
