"""Conversions between messages (degrees, risc_msgs) and internal values (SI units): the only place for them."""

import math

from std_msgs.msg import Header

from risc_control.safety import FailsafeLevel, Rule, Verdict
from risc_maap_msgs.msg import Detection, Detections
from risc_msgs.msg import Observed_rois, Risc_roi, Risc_rois

FRAME_ID = "cortex"
_UNKNOWN = (-1.0, 0.0, -1.0)  # covariance: xx, xy, yy


def verdict_from_msg(msg):
    """Safety -> Verdict, without ages."""
    return Verdict(FailsafeLevel(msg.level), msg.reason, msg.operator, Rule(msg.rule))


def rois_of_picture(header, observer, names, landmarks, others, vehicles):
    """Observed_rois of one picture: every landmark and vehicle that is looked for, seen or not.

    header: of the picture; its stamp is kept. observer: namespace of the vehicle that took it. names, others: of
    landmarks and vehicles; landmarks, vehicles: lists of Detection and of VehicleDetection, best first.
    """
    entry = Risc_rois(observer, _each(_roi, names, landmarks), _each(_roi, others, vehicles))
    return Observed_rois(Header(stamp=header.stamp, frame_id=FRAME_ID), [entry])


def detections_of_picture(header, observer, names, landmarks, others, vehicles):
    """Detections of one picture: as `rois_of_picture`, but without rounding, and with ellipses and covariances."""
    found = _each(_landmark_detection, names, landmarks), _each(_vehicle_detection, others, vehicles)
    return Detections(header, observer, *found)


def _each(make, names, found):
    """make(name, best found item of that name or None) for each name."""
    best = {}
    for item in found:
        best.setdefault(item.name, item)
    return [make(name, best.get(name)) for name in names]


def _roi(name, item):
    if item is None:
        return Risc_roi(name, False, 0, 0, 0.0, 0.0, 0.0)
    return Risc_roi(name, True, round(item.x), round(item.y), item.width, item.height, item.angle)


def _landmark_detection(name, item):
    if item is None:
        return Detection(name=name)
    xx, xy, yy = item.covariance or _UNKNOWN
    shape = item.outline.semi_major, item.outline.semi_minor, item.outline.angle_rad
    return Detection(name, True, item.partial, item.x, item.y, (xx, xy, xy, yy), *shape)


def _vehicle_detection(name, item):
    if item is None:
        return Detection(name=name)
    xx, xy, yy = _UNKNOWN
    turned = item.height > item.width
    shape = 0.5 * max(item.width, item.height), 0.5 * min(item.width, item.height), item.angle + 90.0 * turned
    return Detection(name, True, item.partial, item.x, item.y, (xx, xy, xy, yy), *shape[:2], math.radians(shape[2]))
