"""Settings of a Python node on the way from the frame to the command: start it with `start`, let it run by `spin`."""

import gc
import sys

import rospy

from risc_control.priority import FLIGHT, raise_priority
from risc_control.ros.direct_connection import send_directly

_SWITCH_INTERVAL_S = 0.0005  # the default of 5 ms is how long a timer's thread could hold up a frame


def start(name, **options):
    """rospy.init_node for a node whose latency matters; same arguments, same errors."""
    raise_priority(FLIGHT)
    send_directly()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    rospy.init_node(name, **options)


def spin():
    """rospy.spin without the pauses of full garbage collections, which would walk all imported modules."""
    gc.collect()
    gc.freeze()
    rospy.spin()
