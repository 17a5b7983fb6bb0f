"""Camera topics of a bag; outlines with names drawn into pictures."""

import cv2
import numpy as np

from data_extraction.report.recorded_topics import vehicle_of
from risc_lab.images import MESSAGES

PICTURES = ("image_raw", "image_rect_color")
GREEN, YELLOW = (80, 220, 80), (60, 220, 240)  # of landmarks, of vehicles
_COMPRESSED = "/compressed"
_BLACK = (0, 0, 0)


def picture_topics(types):
    """{topic: name of its pictures, e.g. image_raw} of the cameras' topics. types: {topic: message type}, see Bag."""
    names = {topic: topic.removesuffix(_COMPRESSED).rpartition("/")[2] for topic in sorted(types)}
    return {topic: name for topic, name in names.items() if types[topic] in MESSAGES and name in PICTURES}


def one_topic_each(types):
    """{topic} of the pictures to show, one for each vehicle: rectified before raw, compressed before raw pictures."""
    best = {}
    for topic, name in picture_topics(types).items():
        rank = (name != "image_rect_color", not topic.endswith(_COMPRESSED), topic)
        vehicle = vehicle_of(topic, 2)
        best[vehicle] = min(best.get(vehicle, rank), rank)
    return {topic for _, _, topic in best.values()}


def is_bottom(message):
    """Whether a picture or camera_info is of the bottom camera: they share topics, so its frame_id decides."""
    return message.header.frame_id.endswith("bottomcam")


def draw_outline(picture, outline_px, name, colour, bold=False):
    """Draw the outline (n, 2) of an object and its name into a BGR picture."""
    width, bits, font, scale, halo, room_px = (
        (2, 0, cv2.FONT_HERSHEY_SIMPLEX, 0.7, 5, 6) if bold else (1, 4, cv2.FONT_HERSHEY_PLAIN, 0.8, 3, 3)
    )
    points = np.rint(2.0**bits * outline_px).astype(np.int32)
    cv2.polylines(picture, [points], True, colour, width, cv2.LINE_AA, bits)
    left, top = outline_px.min(axis=0)
    corner = (max(0, int(left)), max(20 if bold else 10, int(top) - room_px))
    for bgr, thickness in ((_BLACK, halo), (colour, width)):
        cv2.putText(picture, name, corner, font, scale, bgr, thickness, cv2.LINE_AA)
