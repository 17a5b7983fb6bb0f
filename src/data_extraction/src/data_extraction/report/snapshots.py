"""A few pictures of every camera, with what was found in them."""

from collections import OrderedDict, deque
from typing import NamedTuple

import cv2
import numpy as np

from data_extraction.labels import PICTURES
from data_extraction.surroundings import is_bottom, namespace_of
from risc_lab.images import MESSAGES, picture_from_msg

REGIONS = "/land_rois"
_SLOTS = 3  # pictures of one camera, spread over the bag; in each slot the one in which most was found
_RECENT = 6  # pictures that wait for their regions
_RECENT_REGIONS = 120  # regions that wait for their picture
_COMPRESSED = "/compressed"
_WIDTH_PX = 640
_QUALITY = 80  # [%] of the JPEG
_GREEN, _YELLOW, _BLACK = (80, 220, 80), (60, 220, 240), (0, 0, 0)


class Snapshot(NamedTuple):
    """One picture, ready for a page."""

    vehicle: str  # namespace
    camera: str  # front or bottom
    stamp_s: float
    jpeg: bytes
    found: list[str]  # names of what is drawn in
    has_regions: bool  # False: nobody looked at this picture


class _Kept(NamedTuple):
    message: object
    regions: object  # Risc_rois of the picture; None = none came


def picture_topics(types):
    """{topic} of the pictures to take, one for each camera: rectified before raw, compressed before raw pictures.

    types: {topic: message type}, as Bag.types.
    """
    best = {}
    for topic, kind in sorted(types.items()):
        base = topic[: -len(_COMPRESSED)] if topic.endswith(_COMPRESSED) else topic
        name = base.rpartition("/")[2]
        if kind in MESSAGES and name in PICTURES:
            rank = (name != "image_rect_color", not topic.endswith(_COMPRESSED))
            best[namespace_of(topic)] = min(best.get(namespace_of(topic), (rank, topic)), (rank, topic))
    return {topic for _, topic in best.values()}


class SnapshotCollector:
    """Takes the messages of a bag one by one, holds only the chosen pictures and the newest few."""

    def __init__(self, types, start_s, duration_s):
        """types: {topic: message type}; start_s, duration_s: of the bag."""
        self.topics = picture_topics(types)
        self._start_s = start_s
        self._slot_s = max(duration_s / _SLOTS, 1e-3)
        self._kept = {}  # (vehicle, camera) -> {slot: _Kept}
        self._recent = {}  # (vehicle, camera) -> deque of (slot, message)
        self._regions = OrderedDict()  # (vehicle, stamp) -> Risc_rois

    def wants(self, topic):
        """Whether messages of this topic say anything here."""
        return topic in self.topics or (topic == REGIONS and bool(self.topics))

    def __call__(self, topic, receipt_s, message):
        """Take one message; topics that are of no interest are passed over."""
        if topic in self.topics:
            self._take_picture(namespace_of(topic), receipt_s, message)
        elif topic == REGIONS and self.topics:
            for regions in message.Obj:
                self._take_regions(regions, _stamp(message))

    def snapshots(self):
        """([Snapshot, ...] by vehicle and time, [what went wrong])."""
        snapshots, notes = [], []
        for (vehicle, camera), slots in sorted(self._kept.items()):
            for _, kept in sorted(slots.items()):
                try:
                    jpeg = _jpeg(draw_regions(picture_from_msg(kept.message), kept.regions))
                except ValueError as error:
                    notes.append("%s, %s camera: %s" % (vehicle, camera, error))
                    continue
                found = _found(kept.regions)
                sec, nanosec = _stamp(kept.message)
                snapshots.append(
                    Snapshot(
                        vehicle,
                        camera,
                        sec + 1e-9 * nanosec,
                        jpeg,
                        [region.name for region in found],
                        kept.regions is not None,
                    )
                )
        return snapshots, notes

    def _take_picture(self, vehicle, receipt_s, message):
        camera = (vehicle, "bottom" if is_bottom(message) else "front")
        slot = min(max(int((receipt_s - self._start_s) / self._slot_s), 0), _SLOTS - 1)
        self._recent.setdefault(camera, deque(maxlen=_RECENT)).append((slot, message))
        self._offer(camera, slot, _Kept(message, self._regions.get((vehicle, _stamp(message)))))

    def _take_regions(self, regions, stamp):
        self._regions[regions.name, stamp] = regions
        if len(self._regions) > _RECENT_REGIONS:
            self._regions.popitem(last=False)
        for camera, recent in self._recent.items():
            for slot, message in recent:
                if camera[0] == regions.name and _stamp(message) == stamp:
                    self._offer(camera, slot, _Kept(message, regions))

    def _offer(self, camera, slot, offered):
        """Keep a picture when more was found in it than in the one that its slot has."""
        slots = self._kept.setdefault(camera, {})
        if slot not in slots or _score(offered) > _score(slots[slot]):
            slots[slot] = offered


def draw_regions(picture, regions):
    """A copy of a BGR picture with what was found in it: rotated rectangles and names. regions: Risc_rois or None."""
    drawn = picture.copy()
    quads = {id(region) for region in regions.quads} if regions is not None else set()
    for region in _found(regions):
        colour = _YELLOW if id(region) in quads else _GREEN
        box = cv2.boxPoints(((region.x, region.y), (region.width, region.height), region.angle))
        cv2.polylines(drawn, [np.rint(box).astype(np.int32)], True, colour, 2, cv2.LINE_AA)
        corner = (max(0, int(box[:, 0].min())), max(20, int(box[:, 1].min()) - 6))
        for bgr, thickness in ((_BLACK, 5), (colour, 2)):
            cv2.putText(drawn, region.name, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.7, bgr, thickness, cv2.LINE_AA)
    return drawn


def _found(regions):
    if regions is None:
        return []
    return [region for region in (*regions.landmarks, *regions.quads) if region.visible]


def _score(kept):
    return (kept.regions is not None, len(_found(kept.regions)))


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
