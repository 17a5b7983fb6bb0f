"""Grey pictures out of a folder or a bag, one after the other. Needs no ROS master."""

import pathlib

import cv2
import numpy as np

from data_extraction.bags import Bag
from risc_lab.images import MESSAGES, PictureError, picture_from_file, picture_from_msg

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".tif", ".tiff")


class FolderPictures:
    """The pictures of a folder, by name."""

    def __init__(self, folder, most):
        """folder: path. most: number of pictures to read; of more, evenly spread ones are taken."""
        self.name = str(folder)
        paths = sorted(path for path in pathlib.Path(folder).iterdir() if path.suffix.lower() in SUFFIXES)
        if not paths:
            raise PictureError("%s holds no pictures (%s)" % (folder, ", ".join(SUFFIXES)))
        self._paths = [paths[i] for i in _spread(len(paths), most)]
        self.count = len(self._paths)

    def __iter__(self):
        """Yield (name, picture); the picture is None when it cannot be read."""
        for path in self._paths:
            yield path.name, _grey(picture_from_file, path)


class BagPictures:
    """The pictures of one topic of a bag; they are named by their stamp."""

    def __init__(self, path, topic, most):
        """path: of the bag. topic: None when the bag has one picture topic only. most: as FolderPictures.

        Raises PictureError, which names the picture topics, and data_extraction.bags.BagError.
        """
        self._path = path
        with Bag(path) as bag:
            topics = {name: bag.topics[name] for name, kind in bag.types.items() if kind in MESSAGES}
        listing = ", ".join("%s (%d)" % item for item in sorted(topics.items()))
        if not topics:
            raise PictureError("%s has no topic with pictures: record the camera's image_raw" % path)
        if topic is None:
            if len(topics) > 1:
                raise PictureError("%s has several topics with pictures, choose one: %s" % (path, listing))
            topic = next(iter(topics))
        if topic not in topics:
            raise PictureError("%s has no pictures on %s; it has %s" % (path, topic, listing))
        self._topic = topic
        self._wanted = set(_spread(topics[topic], most))
        self.count = len(self._wanted)
        self.name = "%s, %s" % (path, topic)

    def __iter__(self):
        """Yield (stamp, picture); the picture is None when it cannot be read."""
        with Bag(self._path) as bag:
            for index, (_, _, message) in enumerate(bag.messages([self._topic])):
                if index in self._wanted:
                    stamp = message.header.stamp
                    yield "%d.%09d" % (stamp.sec, stamp.nanosec), _grey(picture_from_msg, message)


def open_pictures(source, topic=None, most=200):
    """FolderPictures or BagPictures of a path. Raises PictureError or BagError with cause and cure."""
    path = pathlib.Path(source).expanduser()
    if path.is_dir():
        if topic is not None:
            raise PictureError("%s is a folder: a topic is for bags" % path)
        return FolderPictures(path, most)
    if not path.exists():
        raise PictureError("%s: no such file or folder" % path)
    return BagPictures(path, topic, most)


def _spread(count, most):
    """Indices of at most `most` of `count` things, evenly spread."""
    return range(count) if count <= most else np.linspace(0, count - 1, most).round().astype(int).tolist()


def _grey(decode, source):
    """Grey picture (h, w) that `decode` makes of a source; None when it cannot."""
    try:
        return cv2.cvtColor(decode(source), cv2.COLOR_BGR2GRAY)
    except PictureError:
        return None
