"""Settings of a Python node between motion capture frame and command: start it with `start`, run it with `spin`."""

import contextlib
import ctypes
import gc
import sys

import rospy

from risc_lab.priority import FLIGHT, raise_priority
from risc_lab.ros.direct_connection import send_directly
from risc_lab.ros.publisher_updates import init_node

_SWITCH_INTERVAL_S = 0.0005  # the default of 5 ms is how long a timer's thread could hold up a frame
_OMIT_TOPICS = "/rosout_disable_topics_generation"  # rospy reads it for every log message
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of glibc's mallopt
_KEPT_BYTES = 2**25  # the most that glibc takes; more than any receive buffer


def start(name, **options):
    """rospy.init_node for a node whose latency matters; same arguments, same errors."""
    raise_priority(FLIGHT)
    send_directly()
    _keep_memory()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    init_node(name, **options)
    _log_without_the_master()


def _keep_memory():
    """Let glibc reuse the memory of receive buffers.

    rospy asks for a whole buffer (1 MB where frames may wait) for every message that it reads. glibc would get it from
    the kernel each time and give it back, which takes three system calls and a page fault.
    """
    with contextlib.suppress(OSError, AttributeError):  # another C library
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_MMAP_THRESHOLD, _KEPT_BYTES)
        mallopt(_M_TRIM_THRESHOLD, 2 * _KEPT_BYTES)


def _log_without_the_master():
    """Let no log call wait for the master, which may be out of reach just when there is something to log.

    As long as this parameter is not set, each of rospy's log calls asks for it and waits for the answer, without a
    limit: the timer of the safety ladder would stand still from its first warning on.
    """
    if not rospy.has_param(_OMIT_TOPICS):
        rospy.set_param(_OMIT_TOPICS, False)
    rospy.get_param_cached(_OMIT_TOPICS)  # the node is told of changes from now on, and asks no more


def spin():
    """rospy.spin without the pauses of full garbage collections, which would walk all imported modules."""
    gc.collect()
    gc.freeze()
    rospy.spin()
