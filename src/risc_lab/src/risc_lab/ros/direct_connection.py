"""Sending messages from the thread that publishes them.

rospy wakes a thread for each subscriber of each message. At 200 Hz with six subscribers that is most of what a node
does, and it delays every hop by a thread switch. A `DirectConnection` sends at once when the subscriber's socket
takes the whole message, and leaves it to rospy's thread otherwise: a subscriber that is slow, frozen or out of reach
delays no other, and loses the oldest messages beyond the publisher's queue_size, as always.
"""

import socket
import threading

import rospy.topics


class DirectConnection(rospy.topics.QueuedConnection):
    """A QueuedConnection that needs its thread only for what the socket does not take at once."""

    def __init__(self, connection, queue_size):
        self._rest = b""  # of a partly sent message: goes first, is never dropped
        self._relaying = False  # the thread is sending: nothing may overtake it
        super().__init__(connection, queue_size)

    def write_data(self, data):
        """Send or queue one serialised message. Raises an error that the thread has had since the last call."""
        with self._lock:
            if self._error is not None:
                error, self._error = self._error, None
                raise error
            if not (self._queue or self._rest or self._relaying):
                sent = self._send_at_once(data)
                if sent == len(data):
                    return True
                if sent:
                    self._rest = data[sent:]
                    self._cond_data_available.notify()
                    return True
            if 0 < self._queue_size <= len(self._queue):
                del self._queue[0]
            self._queue.append(data)
            self._cond_data_available.notify()
        return True

    def _send_at_once(self, data):
        """Bytes that the socket took without waiting; errors are left to the thread, which handles them all."""
        connection = self._connection
        if connection.done or connection.socket is None:
            return 0
        try:
            sent = connection.socket.send(data, socket.MSG_DONTWAIT)
        except OSError:
            return 0
        connection.stat_bytes += sent
        connection.stat_num_msg += sent == len(data)
        return sent

    def _run(self):
        while not self._connection.done:
            with self._lock:
                self._relaying = False
                while not (self._queue or self._rest or self._connection.done):
                    self._cond_data_available.wait()
                work = [self._rest] if self._rest else []
                work += self._queue
                self._queue, self._rest = [], b""
                self._relaying = True
            try:
                for data in work:
                    self._connection.write_data(data)
            except Exception as error:  # of any kind: the publisher must hear of it
                with self._lock:
                    self._error = error


_lock = threading.Lock()


def send_directly():
    """Let every publisher of this process that is made from now on send directly. Call it before the first one."""
    with _lock:
        rospy.topics.QueuedConnection = DirectConnection
