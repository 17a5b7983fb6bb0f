"""How a node runs."""

import sys

import rospy

from risc_lab.ros.publisher_updates import init_node


def run(name, make, start=init_node, spin=rospy.spin):
    """Make a node, and run it until shutdown; wrong parameters (ValueError) end it with one line.

    start, spin: those of `low_latency`, for a node between frame and command.
    """
    start(name)
    try:
        node = make()
    except ValueError as error:
        rospy.logfatal("%s: %s", name, error)
        sys.exit(1)
    spin()
    del node
