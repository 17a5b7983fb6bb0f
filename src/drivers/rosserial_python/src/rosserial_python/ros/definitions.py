"""Checks message definitions here against those that a device was built with; payloads to messages and back."""

import io

import genpy
import roslib.message

from rosserial_python.protocol import PayloadError


class TypesError(ValueError):
    """A topic of the device cannot be connected to the graph: its definition is different here, or missing."""


def known_class(topic, half=None):
    """Message class of a protocol.Topic; half: _request_class or _response_class of a service. Raises TypesError."""
    find = roslib.message.get_service_class if half else roslib.message.get_message_class
    try:
        found = find(topic.type)
    except (ImportError, ValueError):
        found = None
    if found is None:
        raise TypesError(
            "%s (%s): message type not found: build its package, and source the workspace" % (topic.name, topic.type)
        )
    kind = getattr(found, half) if half else found
    if kind._md5sum != topic.md5sum:
        raise TypesError(
            "%s: the definition of %s differs between the device (md5 %s) and this workspace (%s): regenerate ros_lib "
            "from this workspace's messages, and upload the sketch again"
            % (topic.name, topic.type, topic.md5sum, kind._md5sum)
        )
    return found


def read_message(message_class, payload):
    """Decode a message that consists of exactly these bytes. Raises PayloadError."""
    message = message_class()
    try:
        message.deserialize(payload)
        again = serialised(message)
    except (genpy.MessageException, ValueError, MemoryError) as error:
        raise PayloadError("%s: %s" % (message_class._type, error)) from None
    if again != payload:  # genpy accepts payloads that are too long or too short, or strings that are not UTF-8
        raise PayloadError("%s: %d bytes that are not such a message" % (message_class._type, len(payload)))
    return message


def serialised(message):
    """Return the bytes of a message. Raises genpy.SerializationError."""
    data = io.BytesIO()
    message.serialize(data)
    return data.getvalue()
