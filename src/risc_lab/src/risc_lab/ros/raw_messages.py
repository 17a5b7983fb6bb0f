"""Messages that are received as bytes. rospy.AnyMsg has no public name for them: no other file reads the field."""

import functools


@functools.cache
def raw_class(message_class):
    """Return a variant of the class, also of rospy.AnyMsg, whose messages keep their bytes in `raw`, not decoded."""

    def deserialize(self, data):
        self.raw = bytes(data)
        return self

    return type(message_class.__name__, (message_class,), {"__init__": lambda self: None, "deserialize": deserialize})
