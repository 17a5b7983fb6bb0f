"""Pictures of a bag with labels from motion capture, as a COCO data set (thesis 4.4.4: automatic image labelling)."""

import functools
import json
import pathlib
from dataclasses import dataclass
from typing import Annotated, Literal

import cv2
import numpy as np
from msgspec import Meta

from data_extraction import camera_topics
from data_extraction.bags import Bag, BagError
from data_extraction.flatten import seconds
from data_extraction.progress import Progress
from data_extraction.report.recorded_topics import vehicle_of
from data_extraction.surroundings import LANDMARKS, Surroundings
from risc_estimation.bearings import make_camera
from risc_estimation.expected_bearings import LANDMARK, VEHICLE, Observer, look
from risc_lab.images import MESSAGES, picture_from_msg
from risc_lab.settings import Positive, Settings


@dataclass(frozen=True)
class LabelParams(Settings):
    """Settings of the labelling."""

    delay_s: float = 0.0  # a picture stamped t shows the world at t - delay_s
    min_fraction: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.25  # least part of an object that must be in the picture
    min_size_px: Positive = 6.0  # least width and height of its box
    max_distance_m: Positive = 6.0
    every: Annotated[int, Meta(ge=1)] = 1  # take every nth picture of a camera
    overlay: bool = False  # also write the pictures with their labels drawn in
    format: Literal["jpg", "png"] = "jpg"  # of the pictures
    states_topic: str = "/cortex_raw"


def label(bag_path, folder, fleet=None, params=None, topics=None, progress=None):
    """Write the pictures of a bag and one labels.json into a folder. Returns (path of that file, number of pictures, of
    labels, of pictures left out because motion capture did not see their vehicle at that time).

    fleet: risc_lab.lab.Fleet, see Surroundings. topics: of the pictures; None = all that there are.
    Raises BagError for a bag that lacks something, ValueError for calibrations that are not usable, OSError when the
    folder cannot be written.
    """
    params, progress = params or LabelParams(), progress or Progress()
    surroundings = Surroundings(fleet, (params.states_topic,))
    with Bag(bag_path) as bag:
        topics = _picture_topics(bag, topics)
        if not bag.topics.get(params.states_topic):
            raise BagError(
                "%s has no %s, which says where the vehicles were: record it, or name another topic with --states"
                % (bag.path, params.states_topic)
            )
        for message in bag.messages([topic for topic in bag.topics if surroundings.wants(topic)]):
            surroundings(*message)
        data_set = _DataSet(pathlib.Path(folder), surroundings, params)
        seen = dict.fromkeys(topics, 0)
        for topic, _, message in bag.messages(topics):
            seen[topic] += 1
            if (seen[topic] - 1) % params.every == 0:
                try:
                    data_set.add(topic, message)
                except ValueError as error:
                    raise BagError("%s, %s: %s" % (bag.path, topic, error)) from error
                progress.show("labelling", "%d pictures" % len(data_set.images))
    if not data_set.images:
        raise BagError(
            "%s: no picture could be labelled: %s does not say where the vehicle was at any picture's time. Are "
            "both stamped by the same clock, and is the delay (%g s) right?"
            % (bag_path, params.states_topic, params.delay_s)
        )
    return data_set.write(bag_path), len(data_set.images), len(data_set.annotations), data_set.without_pose


class _DataSet:
    """Collects COCO's images, annotations and categories; writes each picture at once."""

    def __init__(self, folder, surroundings, params):
        self._folder, self._surroundings, self._params = folder, surroundings, params
        self._observer = functools.cache(self._new_observer)
        self._discs = surroundings.discs()
        self.images, self.annotations, self.without_pose = [], [], 0
        names = [(disc.name, LANDMARK) for disc in self._discs]
        names += [(name, VEHICLE) for name in sorted(surroundings.tracks[params.states_topic])]
        self._categories = [{"id": k, "name": name, "supercategory": kind} for k, (name, kind) in enumerate(names, 1)]
        self._numbers = {category["name"]: category["id"] for category in self._categories}
        self._folders = [folder / name for name in ("images", "overlays")[: 1 + params.overlay]]
        for path in self._folders:
            path.mkdir(parents=True, exist_ok=True)

    def add(self, topic, message):
        """Label and write one picture."""
        params, surroundings, stamp = self._params, self._surroundings, message.header.stamp
        picture = picture_from_msg(message)
        vehicle = surroundings.vehicle(vehicle_of(topic, 2, ""))
        exposure_s = seconds(stamp) - params.delay_s
        pose = surroundings.tracks[params.states_topic][vehicle].at(exposure_s)
        if not pose.known[0]:
            self.without_pose += 1
            return
        observer = self._observer(topic, vehicle, camera_topics.is_bottom(message), picture.shape)
        targets = self._discs + surroundings.hulls(params.states_topic, exposure_s, without=vehicle)
        sightings = look(observer, pose.positions_m[0], pose.R_body_to_cortex[0], targets)
        sightings = [sighting for sighting in sightings if self._is_labelled(sighting)]
        name = "%s_%d%09d.%s" % (topic.strip("/").replace("/", "_"), stamp.sec, stamp.nanosec, params.format)
        contents = (picture, draw(picture, sightings)) if params.overlay else (picture,)
        for folder, content in zip(self._folders, contents):
            if not cv2.imwrite(str(folder / name), content):
                raise OSError("cannot write %s" % (folder / name))
        self.images.append(
            {
                "id": len(self.images) + 1,
                "file_name": "images/" + name,
                "width": picture.shape[1],
                "height": picture.shape[0],
                "vehicle": vehicle,
                "topic": topic,
                "stamp": round(seconds(stamp), 9),
                "exposure": round(exposure_s, 9),
            }
        )
        for sighting in sightings:
            self.annotations.append(self._annotation(sighting))

    def write(self, bag_path):
        """Write labels.json. Returns its path."""
        topics = (self._params.states_topic, LANDMARKS)
        info = {
            "description": "labelled from motion capture (%s, %s) by label_images.py" % topics,
            "bag": str(bag_path),
            "delay_s": self._params.delay_s,
            "coordinates": "pixels from the top left corner of the picture; the middle of its first pixel is at "
            "(0.5, 0.5)",
        }
        content = {"info": info, "images": self.images, "annotations": self.annotations, "categories": self._categories}
        path = self._folder / "labels.json"
        path.write_text(json.dumps(content, allow_nan=False) + "\n", encoding="utf-8")
        return path

    def _new_observer(self, topic, vehicle, bottom, shape):
        calibration, mount = self._surroundings.camera(vehicle, bottom)
        if calibration is None:
            raise ValueError(
                "no calibration of this camera: record camera_info beside the pictures, or give a fleet file whose "
                "vehicle %s has a `calibration`" % vehicle
            )
        if (calibration.height_px, calibration.width_px) != shape[:2]:
            raise ValueError(
                "its pictures are %dx%d, its calibration is for %dx%d: calibrate the camera at the size it is used"
                % (shape[1], shape[0], calibration.width_px, calibration.height_px)
            )
        return Observer(make_camera(calibration, "image_rect" in topic), mount)

    def _is_labelled(self, sighting):
        if sighting.fraction < self._params.min_fraction or sighting.distance_m > self._params.max_distance_m:
            return False
        x0, y0, x1, y1 = sighting.box_px
        return min(x1 - x0, y1 - y0) >= self._params.min_size_px

    def _annotation(self, sighting):
        # COCO counts from the corner of the picture, OpenCV and the messages from the middle of its first pixel
        outline, centre = sighting.outline_px + 0.5, sighting.centre_px + 0.5
        box = (*outline.min(axis=0), *np.ptp(outline, axis=0))
        return {
            "id": len(self.annotations) + 1,
            "image_id": len(self.images),
            "category_id": self._numbers[sighting.name],
            "bbox": _rounded(box),
            "segmentation": [_rounded(outline.ravel())],
            "area": round(float(cv2.contourArea(outline.astype(np.float32))), 2),
            "iscrowd": 0,
            "center": _rounded(centre) if np.isfinite(centre).all() else None,  # None: outside what the lens sees
            "distance": round(sighting.distance_m, 4),
            "azimuth_deg": round(float(np.degrees(sighting.azimuth_rad)), 4),
            "elevation_deg": round(float(np.degrees(sighting.elevation_rad)), 4),
            "fraction": round(sighting.fraction, 4),
        }


def draw(picture, sightings):
    """A copy of the picture with the outlines, centres and names of the visible objects."""
    drawn = picture.copy()
    for sighting in sightings:
        colour = camera_topics.GREEN if sighting.kind == LANDMARK else camera_topics.YELLOW
        text = "%s %.1f m" % (sighting.name, sighting.distance_m)
        camera_topics.draw_outline(drawn, sighting.outline_px, text, colour)
        if np.isfinite(sighting.centre_px).all():
            cv2.drawMarker(drawn, np.rint(sighting.centre_px).astype(int).tolist(), colour, cv2.MARKER_CROSS, 7)
    return drawn


def _picture_topics(bag, wanted):
    """The topics that are labelled: those asked for, else all that are named like a camera's."""
    bag.require(wanted or ())
    for topic in wanted or ():
        if bag.types[topic] not in MESSAGES:
            raise BagError("%s, %s is not an image topic; its type is %s" % (bag.path, topic, bag.types[topic]))
    found = list(wanted or camera_topics.picture_topics(bag.types))
    if not found:
        raise BagError(
            "%s has no pictures (no topic ends in %s): record with the cameras, or name the topics with --topics; %s"
            % (bag.path, " or ".join(camera_topics.PICTURES), bag.contents)
        )
    return found


def _rounded(values):
    return [round(float(value), 2) for value in values]
