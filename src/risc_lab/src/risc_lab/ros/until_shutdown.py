"""Callbacks that may still run while ROS shuts down."""

import functools

import rospy


def until_shutdown(callback):
    """The callback, without the error it meets when rospy has closed its topics under it.

    rospy closes publishers before it ends the threads that publish: a message on its way at that moment raises, and
    the node would end with a useless traceback.
    """

    @functools.wraps(callback)
    def run(*args):
        try:
            callback(*args)
        except rospy.ROSException:
            # topics are closed while it is on its way already, but not over: rospy.is_shutdown() is still false then
            if not rospy.core.is_shutdown_requested():
                raise

    return run
