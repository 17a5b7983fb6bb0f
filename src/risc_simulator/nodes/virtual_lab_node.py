#!/usr/bin/env python3
"""The virtual lab as a ROS node: adds /ground_truth, diagnostics and fault injection. Wiring only."""

import logging
import signal
import sys
import threading

import rospy

from risc_lab.priority import VIRTUAL_LAB, raise_priority
from risc_lab.ros import low_latency
from risc_simulator.ros.node import VirtualLabNode, load_options, make_lab
from risc_simulator.virtual_lab import report


def handle_signals(handler):
    """Install handler for the signals that end the process."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def main():
    """Run until ROS shuts down. Returns the exit code."""
    handle_signals(lambda *_: rospy.signal_shutdown("signal"))  # while it waits for a master
    try:
        low_latency.start("virtual_lab", disable_signals=True)
    except rospy.ROSException:
        return 1
    logging.getLogger("risc_simulator").handlers = logging.getLogger("rosout").handlers  # log to screen and /rosout
    # rospy's own handlers would spend half a second inside the schedule; these let the lab finish its frame
    stop_event = threading.Event()
    rospy.on_shutdown(stop_event.set)
    handle_signals(lambda *_: stop_event.set())
    try:
        options = load_options()
        lab = make_lab(options)
    except (ValueError, OSError) as error:
        rospy.logfatal("virtual lab: %s", error)
        rospy.signal_shutdown("the lab could not start")
        return 1
    try:
        node = VirtualLabNode(lab)
        rospy.loginfo("%s", lab.describe())
        raise_priority(VIRTUAL_LAB)
        lab.run(stop_event, on_frame=node.after_frame)
        statistics = lab.statistics()
    finally:
        lab.close()
        rospy.signal_shutdown("the lab has closed")
    return report(statistics, options.stats)


if __name__ == "__main__":
    sys.exit(main())
