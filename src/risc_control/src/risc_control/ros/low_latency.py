"""Settings of a Python node on the way from the frame to the command: start it with `start`, let it run by `spin`."""

import gc
import sys

import rospy

from risc_control.priority import FLIGHT, raise_priority
from risc_lab.ros.direct_connection import send_directly

_SWITCH_INTERVAL_S = 0.0005  # the default of 5 ms is how long a timer's thread could hold up a frame
_OMIT_TOPICS = "/rosout_disable_topics_generation"  # of every log message


def start(name, **options):
    """rospy.init_node for a node whose latency matters; same arguments, same errors."""
    raise_priority(FLIGHT)
    send_directly()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    rospy.init_node(name, **options)
    _log_without_the_master()


def _log_without_the_master():
    """Let no log call wait for the master, which may be out of reach just when there is something to log.

    As long as nobody has set this parameter, each of rospy's log calls asks for it and waits for the answer, without a
    limit: the timer of the loss ladder would stand still from its first warning on.
    """
    if not rospy.has_param(_OMIT_TOPICS):
        rospy.set_param(_OMIT_TOPICS, False)
    rospy.get_param_cached(_OMIT_TOPICS)  # the node is told of changes from now on, and asks no more


def spin():
    """rospy.spin without the pauses of full garbage collections, which would walk all imported modules."""
    gc.collect()
    gc.freeze()
    rospy.spin()
