"""Reading bags: every problem with a bag is one BagError that names the cause and the cure."""

import contextlib
import pathlib

from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag1 import ReaderError
from rosbags.serde import SerdeError


class BagError(ValueError):
    """A bag that cannot be used, with cause and cure."""


class Bag:
    """A ROS 1 bag, opened for reading. Use as a context manager.

    The message definitions come from the bag itself, so bags of other versions and of other packages can be read too.
    """

    def __init__(self, path):
        self.path = pathlib.Path(path)
        self._reader = None

    def __enter__(self):
        if not self.path.is_file():
            raise BagError("%s: no such file" % self.path)
        if self.path.name.endswith(".active"):
            raise BagError(
                "%s is still being recorded, or its recorder was killed: run `rosbag reindex` on it" % self.path
            )
        try:
            self._reader = AnyReader([self.path])
            self._reader.open()
        except (AnyReaderError, ReaderError, OSError) as error:
            raise BagError(
                "%s is not a complete ROS 1 bag (%s): if its recorder was killed, run `rosbag reindex` on it"
                % (self.path, error)
            ) from error
        return self

    def __exit__(self, *exception):
        with contextlib.suppress(AnyReaderError):
            self._reader.close()

    @property
    def topics(self):
        """{topic: number of messages} of the bag."""
        return {name: info.msgcount for name, info in self._reader.topics.items()}

    @property
    def types(self):
        """{topic: message type, as sensor_msgs/msg/Image} of the bag."""
        return {name: info.msgtype for name, info in self._reader.topics.items()}

    @property
    def duration_s(self):
        """Time from the first to the last message [s]."""
        return 1e-9 * self._reader.duration

    def messages(self, topics=None):
        """Iterate over (topic, time of receipt [s], message) in the order of receipt.

        topics: an iterable of names, None for all. Raises BagError for topics that the bag does not have.
        """
        connections = self._reader.connections
        if topics is not None:
            wanted = set(topics)
            missing = wanted - set(self._reader.topics)
            if missing:
                raise BagError(
                    "%s has no topic %s; it has %s"
                    % (self.path, ", ".join(sorted(missing)), ", ".join(sorted(self._reader.topics)) or "none")
                )
            connections = [connection for connection in connections if connection.topic in wanted]
            if not connections:
                return
        for connection, timestamp_ns, raw in self._reader.messages(connections=connections):
            try:
                message = self._reader.deserialize(raw, connection.msgtype)
            except SerdeError as error:
                raise BagError("%s: a message on %s is damaged (%s)" % (self.path, connection.topic, error)) from error
            yield connection.topic, 1e-9 * timestamp_ns, message
