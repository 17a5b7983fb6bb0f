"""Which publishers a subscriber hears: rospy's get_num_connections counts those that it has only decided to call."""

_UNKNOWN = "unknown"  # the name that rospy gives a publisher until its header has come


def publishers_heard(subscriber):
    """Names of the nodes of which every message reaches this rospy.Subscriber from now on, in a set."""
    callers = {connection.callerid_pub for connection in subscriber.impl.connections}
    return callers - {_UNKNOWN}
