"""Which of the two cameras a picture comes from. Pure: no clock of its own.

The header does not name the camera, but the stream id changes with it (and with the codec, which the header does name).
A change of camera takes a while after the order; until the stream id changes, pictures come from the old camera.
"""

import threading

CHANNELS = 2
FRONT, BOTTOM = range(CHANNELS)
SETTLE_S = 1.0  # an order has taken effect by then, even if the stream id has not shown it


class CameraTracker:
    """Determines the camera of every picture. The methods may be called from different threads."""

    def __init__(self, channel=FRONT):
        self._lock = threading.Lock()
        self._camera = channel  # None: unknown
        self._ordered = channel  # the last order
        self._ordered_s = float("-inf")  # time of the last order
        self._pending = 0  # orders whose effect has not been seen
        self._connection = None
        self._stream_id = None
        self._codec = None

    def order(self, channel, now_s):
        """Note that the vehicle is ordered to send this channel, FRONT or BOTTOM. now_s: same clock as in `camera`."""
        with self._lock:
            self._ordered = channel
            self._ordered_s = now_s
            self._pending += 1

    def reset(self, channel):
        """Note that the vehicle was configured again and sends this channel; earlier orders no longer count."""
        with self._lock:
            self._ordered = self._camera = channel
            self._pending = 0

    def camera(self, header, is_idr, connection, now_s):
        """Return FRONT or BOTTOM, or None while the camera is unknown, for about SETTLE_S and until the next IDR.

        It is unknown when the stream was opened right after an order, and after several orders in a row, because the
        aircraft may have skipped some of them.
        header: PaveHeader of the picture.  connection: number of the TCP connection, any hashable.
        """
        with self._lock:
            is_new_connection = connection != self._connection
            is_new_stream = header.stream_id != self._stream_id and header.codec == self._codec
            self._connection, self._stream_id, self._codec = connection, header.stream_id, header.codec
            if not self._pending:
                return self._camera
            settled = now_s - self._ordered_s >= SETTLE_S and (is_new_connection or is_idr)
            if settled or (is_new_stream and not is_new_connection and self._pending == 1):
                self._camera, self._pending = self._ordered, 0
            elif is_new_connection or is_new_stream:
                self._camera = None
            return self._camera
