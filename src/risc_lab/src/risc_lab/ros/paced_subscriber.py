"""Subscriptions to topics that are much faster than their messages are needed."""

import threading
import time
import weakref

import rospy

from risc_lab.ros.guard import guarded
from risc_lab.ros.until_shutdown import is_closing

BUFFER_BYTES = 2**20  # holds what arrives while a callback waits
PICTURES_BYTES = 2**24  # the same for pictures: what waits is read at one go, and all but the newest is thrown away
_open = weakref.WeakSet()  # events that the existing subscribers wait on, to be set at the end of the process
_open_lock = threading.RLock()  # a signal may end the process while its main thread is in here
_hooked = False  # rospy never forgets a hook, so there is one for all


def _opened(over):
    """`over` is set when ROS shuts down, at once if it does already."""
    global _hooked
    with _open_lock:
        _open.add(over)
        is_first, _hooked = not _hooked, True
    if is_first:
        rospy.on_shutdown(_end_all)
    if is_closing():
        over.set()


def _end_all():
    with _open_lock:
        for over in _open:
            over.set()


class PacedSubscriber:
    """Calls back with the newest message at most `rate_hz` times a second; the others cost nothing.

    The callback's thread belongs to the connection and reads nothing while it waits here. What has arrived
    meanwhile is taken out of the socket at one go, and rospy deserialises the last message only (queue_size 1): a fifth
    of the work of a plain subscription. The publisher does not notice: what waits is in a socket of our own.

    Each topic has a thread of its own; callbacks that share data lock it themselves. If a callback returns a time of
    the monotonic clock, it is next called at that time, with the newest message. It is guarded.
    """

    def __init__(self, topic, message_class, callback, rate_hz, args=(), on_error=None):
        """rate_hz: highest rate of calls.  args: of the callback, after the message.  on_error: see `guard.guarded`."""
        self._callback = guarded(callback, "the callback of " + topic, on_error)
        self._args = args
        self._period_s = 1.0 / rate_hz
        self._over = threading.Event()
        _opened(self._over)
        self._subscriber = rospy.Subscriber(  # whose callback is guarded within
            topic, message_class, self._on_message, queue_size=1, buff_size=BUFFER_BYTES, tcp_nodelay=True
        )

    def unregister(self):
        """Unsubscribe; the topic costs nothing from then on."""
        self._over.set()
        self._subscriber.unregister()

    def _on_message(self, message):
        if self._over.is_set():
            return
        start_s = time.monotonic()
        until_s = self._callback(message, *self._args)
        if until_s is None:
            until_s = start_s + self._period_s
        self._over.wait(max(0.0, until_s - time.monotonic()))
