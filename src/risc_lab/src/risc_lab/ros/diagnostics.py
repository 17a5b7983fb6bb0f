"""What a node tells of itself on /diagnostics."""

import rospy
from diagnostic_updater import Updater

_PERIOD = "~diagnostic_period"
_PERIOD_S = 1.0


def make_updater(hardware_id):
    """A diagnostic_updater.Updater for this node that leaves the master alone.

    An Updater asks for its period again and again as long as nobody has set it, and asking is to the master as good
    as registering: a node that is just being replaced by one of the same name would throw that one out again.
    """
    if not rospy.has_param(_PERIOD):
        rospy.set_param(_PERIOD, _PERIOD_S)
    updater = Updater()
    updater.setHardwareID(hardware_id)
    return updater
