"""Read bags: every problem with a bag is a BagError that names the cause and the remedy."""

import contextlib
import heapq
import io
import pathlib
from itertools import count

from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag1 import Reader, ReaderError
from rosbags.rosbag1.reader import Header, RecordType, read_bytes, read_uint32
from rosbags.serde import SerdeError


class BagError(ValueError):
    """A bag cannot be used; the message names the cause and the remedy."""


class Bag:
    """A ROS 1 bag, opened for reading. Use as a context manager.

    The message definitions come from the bag itself, so bags of other versions and of other packages can be read too.

    topics: {topic: number of messages}.  types: {topic: message type, as sensor_msgs/msg/Image; None = several}.
    start_s: time of receipt [s] of the first message, 0 for an empty bag.  duration_s: from the first to the last [s].
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
            self._reader = _open(self.path)
        except (AnyReaderError, ReaderError, OSError) as error:
            raise BagError(
                "%s is not a complete ROS 1 bag (%s): if its recorder was killed, run `rosbag reindex` on it"
                % (self.path, error)
            ) from error
        topics = self._reader.topics
        self.topics = {name: info.msgcount for name, info in topics.items()}
        self.types = {name: info.msgtype for name, info in topics.items()}
        self.start_s = 1e-9 * self._reader.start_time if topics else 0.0
        self.duration_s = 1e-9 * self._reader.duration
        return self

    def __exit__(self, *exception):
        with contextlib.suppress(AnyReaderError):
            self._reader.close()

    def messages(self, topics=None):
        """Iterate over (topic, time of receipt [s], message) in the order of receipt.

        topics: an iterable of names, None for all. Raises BagError for topics that the bag does not have.
        """
        connections = self._reader.connections
        if topics is not None:
            topics = set(topics)
            self.require(topics)
            connections = [connection for connection in connections if connection.topic in topics]
            if not connections:
                return
        try:
            for connection, timestamp_ns, raw in self._reader.messages(connections=connections):
                yield connection.topic, 1e-9 * timestamp_ns, self._reader.deserialize(raw, connection.msgtype)
        except (AnyReaderError, SerdeError) as error:
            raise BagError("%s: a message on %s is damaged (%s)" % (self.path, connection.topic, error)) from error
        except (ReaderError, OSError, RuntimeError, ValueError, EOFError) as error:  # all but the first: decompression
            raise BagError("%s is damaged (%s): run `rosbag reindex` on it" % (self.path, error)) from error

    def fraction(self, receipt_s):
        """How much of the bag [0, 1] is before a time of receipt."""
        return (receipt_s - self.start_s) / max(self.duration_s, 1e-3)

    def require(self, topics):
        """Raises BagError for topics that the bag does not have."""
        missing = sorted(set(topics) - set(self.topics))
        if missing:
            raise BagError("%s has no topic %s; %s" % (self.path, ", ".join(missing), self.contents))

    @property
    def contents(self):
        """Text: the topics of the bag, for error messages."""
        return "it has " + (", ".join(sorted(self.topics)) or "no message")


class _ChunkReader(Reader):
    """Reads a bag chunk by chunk, so that memory does not grow with its length.

    The library's own reader keeps an index of every message: 150 bytes each, a gigabyte for an hour at 200 Hz. Chunks
    that overlap in time, which recorders do not write, are held in memory together.
    """

    def read_index_data(self, pos, indexes):
        """Read nothing: each chunk says itself what it holds, and `open` seeks to the next one."""

    def messages(self, connections=(), start=None, stop=None):
        """As Reader.messages: (connection, time [ns], raw message) in the order of time."""
        wanted = {connection.id: connection for connection in connections or self.connections}
        chunks = [info for info in self.chunk_infos if not wanted.keys().isdisjoint(info.connection_counts)]
        held, number = [], count()  # the number keeps the order in the file where times are equal

        def popped():
            time_ns, _, connection, raw = heapq.heappop(held)
            return connection, time_ns, raw

        for info in sorted(chunks, key=lambda info: info.start_time):
            while held and held[0][0] <= info.start_time:  # equal: those held were read first
                yield popped()
            for time_ns, identity, raw in self._records(info):
                if identity in wanted and (start is None or time_ns >= start) and (stop is None or time_ns < stop):
                    heapq.heappush(held, (time_ns, next(number), wanted[identity], raw))
        while held:
            yield popped()

    def _records(self, info):
        """(time [ns], connection's id, raw message) of one chunk, in the order of the file."""
        chunk = self.chunks[info.pos]
        self.bio.seek(chunk.datapos)
        data = chunk.decompressor(read_bytes(self.bio, chunk.datasize))
        stream, size = io.BytesIO(data), len(data)
        while stream.tell() < size:
            header = Header.read(stream)
            raw = read_bytes(stream, read_uint32(stream))
            if header.get_uint8("op") == RecordType.MSGDATA:
                yield header.get_time("time"), header.get_uint32("conn"), raw


def _open(path):
    """An open reader of a bag."""
    reader = AnyReader([path])
    if reader.is2:
        raise AnyReaderError("its name does not end in .bag")
    reader.readers = [_ChunkReader(path)]
    reader.open()
    return reader
