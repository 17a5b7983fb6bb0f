"""Grey pictures out of a folder or a bag, one after the other. Needs no ROS master."""

import pathlib

import cv2
import numpy as np

from data_extraction.bags import Bag
from risc_lab.images import MESSAGES, PictureError, picture_from_file, picture_from_msg

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".tif", ".tiff")


def open_pictures(source, topic=None, most=200):
    """(text that names the source, number of pictures, iterator of (name, picture)) of a path.

    topic: of a bag; None when only one has pictures. most: number of pictures to read; of more, evenly spread
    ones are taken. A picture is grey (h, w), None when it cannot be read; those of a bag are named by their stamp.
    Raises PictureError or data_extraction.bags.BagError with cause and remedy.
    """
    path = pathlib.Path(source).expanduser()
    if not path.exists():
        raise PictureError("%s: no such file or folder" % path)
    if path.is_dir():
        if topic is not None:
            raise PictureError("%s is a folder: a topic is for bags" % path)
        paths = sorted(item for item in path.iterdir() if item.suffix.lower() in SUFFIXES)
        if not paths:
            raise PictureError("%s holds no pictures (%s)" % (path, ", ".join(SUFFIXES)))
        paths = [paths[i] for i in _spread(len(paths), most)]
        return str(path), len(paths), ((item.name, _grey(picture_from_file, item)) for item in paths)
    with Bag(path) as bag:
        topics = {name: bag.topics[name] for name, kind in sorted(bag.types.items()) if kind in MESSAGES}
    listing = ", ".join("%s (%d)" % item for item in topics.items())
    if not topics:
        raise PictureError("%s has no topic with pictures: record the camera's image_raw" % path)
    if topic is None and len(topics) > 1:
        raise PictureError("%s has several topics with pictures, choose one: %s" % (path, listing))
    topic = topic or next(iter(topics))
    if topic not in topics:
        raise PictureError("%s has no pictures on %s; it has %s" % (path, topic, listing))
    wanted = set(_spread(topics[topic], most))
    return "%s, %s" % (path, topic), len(wanted), _pictures_of_bag(path, topic, wanted)


def _pictures_of_bag(path, topic, wanted):
    with Bag(path) as bag:
        for index, (_, _, message) in enumerate(bag.messages([topic])):
            if index in wanted:
                stamp = message.header.stamp
                yield "%d.%09d" % (stamp.sec, stamp.nanosec), _grey(picture_from_msg, message)


def _spread(count, most):
    """Indices of at most `most` of `count` things, evenly spread."""
    return range(count) if count <= most else np.linspace(0, count - 1, most).round().astype(int).tolist()


def _grey(decode, source):
    """Grey picture (h, w) that `decode` makes of a source; None when it cannot."""
    try:
        return cv2.cvtColor(decode(source), cv2.COLOR_BGR2GRAY)
    except PictureError:
        return None
