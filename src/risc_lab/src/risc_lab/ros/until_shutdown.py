"""Callbacks that may still run while ROS shuts down."""

import functools

import rospy


def is_closing():
    """Whether the node shuts down, or has: rospy.is_shutdown() is false while its topics are closed already.

    rospy has no documented name for it: no other file asks rospy.core.
    """
    return rospy.core.is_shutdown_requested()


def until_shutdown(callback):
    """Wrap a callback: ignore the error that it gets when rospy has closed its topics at shutdown.

    rospy closes publishers before it ends the threads that publish: a message on its way at that moment raises, and
    the node would end with a useless traceback.
    """

    @functools.wraps(callback)
    def run(*args):
        try:
            callback(*args)
        except rospy.ROSException:
            if not is_closing():
                raise

    return run
