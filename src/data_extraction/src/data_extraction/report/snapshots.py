"""A few pictures of every camera, with what was found in them."""

from collections import OrderedDict, defaultdict, deque
from typing import NamedTuple

import cv2

from data_extraction.camera_topics import GREEN, YELLOW, draw_outline, is_bottom, one_topic_each
from data_extraction.flatten import seconds
from data_extraction.report.recorded_topics import Collector, vehicle_of
from risc_lab.images import picture_from_msg

REGIONS = "/land_rois"
_SLOTS = 3  # pictures of one camera, spread over the bag; in each slot the one in which most was found
_RECENT = 6  # pictures that wait for their regions
_RECENT_REGIONS = 120  # regions that wait for their picture
_WIDTH_PX = 640
_QUALITY = 80  # [%] of the JPEG


class Snapshot(NamedTuple):
    """One picture, ready for a page."""

    vehicle: str  # namespace
    camera: str  # front or bottom
    stamp_s: float
    jpeg: bytes
    found: list[str]  # names of the objects drawn in
    has_regions: bool  # False: this picture was not searched


class SnapshotCollector(Collector):
    """Holds only the chosen pictures and the newest few."""

    def __init__(self, types, start_s, duration_s):
        """types: {topic: message type}; start_s, duration_s: of the bag."""
        pictures = one_topic_each(types)
        self.topics = {*pictures, REGIONS} if pictures else pictures
        self.notes = []  # what went wrong
        self._start_s = start_s
        self._slot_s = max(duration_s / _SLOTS, 1e-3)
        self._kept = {}  # (vehicle, camera, slot) -> (picture, its Risc_rois or None)
        self._recent = defaultdict(lambda: deque(maxlen=_RECENT))  # (vehicle, camera) -> (slot, picture)
        self._regions = OrderedDict()  # (vehicle, stamp) -> Risc_rois

    def __call__(self, topic, receipt_s, message):
        if topic != REGIONS:
            camera = (vehicle_of(topic, 2, ""), "bottom" if is_bottom(message) else "front")
            slot = min(max(int((receipt_s - self._start_s) / self._slot_s), 0), _SLOTS - 1)
            self._recent[camera].append((slot, message))
            self._offer((*camera, slot), message, self._regions.get((camera[0], _stamp(message))))
            return
        for regions in message.Obj:
            self._regions[regions.name, _stamp(message)] = regions
            if len(self._regions) > _RECENT_REGIONS:
                self._regions.popitem(last=False)
            for camera, recent in self._recent.items():
                for slot, picture in recent:
                    if camera[0] == regions.name and _stamp(picture) == _stamp(message):
                        self._offer((*camera, slot), picture, regions)

    def result(self, _end_s):
        """[Snapshot, ...] by vehicle and time."""
        snapshots, self.notes = [], []
        for (vehicle, camera, _), (picture, regions) in sorted(self._kept.items(), key=lambda item: item[0]):
            try:
                jpeg = _jpeg(draw_regions(picture_from_msg(picture), regions))
            except ValueError as error:
                self.notes.append("%s, %s camera: %s" % (vehicle, camera, error))
                continue
            found = [region.name for region in _found(regions)]
            stamp_s = seconds(picture.header.stamp)
            snapshots.append(Snapshot(vehicle, camera, stamp_s, jpeg, found, regions is not None))
        return snapshots

    def _offer(self, place, picture, regions):
        """Keep a picture when more was found in it than in the one that its slot has."""
        if place not in self._kept or _score(regions) > _score(self._kept[place][1]):
            self._kept[place] = (picture, regions)


def draw_regions(picture, regions):
    """A copy of a BGR picture with what was found in it: rotated rectangles and names. regions: Risc_rois or None."""
    drawn = picture.copy()
    for region in _found(regions):
        colour = YELLOW if any(region is quad for quad in regions.quads) else GREEN
        box = cv2.boxPoints(((region.x, region.y), (region.width, region.height), region.angle))
        draw_outline(drawn, box, region.name, colour, bold=True)
    return drawn


def _found(regions):
    return [item for item in (*regions.landmarks, *regions.quads) if item.visible] if regions is not None else []


def _score(regions):
    return regions is not None, len(_found(regions))


def _stamp(message):
    return message.header.stamp.sec, message.header.stamp.nanosec


def _jpeg(picture):
    height, width = picture.shape[:2]
    if width > _WIDTH_PX:
        size = (_WIDTH_PX, max(1, round(height * _WIDTH_PX / width)))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if not done:
        raise ValueError("a picture of %dx%d px cannot be compressed" % (width, height))
    return data.tobytes()
