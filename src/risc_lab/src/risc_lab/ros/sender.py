"""Which node sent a message. rospy has no public name for it: no other file reads the field."""


def sender(message):
    """Name of the node that sent it; "" when that node has not said."""
    return message._connection_header.get("callerid", "")
